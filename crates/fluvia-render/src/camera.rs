//! The camera: a perspective view that frames the scene by itself.
//!
//! With the camera's axes r (right), u (up), b (back, to the viewer) and its eye e, a point p is at depth
//! d = -b·(p - e) and at the pixel x = f r·(p - e) / d + s_x, y = -f u·(p - e) / d + s_y (down). The focal
//! length f and the shift s are those at which what must be seen fills the image to its margins.

use crate::draw::Walls;
use crate::{Error, Result};

/// From where to look and how large the picture is.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The turn of the camera about the vertical, degrees; 0 looks along -z, positive goes towards +x.
    pub yaw: f32,
    /// How far the camera looks down, degrees, -89 to 89.
    pub pitch: f32,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels; `None`: as the scene needs, 0.4 to 1.8 times the width.
    pub height: Option<u32>,
    /// Free pixels at each edge.
    pub margin: u32,
    /// The highest point to show, metres; `None`: the highest particle.
    pub top: Option<f32>,
}

/// The lowest and highest ratio of height to width that a camera chooses by itself.
const ASPECT: [f64; 2] = [0.4, 1.8];
/// The largest side of a picture, pixels: what viewers still open.
const MAX_SIDE: u32 = 16_384;
/// The steepest pitch, degrees: straight up and down the horizontal directions are lost.
const MAX_PITCH: f32 = 89.0;

impl Default for View {
    fn default() -> View {
        View { yaw: 24.0, pitch: 18.0, width: 640, height: None, margin: 4, top: None }
    }
}

/// What a camera must show: the walls, and the particles of all frames.
#[derive(Clone, Debug)]
pub struct Subject<'a> {
    walls: Walls<'a>,
    radius: f32,
    up: [f32; 3],
    particles: Bounds,
}

impl<'a> Subject<'a> {
    /// The walls, and particles (to be added) of a radius in metres; y is up.
    pub fn new(walls: Walls<'a>, radius: f32) -> Subject<'a> {
        Subject { walls, radius, up: [0.0, 1.0, 0.0], particles: Bounds::EMPTY }
    }

    /// The same with another direction up: the opposite of gravity. To be called before [`Subject::add`].
    pub fn with_up(self, up: [f32; 3]) -> Subject<'a> {
        Subject { up, ..self }
    }

    /// Adds the particles of a frame. Those that are not finite, or so far from nearly all others that they
    /// must have been thrown out, are left out.
    pub fn add(&mut self, position: &[[f32; 3]]) {
        let upright = upright(self.up);
        let mut points: Vec<[f64; 3]> = position
            .iter()
            .filter(|p| p.iter().all(|x| x.is_finite()))
            .map(|&p| rotate(&upright, p.map(f64::from)))
            .collect();
        let Some(central) = central_box(&mut points) else { return };
        let reach = central.grown(2.0 * f64::from(self.radius));
        for point in points.iter().filter(|p| reach.contains(p)) {
            self.particles.add(point);
        }
    }
}

/// A perspective camera that looks at a [`Subject`].
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Rows: right, up, back (to the viewer) in the scene's coordinates. Float64, as scenes may lie far from
    /// the origin.
    axes: [[f64; 3]; 3],
    eye: [f64; 3],
    /// Pixels by which a metre at a distance of one metre is seen.
    focal: f64,
    shift: [f64; 2],
    near: f64,
    /// Depths of the scene's centre and of its farthest point, metres.
    middle: f64,
    far: f64,
    /// Up, a unit vector, and the height along it above which walls are cut away, metres.
    up: [f64; 3],
    top: f64,
    width: u32,
    height: u32,
}

/// Distance of the camera in horizontal diagonals of the scene: far enough for a calm perspective.
const DISTANCE: f64 = 4.0;
/// The same in diagonals of the whole scene, for tall and narrow ones.
const DISTANCE_TALL: f64 = 1.5;
/// The same in particle radii, for a scene as small as one particle.
const DISTANCE_LEAST: f64 = 20.0;
/// What is nearer than this part of the distance to the scene's centre is not drawn.
const NEAR: f64 = 0.3;

