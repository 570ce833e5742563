//! What a camera must show.

use crate::bounds::{Bounds, central_box};
use crate::frame::Walls;
use crate::upright::{rotate, upright};
use crate::vector::finite;

/// What a camera must show: the walls, and the particles of all frames.
#[derive(Clone, Debug)]
pub struct Subject<'a> {
    walls: Vec<Walls<'a>>,
    pub(crate) radius: f32,
    pub(crate) up: [f32; 3],
    particles: Bounds,
}

impl<'a> Subject<'a> {
    /// The walls, and particles (to be added) of a radius in metres; y is up.
    pub fn new(walls: Walls<'a>, radius: f32) -> Subject<'a> {
        Subject { walls: vec![walls], radius, up: [0.0, 1.0, 0.0], particles: Bounds::EMPTY }
    }

    /// The same with another direction up: the opposite of gravity. To be called before [`Subject::add`].
    pub fn with_up(self, up: [f32; 3]) -> Subject<'a> {
        Subject { up, ..self }
    }

    /// Adds the walls of another scene that is seen by the same camera.
    pub fn add_walls(&mut self, walls: Walls<'a>) {
        self.walls.push(walls);
    }

    /// Adds the particles of a frame. Those that are not finite, or so far from nearly all others that they
    /// must have been thrown out, are left out.
    pub fn add(&mut self, position: &[[f32; 3]]) {
        let upright = upright(self.up);
        let mut points: Vec<[f64; 3]> =
            position.iter().filter(|p| finite(p)).map(|&p| rotate(&upright, p.map(f64::from))).collect();
        let Some(central) = central_box(&mut points) else { return };
        let reach = central.grown(2.0 * f64::from(self.radius));
        for point in points.iter().filter(|p| reach.contains(p)) {
            self.particles.add(point);
        }
    }

    /// The points that must lie inside the picture, y up, and the height of the scene's top: `top`, if it is given.
    pub(crate) fn points(&self, top: Option<f32>, radius: f64) -> (Vec<[f64; 3]>, f64) {
        let upright = upright(self.up);
        let walls: Vec<[f64; 3]> = self
            .walls
            .iter()
            .flat_map(|walls| walls.position)
            .filter(|p| finite(p))
            .map(|&p| rotate(&upright, p.map(f64::from)))
            .collect();
        let particles = self.particles.grown_by(radius);
        let bounds = walls.iter().fold(Bounds::EMPTY, |bounds, p| bounds.with(p));
        if bounds.is_empty() {
            let all =
                if particles.is_empty() { Bounds::EMPTY.with(&[0.0; 3]).grown_by(1.0) } else { particles };
            let all = all.capped(top);
            return (all.corners().to_vec(), all.high[1]);
        }
        // Above open walls particles may go as high again as the scene is large; beyond that they have been thrown
        // out.
        let ceiling = bounds.high[1] + bounds.size().into_iter().fold(0.0, f64::max);
        let top = match top {
            Some(top) => f64::from(top),
            None if particles.is_empty() => bounds.high[1],
            None => particles.high[1].min(ceiling),
        };
        // A view that ends below the walls would show none of them: show all.
        let below: Vec<[f64; 3]> = walls.iter().copied().filter(|p| p[1] <= top).collect();
        let (mut points, top) = if below.is_empty() { (walls, bounds.high[1]) } else { (below, top) };
        if top > bounds.high[1] && !particles.is_empty() {
            let over = Bounds {
                low: std::array::from_fn(|k| particles.low[k].clamp(bounds.low[k], bounds.high[k])),
                high: [
                    particles.high[0].clamp(bounds.low[0], bounds.high[0]),
                    top,
                    particles.high[2].clamp(bounds.low[2], bounds.high[2]),
                ],
            };
            points.extend(over.corners());
        }
        (points, top)
    }
}
