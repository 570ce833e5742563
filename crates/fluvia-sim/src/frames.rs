//! Frames and particle files on disk: one file a format below this one.

/// What a particle file holds; every vector present has one entry a particle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParticleData {
    /// Positions, metres.
    pub position: Vec<[f32; 3]>,
    /// Velocities, metres per second.
    pub velocity: Option<Vec<[f32; 3]>>,
    /// Normals (walls).
    pub normal: Option<Vec<[f32; 3]>>,
    /// Identities.
    pub id: Option<Vec<u32>>,
    /// Indices of the scene's fluids.
    pub body: Option<Vec<u32>>,
}
