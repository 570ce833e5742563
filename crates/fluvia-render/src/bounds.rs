//! Boxes around points.

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub low: [f64; 3],
    pub high: [f64; 3],
}

impl Bounds {
    pub const EMPTY: Bounds = Bounds { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    pub fn is_empty(&self) -> bool {
        self.low[0] > self.high[0]
    }

    pub fn add(&mut self, point: &[f64; 3]) {
        *self = self.with(point);
    }

    pub fn with(self, point: &[f64; 3]) -> Bounds {
        Bounds {
            low: std::array::from_fn(|k| self.low[k].min(point[k])),
            high: std::array::from_fn(|k| self.high[k].max(point[k])),
        }
    }

    pub fn contains(&self, point: &[f64; 3]) -> bool {
        (0..3).all(|k| self.low[k] <= point[k] && point[k] <= self.high[k])
    }

    pub fn size(&self) -> [f64; 3] {
        std::array::from_fn(|k| (self.high[k] - self.low[k]).max(0.0))
    }

    pub fn centre(&self) -> [f64; 3] {
        std::array::from_fn(|k| 0.5 * (self.low[k] + self.high[k]))
    }

    pub fn grown_by(&self, length: f64) -> Bounds {
        Bounds { low: self.low.map(|x| x - length), high: self.high.map(|x| x + length) }
    }

    /// Grown on each side by its largest side, and by `least`.
    pub fn grown(&self, least: f64) -> Bounds {
        self.grown_by(self.size().into_iter().fold(least, f64::max))
    }

    pub fn capped(mut self, top: Option<f32>) -> Bounds {
        if let Some(top) = top {
            self.high[1] = f64::from(top).max(self.low[1]);
        }
        self
    }

    pub fn corners(&self) -> [[f64; 3]; 8] {
        std::array::from_fn(|corner| {
            std::array::from_fn(|k| if corner >> k & 1 == 0 { self.low[k] } else { self.high[k] })
        })
    }
}

/// One particle in this many, on each side of each axis, does not count as central.
const FAR_FRACTION: usize = 500;

/// The box of all but the outermost points of each axis; `None` without points. Reorders `points`.
pub(crate) fn central_box(points: &mut [[f64; 3]]) -> Option<Bounds> {
    let last = points.len().checked_sub(1)?;
    let skip = points.len() / FAR_FRACTION;
    let mut bounds = Bounds::EMPTY;
    for k in 0..3 {
        bounds.low[k] = points.select_nth_unstable_by(skip, |a, b| a[k].total_cmp(&b[k])).1[k];
        bounds.high[k] = points.select_nth_unstable_by(last - skip, |a, b| a[k].total_cmp(&b[k])).1[k];
    }
    Some(bounds)
}
