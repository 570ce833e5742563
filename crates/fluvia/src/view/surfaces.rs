//! The walls for the page: surfaces where there are meshes, points elsewhere.

use std::path::Path;

use fluvia_sim::mesh::TriangleMesh;
use fluvia_sim::metrics::Bounds;
use fluvia_sim::scene::{self, Scene, Setup};
use fluvia_view::walls::Walls;

use crate::frame_source::FrameSource;
use crate::record::{Source, read_source, sha256};

/// The walls of a scene that runs.
pub fn of_setup(setup: &Setup) -> Walls {
    let mut walls = Walls::default();
    for wall in &setup.walls {
        match &wall.surface {
            Some(surface) => add(&mut walls, surface),
            None => {
                walls.points.extend_from_slice(&setup.boundary.position[wall.range.clone()]);
                walls.normals.extend_from_slice(&setup.boundary.normal[wall.range.clone()]);
            }
        }
    }
    let fluids = setup.emitters.iter().map(|emitter| emitter.position.as_slice());
    frame(&mut walls, fluids.chain([setup.boundary.position.as_slice()]));
    walls
}

/// The walls of frames on disk: the surfaces of the scene if that is where it was, else their particles. `first` is the
/// first frame.
pub fn of_frames(source: &FrameSource, first: &[[f32; 3]]) -> Walls {
    let mut walls = Walls::default();
    let particles = source.walls().position.as_slice();
    match source.record().and_then(|record| recorded(&record.scene)) {
        Some(surfaces) if !surfaces.is_empty() => {
            surfaces.iter().for_each(|surface| add(&mut walls, surface))
        }
        _ => {
            walls.points.extend_from_slice(particles);
            walls.normals.extend_from_slice(source.walls().normal.as_deref().unwrap_or_default());
        }
    }
    frame(&mut walls, [particles, first].into_iter());
    walls
}

/// The surfaces of a recorded scene, if the very same can still be read and all of it has surfaces.
fn recorded(source: &Source) -> Option<Vec<TriangleMesh>> {
    let path = Path::new(&source.name);
    let bytes = match scene::shipped(&source.name) {
        Some(text) if sha256(text.as_bytes()) == source.sha256 => text.as_bytes().to_vec(),
        _ => read_source(path).ok().filter(|(_, found)| found.sha256 == source.sha256)?.0,
    };
    let scene = Scene::parse(&bytes, path).ok()?;
    let surfaces = scene.surfaces().ok()?;
    (surfaces.len() == scene.walls.len()).then_some(surfaces)
}

fn add(walls: &mut Walls, surface: &TriangleMesh) {
    let first = walls.vertices.len() as u32;
    walls.vertices.extend_from_slice(&surface.positions);
    walls.triangles.extend(surface.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
}

/// Sets the box around all points.
fn frame<'a>(walls: &mut Walls, points: impl Iterator<Item = &'a [[f32; 3]]>) {
    let corners: Vec<[f32; 3]> =
        points.filter_map(Bounds::of).flat_map(|bounds| [bounds.low, bounds.high]).collect();
    if let Some(Bounds { low, high }) = Bounds::of(&corners) {
        (walls.low, walls.high) = (low, high);
    }
}