impl Camera {
    /// The camera that frames `subject`: the walls from the floor to the highest particle or to `view.top`,
    /// and the particles where there is no wall or the walls end below them.
    ///
    /// # Errors
    /// `Parameter` if the view is out of range.
    pub fn fit(subject: &Subject<'_>, view: &View) -> Result<Camera> {
        check(view)?;
        let radius = f64::from(subject.radius).max(f64::MIN_POSITIVE);
        let (points, top) = points_to_show(subject, view, radius);
        let bounds = points.iter().fold(Bounds::EMPTY, |bounds, p| bounds.with(p));
        let [wide, tall, deep] = bounds.size();
        let distance = (DISTANCE * wide.hypot(deep))
            .max(DISTANCE_TALL * wide.hypot(deep).hypot(tall))
            .max(DISTANCE_LEAST * radius);
        let axes = view_axes(view);
        let centre = bounds.centre();
        let eye = std::array::from_fn(|k| centre[k] + distance * axes[2][k]);
        let mut camera = Camera {
            axes,
            eye,
            focal: 1.0,
            shift: [0.0; 2],
            near: NEAR * distance,
            middle: distance,
            far: 0.0,
            up: upright(subject.up)[1],
            top,
            width: view.width,
            height: view.width,
        };
        camera.frame(&points, view, 2.0 * radius / distance);
        camera.far = points.iter().map(|&point| camera.project_wide(point)[2]).fold(distance, f64::max);
        let upright = upright(subject.up);
        camera.axes = camera.axes.map(|axis| rotate_back(&upright, axis));
        camera.eye = rotate_back(&upright, camera.eye);
        Ok(camera)
    }

    /// Width of the picture, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height of the picture, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Where the camera stands, metres.
    pub fn eye(&self) -> [f32; 3] {
        self.eye.map(|x| x as f32)
    }

    /// Pixels that a metre spans at a depth of one metre.
    pub fn focal(&self) -> f32 {
        self.focal as f32
    }

    /// The pixel (x right, y down, from the upper left corner) and the depth in metres at which a point is
    /// seen; `None` if it is not finite, behind the camera or too near to it.
    pub fn project(&self, point: [f32; 3]) -> Option<[f32; 3]> {
        let [x, y, depth] = self.project_wide(point.map(f64::from));
        let seen = depth > self.near && (x + y + depth).is_finite();
        seen.then_some([x as f32, y as f32, depth as f32])
    }

    /// The depth of the scene's centre, metres.
    pub(crate) fn middle(&self) -> f32 {
        self.middle as f32
    }

    /// The depth of the scene's farthest point, metres.
    pub(crate) fn far(&self) -> f32 {
        self.far as f32
    }

    /// Whether a wall point lies above the scene's top, where walls are cut away.
    pub(crate) fn cuts_away(&self, point: [f32; 3]) -> bool {
        (0..3).map(|k| self.up[k] * f64::from(point[k])).sum::<f64>() > self.top
    }

    /// A direction in the camera's axes: right, up, to the viewer.
    pub(crate) fn turn(&self, direction: [f32; 3]) -> [f32; 3] {
        rotate(&self.axes, direction.map(f64::from)).map(|x| x as f32)
    }

    /// Chooses focal length, shift and height so that `points` fill the picture to its margins; `least` is the
    /// least extent to fill it with, at a focal length of 1.
    fn frame(&mut self, points: &[[f64; 3]], view: &View, least: f64) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for &point in points {
            let [x, y, _] = self.project_wide(point);
            for (k, value) in [x, y].into_iter().enumerate() {
                low[k] = low[k].min(value);
                high[k] = high[k].max(value);
            }
        }
        // A scene without extent is shown as large as a particle.
        let span = [0, 1].map(|k| (high[k] - low[k]).max(least));
        let margin = f64::from(view.margin.min(view.width / 4));
        let width = f64::from(view.width);
        let natural = (width - 2.0 * margin) / span[0] * span[1] + 2.0 * margin;
        self.height = view.height.unwrap_or_else(|| {
            natural.clamp((ASPECT[0] * width).ceil(), ASPECT[1] * width).round().clamp(1.0, MAX_SIDE.into())
                as u32
        });
        let size = [width, f64::from(self.height)];
        let margins = [margin, margin.min(size[1] / 4.0)];
        self.focal = (0..2).map(|k| (size[k] - 2.0 * margins[k]) / span[k]).fold(f64::INFINITY, f64::min);
        self.shift = [0, 1].map(|k| size[k] / 2.0 - self.focal * (low[k] + high[k]) / 2.0);
    }

    fn project_wide(&self, point: [f64; 3]) -> [f64; 3] {
        let offset = std::array::from_fn(|k| point[k] - self.eye[k]);
        let [x, y, back] = rotate(&self.axes, offset);
        [self.shift[0] + self.focal * x / -back, self.shift[1] + self.focal * y / back, -back]
    }
}

fn check(view: &View) -> Result<()> {
    let sides =
        [("picture width in pixels", view.width), ("picture height in pixels", view.height.unwrap_or(1))];
    for (what, side) in sides {
        if !(1..=MAX_SIDE).contains(&side) {
            return Err(Error::parameter(what, side, "1 to 16384"));
        }
    }
    if !view.yaw.is_finite() {
        return Err(Error::parameter("yaw in degrees", view.yaw, "a finite number"));
    }
    if view.pitch.is_nan() || view.pitch.abs() > MAX_PITCH {
        return Err(Error::parameter("pitch in degrees", view.pitch, "-89 to 89"));
    }
    match view.top {
        Some(top) if !top.is_finite() => Err(Error::parameter("top in metres", top, "a finite number")),
        _ => Ok(()),
    }
}

