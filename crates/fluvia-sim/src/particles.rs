//! The state of a fluid and the walls around it, as particles.

use crate::{Error, Result};

/// The fluid particles; every vector has one entry a particle, `memory` may be empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Particles {
    /// Positions, metres.
    pub position: Vec<[f32; 3]>,
    /// Velocities, metres per second.
    pub velocity: Vec<[f32; 3]>,
    /// Identity, unique in a run and never used again after removal.
    pub id: Vec<u32>,
    /// The index of the scene's fluid (its emitter) that the particle came from.
    pub body: Vec<u32>,
    /// What the solver keeps of each from step to step (DFSPH: the pressures that its two solvers start from); zeros
    /// for a new particle. Empty where the solver keeps nothing.
    pub memory: Vec<[f32; 2]>,
}

impl Particles {
    /// One body, numbered from 0.
    ///
    /// # Panics
    /// If there is not one velocity per position.
    pub fn of_one_body(position: Vec<[f32; 3]>, velocity: Vec<[f32; 3]>) -> Particles {
        let count = position.len();
        assert_eq!(velocity.len(), count, "one velocity per position");
        let id = (0..count as u32).collect();
        Particles { position, velocity, id, body: vec![0; count], memory: Vec::new() }
    }

    /// The number of particles.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Keeps the particles for which `keep` holds, in their order.
    ///
    /// # Panics
    /// If `keep` has another length.
    pub fn retain(&mut self, keep: &[bool]) {
        assert_eq!(keep.len(), self.len(), "one flag per particle");
        retain(&mut self.position, keep);
        retain(&mut self.velocity, keep);
        retain(&mut self.id, keep);
        retain(&mut self.body, keep);
        if !self.memory.is_empty() {
            retain(&mut self.memory, keep);
        }
    }
}

fn retain<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut flags = keep.iter();
    values.retain(|_| *flags.next().expect("one flag per value"));
}

/// The static wall particles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Boundary {
    /// Positions, metres.
    pub position: Vec<[f32; 3]>,
    /// Unit normals that point into the fluid.
    pub normal: Vec<[f32; 3]>,
}

impl Boundary {
    /// # Errors
    /// `Parameter` if there is not one normal per position.
    pub fn check(&self) -> Result<()> {
        let (positions, normals) = (self.position.len(), self.normal.len());
        if positions != normals {
            return Err(Error::Parameter(format!("{positions} wall positions and {normals} normals")));
        }
        Ok(())
    }
}

/// The external acceleration a_ext of Eq. 10, metres per second squared.
#[derive(Clone, Copy, Debug)]
pub enum Acceleration<'a> {
    /// The same for all particles, as gravity.
    Uniform([f32; 3]),
    /// One per particle; its length is that of the particles.
    PerParticle(&'a [[f32; 3]]),
}

impl Acceleration<'_> {
    /// # Errors
    /// `Parameter` if there is one per particle, but not for so many particles.
    pub fn check(&self, particles: usize) -> Result<()> {
        match self {
            Acceleration::PerParticle(values) if values.len() != particles => {
                Err(Error::Parameter(format!("{} accelerations for {particles} particles", values.len())))
            }
            _ => Ok(()),
        }
    }

    /// The acceleration of particle `i`.
    #[inline]
    pub fn of(&self, i: usize) -> [f32; 3] {
        match self {
            Acceleration::Uniform(a) => *a,
            Acceleration::PerParticle(a) => a[i],
        }
    }
}
