//! The arrays of a particle file as a reader found them, and the checks that every format shares.

use super::ParticleData;
use super::numbers::{Parsed, shown};

/// What an array of a particle file means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    Position,
    Velocity,
    Normal,
    Id,
    Body,
}

impl Quantity {
    /// The quantity that an attribute with `width` numbers a particle is by its name; `None` for those that are
    /// skipped. Names of one letter count only with the right width: they have other meanings too.
    pub(super) fn of_attribute(name: &str, width: usize) -> Option<Quantity> {
        match name.to_ascii_lowercase().as_str() {
            "velocity" | "velocities" | "vel" => Some(Quantity::Velocity),
            "normals" | "normal" => Some(Quantity::Normal),
            "id" | "ids" => Some(Quantity::Id),
            "body" => Some(Quantity::Body),
            "v" if width == 3 => Some(Quantity::Velocity),
            "n" if width == 3 => Some(Quantity::Normal),
            _ => None,
        }
    }

    /// Numbers a particle.
    fn width(self) -> usize {
        match self {
            Quantity::Position | Quantity::Velocity | Quantity::Normal => 3,
            Quantity::Id | Quantity::Body => 1,
        }
    }
}

/// One array: `width` numbers a particle, particle after particle.
#[derive(Debug, Default)]
struct Column {
    name: String,
    width: usize,
    values: Vec<f64>,
}

/// The arrays of a particle file.
#[derive(Debug, Default)]
pub(super) struct Columns([Option<Column>; 5]);

impl Columns {
    /// Whether there is an array for `quantity` already.
    pub(super) fn has(&self, quantity: Quantity) -> bool {
        self.0[quantity as usize].is_some()
    }

    /// Adds an array; of two for one quantity the first counts.
    pub(super) fn add(&mut self, quantity: Quantity, name: &str, width: usize, values: Vec<f64>) {
        let slot = &mut self.0[quantity as usize];
        if slot.is_none() {
            *slot = Some(Column { name: shown(name), width, values });
        }
    }

    /// Appends the arrays of `other`, the next piece of the same file.
    pub(super) fn append(&mut self, other: Columns) {
        for (mine, theirs) in self.0.iter_mut().zip(other.0) {
            match (mine.as_mut(), theirs) {
                (Some(mine), Some(theirs)) => mine.values.extend(theirs.values),
                (None, theirs) => *mine = theirs,
                (Some(_), None) => {}
            }
        }
    }

    /// The particles, if all arrays fit together and every number is finite.
    pub(super) fn check(self) -> Parsed<ParticleData> {
        let [position, velocity, normal, id, body] = self.0;
        let Some(position) = position else { return Err("no positions in this file".into()) };
        let position = vectors(position)?;
        let count = position.len();
        let same_length = |name: &str, found: usize| match found == count {
            true => Ok(()),
            false => Err(format!("array '{name}' has {found} particles, expected {count}")),
        };
        let vectors = |column: Option<Column>| {
            let Some(column) = column else { return Ok(None) };
            check_width(&column, Quantity::Velocity)?;
            same_length(&column.name, column.values.len() / 3)?;
            vectors(column).map(Some)
        };
        let integers = |column: Option<Column>| {
            let Some(column) = column else { return Ok(None) };
            check_width(&column, Quantity::Id)?;
            same_length(&column.name, column.values.len())?;
            integers(column).map(Some)
        };
        let (velocity, normal) = (vectors(velocity)?, vectors(normal)?);
        let (id, body) = (integers(id)?, integers(body)?);
        Ok(ParticleData { position, velocity, normal, id, body })
    }
}

/// Sorts the particles by identity, if they have one; equal ones stay in their order.
pub(super) fn sort_by_id(data: &mut ParticleData) {
    let Some(id) = data.id.as_ref().filter(|id| !id.is_sorted()) else { return };
    let mut order: Vec<usize> = (0..id.len()).collect();
    order.sort_by_key(|&i| id[i]);
    reorder(&mut data.position, &order);
    for vectors in [&mut data.velocity, &mut data.normal].into_iter().flatten() {
        reorder(vectors, &order);
    }
    for integers in [&mut data.id, &mut data.body].into_iter().flatten() {
        reorder(integers, &order);
    }
}

fn reorder<T: Copy>(values: &mut Vec<T>, order: &[usize]) {
    *values = order.iter().map(|&i| values[i]).collect();
}

fn check_width(column: &Column, quantity: Quantity) -> Parsed<()> {
    let expected = quantity.width();
    if column.width != expected {
        return Err(format!(
            "array '{}' has {} values a particle, expected {expected}",
            column.name, column.width
        ));
    }
    Ok(())
}

fn vectors(column: Column) -> Parsed<Vec<[f32; 3]>> {
    check_width(&column, Quantity::Position)?;
    let (rows, rest) = column.values.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(format!("array '{}' has {} values, no multiple of 3", column.name, column.values.len()));
    }
    let row = |(particle, row): (usize, &[f64; 3])| {
        let vector = row.map(|value| value as f32);
        match vector.iter().all(|value| value.is_finite()) {
            true => Ok(vector),
            false => Err(format!(
                "array '{}': particle {particle} is {row:?}, expected finite numbers (float32)",
                column.name
            )),
        }
    };
    rows.iter().enumerate().map(row).collect()
}

fn integers(column: Column) -> Parsed<Vec<u32>> {
    let integer = |(particle, &value): (usize, &f64)| {
        // A cast of a float saturates, so what is out of range or has a fraction does not come back equal.
        let integer = value as u32;
        match f64::from(integer) == value {
            true => Ok(integer),
            false => Err(format!(
                "array '{}': particle {particle} is {value}, expected a whole number from 0 to {}",
                column.name,
                u32::MAX
            )),
        }
    };
    column.values.iter().enumerate().map(integer).collect()
}
