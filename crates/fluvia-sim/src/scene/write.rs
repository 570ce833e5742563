//! From a [`Scene`] to the text of a scene file, a line a body. What is on disk has structs of its own; what has its
//! default is left out, as people do.

use std::io;

use serde::Serialize;
use serde_json::ser::{Formatter, Serializer};

use super::{Fluid, Material, Placement, Rotation, Scene, Source, Wall};
use crate::{Error, Result};

/// What is said of the whole scene.
#[derive(Serialize)]
struct SceneFile {
    #[serde(skip_serializing_if = "Option::is_none")]
    gravity: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dt: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    particle_radius: Option<f32>,
    #[serde(flatten)]
    material: MaterialFile,
}

#[derive(Serialize)]
struct WallFile<'a> {
    #[serde(flatten)]
    body: BodyFile<'a>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    invert_normals: bool,
}

#[derive(Serialize)]
struct FluidFile<'a> {
    #[serde(flatten)]
    body: BodyFile<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    velocity: Option<[f32; 3]>,
    #[serde(flatten)]
    emission: Option<EmissionFile>,
    #[serde(flatten)]
    material: MaterialFile,
}

#[derive(Serialize)]
struct EmissionFile {
    start: u64,
    stop: u64,
    step: u64,
}

/// What walls and fluids have in common.
#[derive(Serialize)]
struct BodyFile<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    path: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    particles: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    shape: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<ScaleFile>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation: Option<RotationFile>,
    #[serde(skip_serializing_if = "Option::is_none")]
    translation: Option<[f32; 3]>,
}

#[derive(Serialize)]
#[serde(untagged)]
enum ScaleFile {
    Same(f32),
    Each([f32; 3]),
}

#[derive(Serialize)]
struct RotationFile {
    axis: [f32; 3],
    angle: f32,
}

#[derive(Serialize)]
struct MaterialFile {
    #[serde(skip_serializing_if = "Option::is_none")]
    viscosity: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density: Option<f32>,
}

pub(super) fn to_json(scene: &Scene) -> Result<String> {
    let fault =
        |reason: &dyn std::fmt::Display| Error::Parameter(format!("no scene file can hold it: {reason}"));
    let text = text(scene).map_err(|error| fault(&error))?;
    // A scene made in code can have what no file has: numbers that are not finite, an emitter that never emits.
    match Scene::parse(text.as_bytes(), &scene.path) {
        Ok(read) if read == *scene => Ok(text),
        Ok(_) => Err(fault(&"another scene is read back")),
        Err(error) => Err(fault(&error)),
    }
}

fn text(scene: &Scene) -> serde_json::Result<String> {
    let walls = scene.walls.iter().map(|item| line(&wall(item))).collect::<serde_json::Result<Vec<_>>>()?;
    let fluids =
        scene.fluids.iter().map(|item| line(&fluid(item))).collect::<serde_json::Result<Vec<_>>>()?;
    let list = |name: &str, lines: Vec<String>| match &lines[..] {
        [] => format!("    \"{name}\": []"),
        _ => format!("    \"{name}\": [\n        {}\n    ]", lines.join(",\n        ")),
    };
    let mut parts = vec![list("walls", walls), list("fluids", fluids)];
    let whole = line(&SceneFile {
        gravity: scene.gravity,
        dt: scene.dt,
        particle_radius: scene.particle_radius,
        material: material(&scene.material),
    })?;
    let entries = whole.trim_matches(['{', '}']);
    if !entries.is_empty() {
        parts.push(format!("    {entries}"));
    }
    Ok(format!("{{\n{}\n}}\n", parts.join(",\n")))
}

/// The value as JSON on one line.
fn line(value: &impl Serialize) -> serde_json::Result<String> {
    let mut text = Vec::new();
    value.serialize(&mut Serializer::with_formatter(&mut text, Spaced))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// One line with spaces after commas and colons.
struct Spaced;

impl Formatter for Spaced {
    fn begin_array_value<W: io::Write + ?Sized>(&mut self, out: &mut W, is_first: bool) -> io::Result<()> {
        if is_first { Ok(()) } else { out.write_all(b", ") }
    }

    fn begin_object_key<W: io::Write + ?Sized>(&mut self, out: &mut W, is_first: bool) -> io::Result<()> {
        self.begin_array_value(out, is_first)
    }

    fn begin_object_value<W: io::Write + ?Sized>(&mut self, out: &mut W) -> io::Result<()> {
        out.write_all(b": ")
    }
}

fn wall(wall: &Wall) -> WallFile<'_> {
    WallFile { body: body(&wall.source, &wall.placement), invert_normals: wall.invert_normals }
}

fn fluid(fluid: &Fluid) -> FluidFile<'_> {
    let &Fluid { start, stop, step, .. } = fluid;
    FluidFile {
        body: body(&fluid.source, &fluid.placement),
        velocity: fluid.velocity,
        emission: ((start, stop, step) != (0, 1, 1)).then_some(EmissionFile { start, stop, step }),
        material: material(&fluid.material),
    }
}

fn body<'a>(source: &'a Source, placement: &Placement) -> BodyFile<'a> {
    let plain = Placement::default();
    let [x, y, z] = placement.scale;
    let scale = if x == y && y == z { ScaleFile::Same(x) } else { ScaleFile::Each(placement.scale) };
    let rotation = |&Rotation { axis, angle }: &Rotation| RotationFile { axis, angle };
    BodyFile {
        path: if let Source::Mesh(path) = source { Some(path) } else { None },
        particles: if let Source::Particles(path) = source { Some(path) } else { None },
        shape: if let Source::Shape(shape) = source { Some(shape.name()) } else { None },
        scale: (placement.scale != plain.scale).then_some(scale),
        rotation: placement.rotation.as_ref().map(rotation),
        translation: (placement.translation != plain.translation).then_some(placement.translation),
    }
}

fn material(material: &Material) -> MaterialFile {
    MaterialFile { viscosity: material.viscosity, density: material.density }
}
