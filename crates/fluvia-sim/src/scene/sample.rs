//! From a [`Scene`] to the particles of its walls and fluids.

use std::path::{Path, PathBuf};

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use super::{
    DEFAULT_DT, DEFAULT_GRAVITY, DEFAULT_PARTICLE_RADIUS, Emitter, Fluid, Material, Placement, SampledWall,
    Scene, Setup, Source, Wall,
};
use crate::frames::sequence::{self, Frame};
use crate::frames::{self, ParticleData};
use crate::mesh::TriangleMesh;
use crate::particles::Boundary;
use crate::sampling::{Fault, MAX_FLUID_PARTICLES, MAX_WALL_PARTICLES, sample_surface, sample_volume};
use crate::{Error, Result};

pub(super) fn sample(scene: &Scene, seed: u64) -> Result<Setup> {
    let mut setup = Setup {
        boundary: Boundary::default(),
        walls: Vec::new(),
        emitters: Vec::new(),
        gravity: scene.gravity.unwrap_or(DEFAULT_GRAVITY),
        dt: scene.dt.unwrap_or(DEFAULT_DT),
        particle_radius: scene.particle_radius.unwrap_or(DEFAULT_PARTICLE_RADIUS),
    };
    let mut random = Pcg64::seed_from_u64(seed);
    for (i, wall) in scene.walls.iter().enumerate() {
        // One seed a wall: a change of one leaves the others as they are.
        let mut random = Pcg64::seed_from_u64(random.next_u64());
        let body = Body::new(scene, &wall.source, &wall.placement, format!("walls[{i}]"));
        sample_wall(wall, &body, &mut random, &mut setup)?;
    }
    for (i, fluid) in scene.fluids.iter().enumerate() {
        let body = Body::new(scene, &fluid.source, &fluid.placement, format!("fluids[{i}]"));
        setup.emitters.push(sample_fluid(fluid, &body, setup.particle_radius, &scene.material)?);
        let count: usize = setup.emitters.iter().map(|emitter| emitter.position.len()).sum();
        body.check_total(count, MAX_FLUID_PARTICLES)?;
    }
    Ok(setup)
}

/// The surfaces of the walls that have one, in their place, with faces that look into the fluid.
pub(super) fn surfaces(scene: &Scene) -> Result<Vec<TriangleMesh>> {
    let meshes =
        scene.walls.iter().enumerate().filter(|(_, wall)| !matches!(wall.source, Source::Particles(_)));
    let surface = |(i, wall): (usize, &Wall)| {
        let body = Body::new(scene, &wall.source, &wall.placement, format!("walls[{i}]"));
        Ok(body.surface(body.mesh()?, wall.invert_normals))
    };
    meshes.map(surface).collect()
}

/// Adds a wall to the set-up.
fn sample_wall(wall: &Wall, body: &Body<'_>, random: &mut Pcg64, setup: &mut Setup) -> Result<()> {
    let (particles, surface) = match wall.source {
        Source::Particles(_) => (body.wall_particles(wall.invert_normals)?, None),
        _ => {
            let mesh = body.mesh()?;
            let particles = sample_surface(&mesh, setup.particle_radius, random);
            let mut particles = particles.map_err(|fault| body.fault(&fault))?;
            if !wall.invert_normals {
                particles.normal.iter_mut().for_each(|normal| *normal = normal.map(|x| -x));
            }
            body.place(&mut particles.position)?;
            (particles, Some(body.surface(mesh, wall.invert_normals)))
        }
    };
    let start = setup.boundary.position.len();
    setup.boundary.position.extend(particles.position);
    setup.boundary.normal.extend(particles.normal);
    let end = setup.boundary.position.len();
    body.check_total(end, MAX_WALL_PARTICLES)?;
    setup.walls.push(SampledWall { source: wall.source.name().into(), range: start..end, surface });
    Ok(())
}

fn sample_fluid(fluid: &Fluid, body: &Body<'_>, radius: f32, scene: &Material) -> Result<Emitter> {
    let (mut position, file_velocity) = match fluid.source {
        Source::Particles(_) => body.fluid_particles()?,
        _ => (sample_volume(&body.mesh()?, radius).map_err(|fault| body.fault(&fault))?, None),
    };
    body.place(&mut position)?;
    let has_velocity = file_velocity.is_some();
    let velocity = file_velocity.unwrap_or_else(|| vec![fluid.velocity.unwrap_or_default(); position.len()]);
    Ok(Emitter {
        source: fluid.source.name().into(),
        path: body.path.clone(),
        position,
        velocity,
        unused_velocity: fluid.velocity.filter(|velocity| has_velocity && *velocity != [0.0; 3]),
        start: fluid.start,
        stop: fluid.stop,
        step: fluid.step,
        material: fluid.material.or(*scene),
    })
}

/// A wall or a fluid on its way to particles: what to read, where to put it, what to call it.
struct Body<'a> {
    source: &'a Source,
    placement: &'a Placement,
    key: String,
    scene_path: &'a Path,
    /// The file that it is read from, if it is one.
    path: Option<PathBuf>,
}

