//! From the text of a scene file to a [`Scene`].

use std::path::Path;

use super::fields::{Allowed, Fields, Parsed};
use super::json::{self, Node};
use super::{Fluid, Material, Placement, Rotation, Scene, Source, Wall};
use crate::shapes::Shape;

const SCENE_KEYS: [&str; 7] = ["walls", "fluids", "gravity", "dt", "particle_radius", "viscosity", "density"];
const WALL_KEYS: [&str; 7] =
    ["path", "particles", "shape", "scale", "rotation", "translation", "invert_normals"];
const FLUID_KEYS: [&str; 12] = [
    "path",
    "particles",
    "shape",
    "scale",
    "rotation",
    "translation",
    "velocity",
    "start",
    "stop",
    "step",
    "viscosity",
    "density",
];
const ROTATION_KEYS: [&str; 2] = ["axis", "angle"];

pub(super) fn scene(text: &[u8], path: &Path) -> Parsed<Scene> {
    let root = json::parse(text)?;
    let fields = Fields::of(&root, "", "a scene", &SCENE_KEYS)?;
    let walls = fields.list("walls", "walls")?;
    let walls = walls.iter().enumerate().map(|(i, node)| wall(node, i)).collect::<Parsed<_>>()?;
    let fluids = fields.list("fluids", "fluid bodies")?;
    if fluids.is_empty() {
        return Err("`fluids`: an empty list, expected at least one fluid body".into());
    }
    Ok(Scene {
        path: path.to_path_buf(),
        walls,
        fluids: fluids.iter().enumerate().map(|(i, node)| fluid(node, i)).collect::<Parsed<_>>()?,
        gravity: fields.vector("gravity", Allowed::Any, "metres per second squared")?,
        dt: fields.number("dt", Allowed::Positive, "seconds between frames")?,
        particle_radius: fields.number("particle_radius", Allowed::Positive, "metres")?,
        material: material(&fields)?,
    })
}

fn wall(node: &Node, index: usize) -> Parsed<Wall> {
    let fields = Fields::of(node, &format!("walls[{index}]"), "a wall", &WALL_KEYS)?;
    Ok(Wall {
        source: source(&fields)?,
        placement: placement(&fields)?,
        invert_normals: fields.flag("invert_normals")?.unwrap_or(false),
    })
}

fn fluid(node: &Node, index: usize) -> Parsed<Fluid> {
    let fields = Fields::of(node, &format!("fluids[{index}]"), "a fluid", &FLUID_KEYS)?;
    let start = fields.step("start", 0)?.unwrap_or(0);
    let stop = fields.step("stop", 0)?.unwrap_or(start + 1);
    if stop <= start {
        return Err(format!(
            "`{}`: {stop}, expected more than `start` ({start}), or nothing is ever emitted",
            fields.at("stop")
        ));
    }
    Ok(Fluid {
        source: source(&fields)?,
        placement: placement(&fields)?,
        velocity: fields.vector("velocity", Allowed::Any, "metres per second")?,
        start,
        stop,
        step: fields.step("step", 1)?.unwrap_or(1),
        material: material(&fields)?,
    })
}

fn source(fields: &Fields<'_>) -> Parsed<Source> {
    let mesh = fields.text("path", "the path of a mesh file")?;
    let particles = fields.text("particles", "the path of a particle file")?;
    let shape = fields.text("shape", "the name of a built-in shape")?;
    match (mesh, particles, shape) {
        (Some(path), None, None) => Ok(Source::Mesh(path.into())),
        (None, Some(path), None) => Ok(Source::Particles(path.into())),
        (None, None, Some(name)) => match Shape::from_name(name) {
            Some(shape) => Ok(Source::Shape(shape)),
            None => Err(format!(
                "`{}`: `{}` is not a built-in shape, expected one of {}",
                fields.at("shape"),
                name.escape_debug(),
                Shape::ALL.map(Shape::name).join(", ")
            )),
        },
        _ => {
            let count = [mesh, particles, shape].iter().flatten().count();
            let at = fields.at("path");
            let at = at.trim_end_matches(".path");
            Err(format!("`{at}`: {count} of the keys path, particles and shape, expected one of them"))
        }
    }
}

fn placement(fields: &Fields<'_>) -> Parsed<Placement> {
    let scale = match fields.get("scale") {
        Some(Node::Number(_)) => {
            fields.number("scale", Allowed::Positive, "or three of them")?.map(|s| [s; 3])
        }
        _ => fields.vector("scale", Allowed::Positive, "or one for all axes")?,
    };
    let rotation = match fields.get("rotation") {
        Some(node) => Some(rotation(node, &fields.at("rotation"))?),
        None => None,
    };
    let translation = fields.vector("translation", Allowed::Any, "metres")?;
    Ok(Placement { scale: scale.unwrap_or([1.0; 3]), rotation, translation: translation.unwrap_or([0.0; 3]) })
}

fn rotation(node: &Node, path: &str) -> Parsed<Rotation> {
    let fields = Fields::of(node, path, "a rotation", &ROTATION_KEYS)?;
    let missing = |key| format!("no key `{}`, expected a rotation as axis and angle", fields.at(key));
    let axis = fields.vector("axis", Allowed::Any, "not all zero")?.ok_or_else(|| missing("axis"))?;
    let angle = fields.number("angle", Allowed::Any, "degrees")?.ok_or_else(|| missing("angle"))?;
    if axis == [0.0; 3] {
        return Err(format!("`{}`: all zero, expected a direction", fields.at("axis")));
    }
    Ok(Rotation { axis, angle })
}

fn material(fields: &Fields<'_>) -> Parsed<Material> {
    Ok(Material {
        viscosity: fields.number("viscosity", Allowed::NonNegative, "without unit")?,
        density: fields.number("density", Allowed::Positive, "kilograms per cubic metre")?,
    })
}
