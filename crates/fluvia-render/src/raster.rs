//! Triangles to samples: which samples of an image a triangle covers, and where in the triangle each lies.
//!
//! Corners are rounded to sixteenths of a sample and the edge functions
//! E(p) = (b - a) × (p - a) are integers, so that of two triangles with a common edge exactly one covers a sample on
//! it: a closed surface is crossed as often inwards as outwards at every sample.

/// Rows that one task draws: few enough to share the work, many enough that few shapes are cut.
pub(crate) const BAND: usize = 32;

/// Parts of a sample that corners are rounded to.
const PARTS: f32 = 16.0;
/// Half of a sample: its centre.
const CENTER: i64 = 8;
/// Corners farther out than this, in samples, would overflow; what they belong to is left out.
const FARTHEST: f32 = 1e7;

/// A triangle on the image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangle {
    corners: [[i64; 2]; 3],
    /// Twice the area, in square parts; positive.
    area: i64,
    /// Whether the corners were given counter-clockwise as seen on the image, whose y runs down.
    pub front: bool,
}

impl Triangle {
    /// The triangle with these corners (x right, y down, in samples); `None` if it has no area or lies too far out.
    pub fn new(corners: [[f32; 2]; 3]) -> Option<Triangle> {
        if !corners.iter().flatten().all(|x| x.abs() < FARTHEST) {
            return None;
        }
        let corners = corners.map(|corner| corner.map(|x| (x * PARTS).round() as i64));
        let [a, b, c] = corners;
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        (area != 0).then_some(Triangle { corners, area: area.abs(), front: area < 0 })
    }

    /// The first and the last row that it may cover.
    pub fn rows(&self) -> [i64; 2] {
        self.span(1)
    }

    fn span(&self, axis: usize) -> [i64; 2] {
        let [a, b, c] = self.corners.map(|corner| corner[axis]);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let part = PARTS as i64;
        [(low - CENTER).div_euclid(part), (high - CENTER).div_euclid(part) + 1]
    }

    /// Calls `cover` with each covered sample of the rows from `first` on that fit an image `width` wide: its place in
    /// those rows, and the shares of the second and third corner. With them a quantity is
    /// q_0 + s_1 (q_1 - q_0) + s_2 (q_2 - q_0).
    pub fn fill(&self, width: usize, first: usize, rows: usize, mut cover: impl FnMut(usize, f32, f32)) {
        let [left, right] = self.span(0);
        let [top, bottom] = self.span(1);
        let (left, right) = (left.max(0), right.min(width as i64 - 1));
        let (top, bottom) = (top.max(first as i64), bottom.min((first + rows) as i64 - 1));
        if left > right {
            return;
        }
        let sign = if self.front { -1 } else { 1 };
        let [a, b, c] = self.corners;
        let edges = [Edge::new(b, c, sign), Edge::new(c, a, sign), Edge::new(a, b, sign)];
        let part = PARTS as i64;
        let scale = 1.0 / self.area as f32;
        for y in top..=bottom {
            let at = [left * part + CENTER, y * part + CENTER];
            let mut values = edges.map(|edge| edge.value(at));
            let row = (y - first as i64) as usize * width;
            let mut entered = false;
            for x in left..=right {
                if (values[0] | values[1] | values[2]) >= 0 {
                    entered = true;
                    cover(row + x as usize, values[1] as f32 * scale, values[2] as f32 * scale);
                } else if entered {
                    // What has been left does not come again: triangles are convex.
                    break;
                }
                (0..3).for_each(|k| values[k] += edges[k].step);
            }
        }
    }
}

/// An edge function, not negative where a sample is inside or on an edge that counts as inside.
#[derive(Clone, Copy)]
struct Edge {
    from: [i64; 2],
    along: [i64; 2],
    bias: i64,
    /// What the value gains from a sample to the next on its right.
    step: i64,
}

impl Edge {
    fn new(from: [i64; 2], to: [i64; 2], sign: i64) -> Edge {
        let along = [sign * (to[0] - from[0]), sign * (to[1] - from[1])];
        // Of the two directions of an edge one counts as inside.
        let inside = along[1] < 0 || along[1] == 0 && along[0] > 0;
        Edge { from, along, bias: i64::from(inside) - 1, step: -along[1] * PARTS as i64 }
    }

