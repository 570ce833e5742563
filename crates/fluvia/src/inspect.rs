//! `fluvia inspect`: what is in a file, in the directory of a run or in a data set.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use fluvia_net::weights::{self, Summary as WeightSummary};
use fluvia_sim::frames::{self, Format, ParticleData, run, sequence};
use fluvia_sim::mesh::TriangleMesh;
use fluvia_sim::metrics;
use fluvia_sim::scene::{DEFAULT_DT, Placement};
use serde_json::{Value, json};

use crate::data_set;
use crate::frame_source::NO_FRAMES;
use crate::options::positive;
use crate::record::{self, bounds, decimal};
use crate::report::Report;
use crate::trained;

/// Options of `fluvia inspect`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia inspect pretrained_model_weights.pt
  fluvia inspect default
  fluvia inspect out/dam
  fluvia inspect data/valid/sim_0206
  fluvia inspect data
  fluvia inspect scene.json --json")]
pub struct Args {
    /// Weights (.pt, .h5, .safetensors), a scene (.json), particles or a frame (.npz, .ply, .bgeo, .vtu, .vtk), a
    /// mesh (.obj, .ply, .stl), the directory of a run, a sequence (its folder, a part file, or the common prefix of its
    /// parts), the folder of a data set, or the name of a shipped scene or of shipped weights (default, viscosity).
    path: PathBuf,
    /// Seconds between the frames of sequences, which do not record it.
    #[arg(long, value_name = "SECONDS", value_parser = positive, default_value_t = DEFAULT_DT)]
    dt: f32,
    /// Print a JSON object.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let path = &args.path;
    let found = if path.is_dir() { directory(path, args.dt, report)? } else { file(path, args.dt)? };
    if args.json {
        report.result(serde_json::to_string(&found)?)?;
    } else {
        let mut lines = Vec::new();
        describe(&found, 0, &mut lines);
        report.result(lines.join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn file(path: &Path, dt: f32) -> Result<Value> {
    if let Some(files) = sequence::find(path)?.pop() {
        return data_set::sequence(files, dt);
    }
    if let Some(bytes) = trained::shipped(path) {
        return Ok(weight_file(&weights::summarize_bytes(path, bytes.to_vec())?));
    }
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    match extension.to_ascii_lowercase().as_str() {
        "pt" | "pth" | "h5" | "hdf5" | "keras" | "safetensors" => Ok(weight_file(&weights::summarize(path)?)),
        "json" => scene(&path.display().to_string()),
        "" if !path.exists() => scene(&path.display().to_string()),
        "obj" | "stl" => Ok(mesh_file(&TriangleMesh::load(path)?)),
        // A PLY file holds a mesh if it has faces, and particles otherwise.
        "ply" => match frames::read(path) {
            Ok(particles) => match TriangleMesh::load(path) {
                Ok(mesh) => Ok(mesh_file(&mesh)),
                Err(error) if has_faces(path)? => Err(error.into()),
                Err(_) => Ok(particle_file(&particles)),
            },
            Err(error) => TriangleMesh::load(path).map(|mesh| mesh_file(&mesh)).map_err(|_| error.into()),
        },
        _ if !path.exists() => bail!("{}: No such file or directory", path.display()),
        _ if Format::from_path(path).is_some() => Ok(particle_file(&frames::read(path)?)),
        _ => bail!(
            "{}: not a kind of file that is known by its name, expected weights (.pt, .h5, .safetensors), a scene \
             (.json), particles (.npz, .ply, .bgeo, .vtu, .vtk), a mesh (.obj, .ply, .stl) or a part of a sequence \
             (.msgpack.zst)",
            path.display()
        ),
    }
}

fn weight_file(summary: &WeightSummary) -> Value {
    let tensors: Vec<Value> = summary
        .tensors
        .iter()
        .map(|tensor| {
            let mut entry = json!({ "name": tensor.name, "shape": tensor.shape, "type": tensor.element });
            if let Some(s) = tensor.statistics {
                entry["range"] = json!([decimal(s.min as f32), decimal(s.max as f32)]);
                entry["mean"] = json!(decimal(s.mean as f32));
                if s.non_finite > 0 {
                    entry["not_finite"] = json!(s.non_finite);
                }
            }
            entry
        })
        .collect();
    let metadata: serde_json::Map<String, Value> =
        summary.metadata.iter().map(|(key, value)| (key.clone(), unpacked(value))).collect();
    json!({
        "kind": "weights",
        "format": summary.kind.to_string(),
        "parameters": summary.parameters(),
        "metadata": metadata,
        "tensors": tensors,
    })
}

/// A text, or the object that it is the JSON of, with the texts in that: metadata are texts, and so are training records
/// in them.
fn unpacked(text: &str) -> Value {
    match serde_json::from_str(text) {
        Ok(Value::Object(entries)) => {
            let unpack = |value| match value {
                Value::String(text) => unpacked(&text),
                value => value,
            };
            Value::Object(entries.into_iter().map(|(key, value)| (key, unpack(value))).collect())
        }
        _ => json!(text),
    }
}

fn scene(name: &str) -> Result<Value> {
    let (scene, _) = record::load_scene(name)?;
    let setup = scene.sample(0)?;
    let walls: Vec<Value> = scene
        .walls
        .iter()
        .zip(&setup.walls)
        .map(|(wall, sampled)| {
            let mut entry = json!({ "source": wall.source.name(), "particles": sampled.range.len() });
            place(&mut entry, &wall.placement);
            entry
        })
        .collect();
    let fluids: Vec<Value> = scene
        .fluids
        .iter()
        .zip(&setup.emitters)
        .map(|(fluid, emitter)| {
            let mut entry = json!({
                "source": fluid.source.name(),
                "particles": emitter.position.len(),
                "bounds_m": bounds(&emitter.position),
            });
            place(&mut entry, &fluid.placement);
            if let Some(velocity) = fluid.velocity {
                entry["velocity_m_per_s"] = json!(velocity.map(decimal));
            }
            entry["steps"] =
                json!(format!("from {} before {} every {}", fluid.start, fluid.stop, fluid.step));
            entry
        })
        .collect();
    Ok(json!({
        "kind": "scene",
        "walls": walls,
        "wall_bounds_m": bounds(&setup.boundary.position),
        "fluids": fluids,
        "gravity_m_per_s2": setup.gravity.map(decimal),
        "dt_s": decimal(setup.dt),
        "particle_radius_m": decimal(setup.particle_radius),
        "warnings": setup.warnings(),
    }))
}

/// Adds where a body is put, as far as it is not where its file has it.
fn place(entry: &mut Value, placement: &Placement) {
    if placement.scale != [1.0; 3] {
        entry["scale"] = json!(placement.scale.map(decimal));
    }
    if let Some(rotation) = placement.rotation {
        let axis = rotation.axis.map(decimal);
        entry["rotation"] = json!({ "axis": axis, "angle_degrees": decimal(rotation.angle) });
    }
    if placement.translation != [0.0; 3] {
        entry["translation_m"] = json!(placement.translation.map(decimal));
    }
}

/// Whether the header of a PLY file names faces.
fn has_faces(path: &Path) -> Result<bool> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let lines = bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let mut header = lines.take_while(|line| *line != b"end_header");
    Ok(header.any(|line| line.starts_with(b"element face") && !line.ends_with(b" 0")))
}

fn mesh_file(mesh: &TriangleMesh) -> Value {
    let open = mesh.open_edges();
    let mut found = json!({
        "kind": "mesh",
        "vertices": mesh.positions.len(),
        "triangles": mesh.triangles.len(),
        "bounds_m": mesh.bounds(),
        "area_m2": mesh.area(),
        "open_edges": open,
    });
    if open == 0 {
        found["volume_m3"] = json!(mesh.volume());
    }
    found
}

fn particle_file(particles: &ParticleData) -> Value {
    let mut found = json!({
        "kind": "particles",
        "particles": particles.position.len(),
        "bounds_m": bounds(&particles.position),
    });
    if let Some(velocity) = &particles.velocity {
        found["highest_speed_m_per_s"] = json!(decimal(metrics::highest_speed(velocity)));
    }
    let columns = [
        ("velocity", particles.velocity.is_some()),
        ("normal", particles.normal.is_some()),
        ("id", particles.id.is_some()),
        ("body", particles.body.is_some()),
    ];
    let names: Vec<&str> = columns.iter().filter(|(_, there)| *there).map(|(name, _)| *name).collect();
    found["columns"] = json!(names);
    found
}

fn directory(path: &Path, dt: f32, report: &Report) -> Result<Value> {
    let files = run::list(path)?;
    let (Some(first), Some(last)) = (files.first(), files.last()) else {
        let data_set = data_set::folder(path, dt, report)?;
        return data_set.with_context(|| format!("{}: {NO_FRAMES}", path.display()));
    };
    let record_path = path.join(run::RECORD);
    let record: Value = if record_path.exists() { frames::read_json(&record_path)? } else { Value::Null };
    let mut formats: Vec<&str> = files.iter().map(|file| file.format.extension()).collect();
    formats.sort_unstable();
    formats.dedup();
    Ok(json!({
        "kind": "run",
        "frames": format!("{} to {}", first.index, last.index),
        "formats": formats,
        "wall_particles": run::read_walls(path)?.map(|walls| walls.position.len()),
        "last_frame": particle_file(&run::read_frame(path, last.index)?),
        "run": record,
    }))
}

/// Indented lines for a value: objects key by key, tables row by row.
fn describe(value: &Value, indent: usize, lines: &mut Vec<String>) {
    let Value::Object(entries) = value else {
        lines.push(format!("{:indent$}{}", "", plain(value)));
        return;
    };
    for (key, value) in entries {
        match value {
            Value::Null => {}
            Value::Object(entries) if entries.is_empty() => {}
            Value::Object(_) => {
                lines.push(format!("{:indent$}{key}:", ""));
                describe(value, indent + 2, lines);
            }
            Value::Array(items) if items.iter().any(|item| item.is_object() || item.is_string()) => {
                lines.push(format!("{:indent$}{key}:", ""));
                for item in items {
                    let row = match item {
                        Value::Object(entries) => {
                            let cells = entries.iter().map(|(key, value)| format!("{key} {}", plain(value)));
                            cells.collect::<Vec<_>>().join(", ")
                        }
                        _ => plain(item),
                    };
                    lines.push(format!("{:indent$}  {row}", ""));
                }
            }
            _ => lines.push(format!("{:indent$}{key}: {}", "", plain(value))),
        }
    }
}

/// A value in one line; texts without quotation marks.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        _ => value.to_string(),
    }
}