/// The points that must lie inside the picture, y up, and the height of the scene's top.
fn points_to_show(subject: &Subject<'_>, view: &View, radius: f64) -> (Vec<[f64; 3]>, f64) {
    let upright = upright(subject.up);
    let walls: Vec<[f64; 3]> = subject
        .walls
        .position
        .iter()
        .filter(|p| p.iter().all(|x| x.is_finite()))
        .map(|&p| rotate(&upright, p.map(f64::from)))
        .collect();
    let particles = subject.particles.grown_by(radius);
    let bounds = walls.iter().fold(Bounds::EMPTY, |bounds, p| bounds.with(p));
    if bounds.is_empty() {
        let all = if particles.is_empty() { Bounds::EMPTY.with(&[0.0; 3]).grown_by(1.0) } else { particles };
        let all = all.capped(view.top);
        return (all.corners().to_vec(), all.high[1]);
    }
    // Above open walls particles may go as high again as the scene is large; beyond that they have been thrown out.
    let ceiling = bounds.high[1] + bounds.size().into_iter().fold(0.0, f64::max);
    let top = match view.top {
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

/// Right, up, back for a yaw and a pitch, y up.
fn view_axes(view: &View) -> [[f64; 3]; 3] {
    let (sy, cy) = f64::from(view.yaw).to_radians().sin_cos();
    let (sp, cp) = f64::from(view.pitch).to_radians().sin_cos();
    [[cy, 0.0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]]
}

/// The shortest rotation that turns `up` into +y; the identity if `up` has no direction.
fn upright(up: [f32; 3]) -> [[f64; 3]; 3] {
    let length = up.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    let [x, y, z] = up.map(|x| f64::from(x) / length);
    if !(x + y + z).is_finite() || y == 1.0 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    if y < -1.0 + 1e-9 {
        return [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
    }
    // Rodrigues' formula for the axis up × y = (-z, 0, x), whose length is the sine of the angle.
    let c = 1.0 / (1.0 + y);
    [[1.0 - c * x * x, -x, -c * x * z], [x, y, z], [-c * x * z, -z, 1.0 - c * z * z]]
}

fn rotate(rows: &[[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    rows.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2])
}

fn rotate_back(rows: &[[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| rows[0][k] * p[0] + rows[1][k] * p[1] + rows[2][k] * p[2])
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bounds {
    low: [f64; 3],
    high: [f64; 3],
}

impl Bounds {
    const EMPTY: Bounds = Bounds { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    fn is_empty(&self) -> bool {
        self.low[0] > self.high[0]
    }

    fn add(&mut self, point: &[f64; 3]) {
        *self = self.with(point);
    }

    fn with(self, point: &[f64; 3]) -> Bounds {
        Bounds {
            low: std::array::from_fn(|k| self.low[k].min(point[k])),
            high: std::array::from_fn(|k| self.high[k].max(point[k])),
        }
    }

    fn contains(&self, point: &[f64; 3]) -> bool {
        (0..3).all(|k| self.low[k] <= point[k] && point[k] <= self.high[k])
    }

    fn size(&self) -> [f64; 3] {
        std::array::from_fn(|k| (self.high[k] - self.low[k]).max(0.0))
    }

    fn centre(&self) -> [f64; 3] {
        std::array::from_fn(|k| 0.5 * (self.low[k] + self.high[k]))
    }

    fn grown_by(&self, length: f64) -> Bounds {
        Bounds { low: self.low.map(|x| x - length), high: self.high.map(|x| x + length) }
    }

    /// Grown on each side by its largest side, and by `least`.
    fn grown(&self, least: f64) -> Bounds {
        self.grown_by(self.size().into_iter().fold(least, f64::max))
    }

    fn capped(mut self, top: Option<f32>) -> Bounds {
        if let Some(top) = top {
            self.high[1] = f64::from(top).max(self.low[1]);
        }
        self
    }

    fn corners(&self) -> [[f64; 3]; 8] {
        std::array::from_fn(|corner| {
            std::array::from_fn(|k| if corner >> k & 1 == 0 { self.low[k] } else { self.high[k] })
        })
    }
}

/// One particle in this many, on each side of each axis, does not count as central.
const FAR_FRACTION: usize = 500;

/// The box of all but the outermost points of each axis; `None` without points. Reorders `points`.
fn central_box(points: &mut [[f64; 3]]) -> Option<Bounds> {
    let last = points.len().checked_sub(1)?;
    let skip = points.len() / FAR_FRACTION;
    let mut bounds = Bounds::EMPTY;
    for k in 0..3 {
        bounds.low[k] = points.select_nth_unstable_by(skip, |a, b| a[k].total_cmp(&b[k])).1[k];
        bounds.high[k] = points.select_nth_unstable_by(last - skip, |a, b| a[k].total_cmp(&b[k])).1[k];
    }
    Some(bounds)
}