    fn value(&self, at: [i64; 2]) -> i64 {
        self.along[0] * (at[1] - self.from[1]) - self.along[1] * (at[0] - self.from[0]) + self.bias
    }
}

/// Which shapes touch which band of `band` rows of an image: `order[starts[b]..starts[b + 1]]` touch band `b`, in
/// their order. `rows` says the first and the last row of a shape.
pub(crate) fn bands<T>(
    shapes: &[T],
    height: usize,
    band: usize,
    rows: impl Fn(&T) -> [i64; 2],
) -> (Vec<usize>, Vec<u32>) {
    let count = height.div_ceil(band);
    let touched = |shape: &T| {
        let [first, last] = rows(shape);
        if last < 0 || first >= height as i64 || first > last {
            return 0..0;
        }
        (first.max(0) as usize / band)..(last as usize / band + 1).min(count)
    };
    let mut starts = vec![0; count + 1];
    for shape in shapes {
        touched(shape).for_each(|band| starts[band + 1] += 1);
    }
    for band in 0..count {
        starts[band + 1] += starts[band];
    }
    let mut next = starts.clone();
    let mut order = vec![0; starts[count]];
    for (i, shape) in shapes.iter().enumerate() {
        for band in touched(shape) {
            order[next[band]] = i as u32;
            next[band] += 1;
        }
    }
    (starts, order)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn covered(corners: [[f32; 2]; 3], side: usize) -> Vec<u32> {
        let mut counts = vec![0; side * side];
        if let Some(triangle) = Triangle::new(corners) {
            triangle.fill(side, 0, side, |at, _, _| counts[at] += 1);
        }
        counts
    }

    #[test]
    fn shares_give_back_what_is_linear() {
        let corners = [[3.0, 2.5], [40.0, 11.0], [9.0, 50.0]];
        // Seen from either side.
        for corners in [corners, [corners[0], corners[2], corners[1]]] {
            let triangle = Triangle::new(corners).unwrap();
            let mut samples = 0;
            triangle.fill(64, 0, 64, |at, second, third| {
                for (k, place) in [(0, at % 64), (1, at / 64)] {
                    let [a, b, c] = corners.map(|corner| corner[k]);
                    // Corners are rounded to a sixteenth.
                    assert!((a + second * (b - a) + third * (c - a) - place as f32 - 0.5).abs() < 0.07);
                }
                samples += 1;
            });
            let area = triangle.area as f32 / (2.0 * PARTS * PARTS);
            assert!((samples as f32 - area).abs() < 0.05 * area, "{samples} samples, {area}");
        }
    }

    proptest! {
        #[test]
        fn a_fan_covers_its_samples_once(
            around in prop::collection::vec(0.2f32..1.0, 3..12),
            (x, y) in (20.0f32..44.0, 20.0f32..44.0),
        ) {
            // A star around a point: its triangles share edges and do not overlap.
            let count = around.len();
            let corner = |k: usize| {
                let angle = std::f32::consts::TAU * (k % count) as f32 / count as f32;
                [x + 30.0 * around[k % count] * angle.cos(), y + 30.0 * around[k % count] * angle.sin()]
            };
            let mut counts = vec![0; 64 * 64];
            for k in 0..count {
                let part = covered([[x, y], corner(k), corner(k + 1)], 64);
                counts.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            }
            prop_assert!(counts.iter().all(|&count| count <= 1));
            // And none is left out near the point in the middle.
            let (column, row) = (x as usize, y as usize);
            prop_assert_eq!(counts[row * 64 + column], 1);
        }
    }

    #[test]
    fn bands_hold_what_touches_them_in_order() {
        let spans = [[-9, -1], [0, 31], [31, 32], [95, 400], [20, 70], [5, 4]];
        let (starts, order) = bands(&spans, 100, 32, |span| *span);
        assert_eq!(starts, [0, 3, 5, 7, 8]);
        assert_eq!(order, [1, 2, 4, 2, 4, 3, 4, 3]);
        assert_eq!(bands(&spans, 0, 32, |span| *span).0, [0]);
    }
}
