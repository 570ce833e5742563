//! A part file frame by frame.

use std::io::Read;

use super::super::numbers::{Parsed, shown};
use super::Frame;
use super::msgpack::{Array, Head, Values};
use super::zst;
use crate::particles::Boundary;

/// No item is smaller, in bytes: its keys alone take that many.
const LEAST_ITEM: u64 = 100;

/// A part that is being read.
pub(super) struct PartReader<R: Read> {
    values: Values<R>,
    /// Items that the list claims to have.
    claimed: u64,
    /// Items that were read.
    done: u64,
    scene: String,
    walls: Boundary,
    /// The number and the particles of the frame before.
    last: Option<(u64, usize)>,
}

/// What an item of the list holds.
#[derive(Default)]
struct Item {
    number: Option<u64>,
    scene: Option<String>,
    walls: Option<Vec<[f32; 3]>>,
    normals: Option<Vec<[f32; 3]>>,
    position: Option<Vec<[f32; 3]>>,
    velocity: Option<Vec<[f32; 3]>>,
    mass: Option<Vec<f32>>,
    viscosity: Option<Vec<f32>>,
}

impl<R: Read> PartReader<R> {
    /// A part that is packed in `source`, which has `length` bytes.
    pub(super) fn new(source: R, length: u64) -> Parsed<PartReader<R>> {
        if length == 0 {
            return Err("empty (0 bytes), expected a zstd stream".into());
        }
        let mut values = Values::new(source, length);
        let claimed = match values.head("the list of frames")? {
            Head::List(0) => return Err("no frames: the list is empty".into()),
            Head::List(claimed) if claimed > zst::limit(length) / LEAST_ITEM => {
                return Err(format!("a list of {claimed} frames, more than {length} packed bytes can hold"));
            }
            Head::List(claimed) => claimed,
            _ => return Err("no msgpack list, expected one item a frame".into()),
        };
        let (scene, walls) = (String::new(), Boundary::default());
        Ok(PartReader { values, claimed, done: 0, scene, walls, last: None })
    }

    /// The number of frames that the file claims to have.
    pub(super) fn claimed(&self) -> u64 {
        self.claimed
    }

    /// The next frame; `None` after the last, when the file was found to be whole.
    pub(super) fn next(&mut self) -> Parsed<Option<Frame>> {
        if self.done == self.claimed {
            self.values.end(&format!("the list of {} frames", self.claimed))?;
            return Ok(None);
        }
        let mut item = Item::default();
        let frame = self.read_item(&mut item).and_then(|()| self.check(&mut item));
        let frame = frame.map_err(|message| match item.number {
            Some(number) => format!("frame {number}: {message}"),
            None => format!("item {} of {}: {message}", self.done, self.claimed),
        })?;
        self.last = Some((frame.number, frame.position.len()));
        self.done += 1;
        Ok(Some(frame))
    }

    /// The scene and the walls.
    pub(super) fn finish(self) -> (String, Boundary) {
        (self.scene, self.walls)
    }

    fn read_item(&mut self, item: &mut Item) -> Parsed<()> {
        let values = &mut self.values;
        let Head::Map(entries) = values.head("an item")? else {
            return Err("no msgpack map, expected the arrays of a frame".into());
        };
        for _ in 0..entries {
            let key = values.text("the keys of an item")?;
            match key.as_str() {
                "frame_id" => set(&mut item.number, &key, values.whole(&key)?)?,
                "scene_id" => set(&mut item.scene, &key, values.text("'scene_id'")?)?,
                "box" => set(&mut item.walls, &key, vectors(&values.array(&key)?, &key)?)?,
                "box_normals" => set(&mut item.normals, &key, vectors(&values.array(&key)?, &key)?)?,
                "pos" => set(&mut item.position, &key, vectors(&values.array(&key)?, &key)?)?,
                "vel" => set(&mut item.velocity, &key, vectors(&values.array(&key)?, &key)?)?,
                "m" => set(&mut item.mass, &key, numbers(&values.array(&key)?, &key)?)?,
                "viscosity" => set(&mut item.viscosity, &key, numbers(&values.array(&key)?, &key)?)?,
                _ => values.skip(&format!("'{}'", shown(&key)))?,
            }
        }
        Ok(())
    }

    /// The frame of an item, if it fits to those before.
    fn check(&mut self, item: &mut Item) -> Parsed<Frame> {
        let number = needed(item.number, "frame_id")?;
        let scene = needed(item.scene.take(), "scene_id")?;
        let position = needed(item.position.take(), "pos")?;
        let velocity = needed(item.velocity.take(), "vel")?;
        let mass = needed(item.mass.take(), "m")?;
        let viscosity = needed(item.viscosity.take(), "viscosity")?;
        let count = position.len();
        for (name, length) in [("vel", velocity.len()), ("m", mass.len()), ("viscosity", viscosity.len())] {
            if length != count {
                return Err(format!("array '{name}' has {length} particles, 'pos' has {count}"));
            }
        }
        match self.last {
            None => {
                let position = needed(item.walls.take(), "box")?;
                let normal = needed(item.normals.take(), "box_normals")?;
                if normal.len() != position.len() {
                    let (normals, walls) = (normal.len(), position.len());
                    return Err(format!("array 'box_normals' has {normals} particles, 'box' has {walls}"));
                }
                (self.scene, self.walls) = (scene, Boundary { position, normal });
            }
            Some((last, particles)) => {
                if number != last.saturating_add(1) {
                    return Err(format!("follows frame {last}, expected the one after it"));
                }
                if count != particles {
                    return Err(format!("{count} particles, expected {particles} as in the frames before"));
                }
                if scene != self.scene {
                    let (found, expected) = (shown(&scene), shown(&self.scene));
                    return Err(format!("scene '{found}', expected '{expected}' as in the frames before"));
                }
                let changed = |now: &Option<Vec<_>>, before| now.as_ref().is_some_and(|now| now != before);
                if changed(&item.walls, &self.walls.position) || changed(&item.normals, &self.walls.normal) {
                    return Err("'box' or 'box_normals' differ from those of the first item".into());
                }
            }
        }
        Ok(Frame { number, position, velocity, mass, viscosity })
    }
}

fn set<T>(place: &mut Option<T>, key: &str, value: T) -> Parsed<()> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => Err(format!("'{key}' is there twice")),
    }
}

fn needed<T>(value: Option<T>, key: &str) -> Parsed<T> {
    value.ok_or_else(|| format!("no '{key}'"))
}

/// The rows of an array of shape (N, 3).
fn vectors(array: &Array, name: &str) -> Parsed<Vec<[f32; 3]>> {
    let [_, 3] = array.shape[..] else {
        return Err(format!("array '{name}' has shape {:?}, expected [N, 3]", array.shape));
    };
    let values = array.floats(name)?;
    let rows = values.as_chunks::<3>().0;
    match rows.iter().position(|row| !row.iter().all(|value| value.is_finite())) {
        None => Ok(rows.to_vec()),
        Some(k) => Err(format!("array '{name}': particle {k} is {:?}, expected finite numbers", rows[k])),
    }
}

/// The numbers of an array of shape (N).
fn numbers(array: &Array, name: &str) -> Parsed<Vec<f32>> {
    let [_] = array.shape[..] else {
        return Err(format!("array '{name}' has shape {:?}, expected [N]", array.shape));
    };
    let values = array.floats(name)?;
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(values),
        Some(k) => Err(format!("array '{name}': particle {k} is {}, expected a finite number", values[k])),
    }
}
