//! What is drawn: the particles of a moment, the surface of their liquid, walls, and what gives them colours.

use crate::color::{Ramp, Rgb, Scale, body_color};
use crate::vector::finite;

/// The particles of one moment.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frame<'a> {
    /// Positions, metres. Those that are not finite are not drawn.
    pub position: &'a [[f32; 3]],
    /// What gives the particles their colours.
    pub values: Values<'a>,
    /// Which particles are marked in orange (see [`OutsideTest`](crate::OutsideTest)); empty: none.
    pub outside: &'a [bool],
    /// The liquid's surface. It is drawn in place of the particles, but for those that are outside.
    pub surface: Option<Surface<'a>>,
}

/// The surface of a liquid: closed, its triangles counter-clockwise seen from outside.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surface<'a> {
    /// Vertices, metres. Triangles with one that is not finite are not drawn.
    pub position: &'a [[f32; 3]],
    /// Unit normals that point out of the liquid, one a vertex.
    pub normal: &'a [[f32; 3]],
    /// The vertices of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// What gives the vertices their colours; without values all are those of water.
    pub values: Values<'a>,
}

/// What gives particles, or vertices of a surface, their colours: nothing, or one entry each.
#[derive(Clone, Copy, Debug, Default)]
pub enum Values<'a> {
    /// All are the same grey.
    #[default]
    None,
    /// Numbers, coloured by [`Style::scale`](crate::Style::scale); those that are not finite are grey.
    Scalar(&'a [f32]),
    /// Indices of bodies, coloured by [`BODY_COLORS`](crate::BODY_COLORS).
    Body(&'a [u32]),
    /// The colours themselves.
    Color(&'a [Rgb]),
}

/// The wall particles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Walls<'a> {
    /// Positions, metres.
    pub position: &'a [[f32; 3]],
    /// Unit normals that point into the fluid: walls seen from behind are not drawn. Empty: all are drawn.
    pub normal: &'a [[f32; 3]],
}

impl Frame<'_> {
    /// The number of particles that are drawn in orange.
    pub fn outside_count(&self) -> usize {
        self.outside.iter().zip(self.position).filter(|(outside, p)| **outside && finite(p)).count()
    }

    /// The number of particles that have no place in the picture because their position is not finite.
    pub fn non_finite_count(&self) -> usize {
        self.position.iter().filter(|p| !finite(p)).count()
    }
}

impl Values<'_> {
    /// Their number; `all` if there are none.
    pub(crate) fn count(&self, all: usize) -> usize {
        match self {
            Values::None => all,
            Values::Scalar(values) => values.len(),
            Values::Body(bodies) => bodies.len(),
            Values::Color(colors) => colors.len(),
        }
    }

    /// The colour of an entry; `None` if there are no values, or none for it.
    pub(crate) fn color(&self, index: usize, scale: &Scale, ramp: &Ramp) -> Option<Rgb> {
        match self {
            Values::None => None,
            Values::Scalar(values) => scale.place(values[index]).map(|place| ramp.at(place)),
            Values::Body(bodies) => Some(body_color(bodies[index])),
            Values::Color(colors) => Some(colors[index]),
        }
    }
}