impl<'a> Body<'a> {
    fn new(scene: &'a Scene, source: &'a Source, placement: &'a Placement, key: String) -> Body<'a> {
        let path = match source {
            Source::Mesh(name) | Source::Particles(name) => {
                Some(scene.path.parent().unwrap_or(Path::new("")).join(name))
            }
            Source::Shape(_) => None,
        };
        Body { source, placement, key, scene_path: &scene.path, path }
    }

    /// An error that names the file of the body; for a shape, the scene.
    fn error(&self, message: impl std::fmt::Display) -> Error {
        match &self.path {
            Some(path) => Error::file(path, format!("{} of the scene: {message}", self.key)),
            None => Error::file(
                self.scene_path,
                format!("{} (shape {}): {message}", self.key, self.source.name()),
            ),
        }
    }

    fn fault(&self, fault: &Fault) -> Error {
        self.error(fault)
    }

    /// Refuses what takes more memory than anyone can have meant: the limits of one body hold for all together.
    /// Particle files are as large as their particles, and free.
    fn check_total(&self, count: usize, most: u64) -> Result<()> {
        if count as u64 <= most || matches!(self.source, Source::Particles(_)) {
            return Ok(());
        }
        Err(self.error(format!("{count} particles with those before it, at most {most:e} are made")))
    }

    /// The surface, scaled and rotated but not moved: what is sampled does not depend on where it is put.
    fn mesh(&self) -> Result<TriangleMesh> {
        let mesh = match (self.source, &self.path) {
            (Source::Shape(shape), _) => shape.mesh(),
            (_, Some(path)) => TriangleMesh::load(path)?,
            (_, None) => TriangleMesh::default(),
        };
        let mesh = mesh.map(self.placement.turn());
        self.check_finite(&mesh.positions)?;
        Ok(mesh)
    }

    /// The particles of a file; of a part of a sequence, what `of_start` takes of its walls and its first frame.
    fn particles(&self, of_start: fn(Boundary, Frame) -> ParticleData) -> Result<ParticleData> {
        let particles = match &self.path {
            Some(path) if sequence::is_part(path) => {
                let (walls, frame) = sequence::read_start(path)?;
                of_start(walls, frame)
            }
            Some(path) => frames::read(path)?,
            None => ParticleData::default(),
        };
        if particles.position.is_empty() {
            return Err(self.error("no particles, expected at least one"));
        }
        Ok(particles)
    }

    /// Positions, scaled and rotated, and velocities, rotated.
    #[allow(clippy::type_complexity, reason = "two columns of a file")]
    fn fluid_particles(&self) -> Result<(Vec<[f32; 3]>, Option<Vec<[f32; 3]>>)> {
        let particles = self.particles(|_, frame| ParticleData {
            position: frame.position,
            velocity: Some(frame.velocity),
            ..ParticleData::default()
        })?;
        let rotate = self.placement.rotate();
        let rotate = |v: [f32; 3]| rotate(v.map(f64::from)).map(|x| x as f32);
        let velocity = particles.velocity.map(|velocity| velocity.into_iter().map(rotate).collect());
        Ok((self.turned(particles.position), velocity))
    }

    /// Wall particles; files of the published script have the normals as velocities.
    fn wall_particles(&self, invert: bool) -> Result<Boundary> {
        let particles = self.particles(|walls, _| ParticleData {
            position: walls.position,
            normal: Some(walls.normal),
            ..ParticleData::default()
        })?;
        let Some(normals) = particles.normal.or(particles.velocity) else {
            return Err(self.error("no normals, expected one for each wall particle"));
        };
        let sign = if invert { -1.0 } else { 1.0 };
        let turn = self.placement.turn_normal();
        let mut normal = Vec::with_capacity(normals.len());
        for (i, n) in normals.into_iter().enumerate() {
            let Some(turned) = turn(n.map(f64::from)) else {
                return Err(self.error(format!("normal of particle {i} is zero, expected a direction")));
            };
            normal.push(turned.map(|x| (sign * x) as f32));
        }
        let mut position = self.turned(particles.position);
        self.place(&mut position)?;
        Ok(Boundary { position, normal })
    }

    /// The mesh of a wall in its place, with faces that look into the fluid.
    fn surface(&self, mut mesh: TriangleMesh, invert_normals: bool) -> TriangleMesh {
        if !invert_normals {
            mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        mesh.map(|x| self.placement.translate(x.map(|x| x as f32)).map(f64::from))
    }

    fn turned(&self, positions: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
        let turn = self.placement.turn();
        positions.into_iter().map(|x| turn(x.map(f64::from)).map(|x| x as f32)).collect()
    }

    /// Moves positions that were turned.
    fn place(&self, positions: &mut [[f32; 3]]) -> Result<()> {
        positions.iter_mut().for_each(|x| *x = self.placement.translate(*x));
        self.check_finite(positions)
    }

    fn check_finite(&self, positions: &[[f32; 3]]) -> Result<()> {
        if positions.iter().flatten().all(|x| x.is_finite()) {
            return Ok(());
        }
        Err(self.error("too large for float32 after scale, rotation and translation"))
    }
}
