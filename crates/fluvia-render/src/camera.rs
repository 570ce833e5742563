//! The camera: a perspective view that frames the scene by itself.
//!
//! With the camera's axes r (right), u (up), b (back, to the viewer) and its eye e, a point p is at depth
//! d = -b·(p - e) and at the pixel x = f r·(p - e) / d + s_x, y = -f u·(p - e) / d + s_y (down). The focal
//! length f and the shift s are those at which what must be seen fills the image to its margins.

use crate::bounds::Bounds;
use crate::subject::Subject;
use crate::upright::{rotate, rotate_back, upright};
use crate::vector::unit;
use crate::view::{ASPECT, MAX_PITCH, MAX_SIDE, SWEEP_STEP, USUAL_ASPECT, View, check};
use crate::{Error, Result};

/// A perspective camera that looks at a [`Subject`].
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Rows: right, up, back (to the viewer) in the scene's coordinates. Float64, as scenes may lie far from
    /// the origin.
    axes: [[f64; 3]; 3],
    eye: [f64; 3],
    /// What it turns around.
    pivot: [f64; 3],
    /// Pixels by which a metre at a distance of one metre is seen.
    focal: f64,
    shift: [f64; 2],
    near: f64,
    /// The middle of what is to be seen, and how far it reaches from there, metres.
    center: [f64; 3],
    reach: f64,
    /// The direction to the lamp, a unit vector.
    lamp: [f64; 3],
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
/// What is nearer than this many particle radii is not drawn, if the eye is given.
const NEAR_GIVEN: f64 = 4.0;

/// Particles farther from the scene's middle than this many times its reach cast no shadow.
const SHADOW_REACH: f64 = 2.0;

impl Camera {
    /// The camera that frames `subject`: the walls from the floor to the highest particle or to `view.top`,
    /// and the particles where there is no wall or the walls end below them.
    ///
    /// # Errors
    /// `Parameter` if the view is out of range, `OutOfView` if the camera stands or looks where it sees nothing.
    pub fn fit(subject: &Subject<'_>, view: &View) -> Result<Camera> {
        check(view)?;
        let radius = f64::from(subject.radius).max(f64::MIN_POSITIVE);
        let (points, top) = subject.points(view.top, radius);
        let bounds = points.iter().fold(Bounds::EMPTY, |bounds, p| bounds.with(p));
        let [wide, tall, deep] = bounds.size();
        let distance = (DISTANCE * wide.hypot(deep))
            .max(DISTANCE_TALL * wide.hypot(deep).hypot(tall))
            .max(DISTANCE_LEAST * radius);
        let upright = upright(subject.up);
        let given = |point: [f32; 3]| rotate(&upright, point.map(f64::from));
        let pivot = view.look_at.map_or_else(|| bounds.centre(), given);
        let (axes, eye) = match view.eye.map(given) {
            Some(eye) => (axes_from(eye, pivot)?, eye),
            None => {
                let axes = view_axes(view);
                (axes, std::array::from_fn(|k| pivot[k] + distance * axes[2][k]))
            }
        };
        let away = (0..3).map(|k| (eye[k] - pivot[k]).powi(2)).sum::<f64>().sqrt();
        let near = if view.eye.is_some() { NEAR_GIVEN * radius } else { NEAR * away };
        let mut camera = Camera {
            axes,
            eye,
            pivot,
            focal: 1.0,
            shift: [0.0; 2],
            near,
            center: bounds.centre(),
            reach: 0.5 * wide.hypot(deep).hypot(tall),
            lamp: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            top,
            width: view.width,
            height: view.width,
        };
        camera.frame(&points, view, 2.0 * radius / away)?;
        camera.axes = camera.axes.map(|axis| rotate_back(&upright, axis));
        camera.eye = rotate_back(&upright, camera.eye);
        camera.pivot = rotate_back(&upright, camera.pivot);
        camera.center = rotate_back(&upright, camera.center);
        camera.up = upright[1];
        camera.lamp = rotate_back(&upright, lamp(axes));
        Ok(camera)
    }

    /// The same camera turned about the vertical through what it looks at, degrees. The lamp stays where it is.
    pub fn turned(&self, degrees: f32) -> Camera {
        let mut camera = self.clone();
        let (sine, cosine) = f64::from(degrees).to_radians().sin_cos();
        let up = self.up;
        // Rodrigues' formula.
        let turn = |p: [f64; 3]| {
            let across =
                [up[1] * p[2] - up[2] * p[1], up[2] * p[0] - up[0] * p[2], up[0] * p[1] - up[1] * p[0]];
            let along = up[0] * p[0] + up[1] * p[1] + up[2] * p[2];
            std::array::from_fn(|k| p[k] * cosine + across[k] * sine + up[k] * along * (1.0 - cosine))
        };
        let offset = turn(std::array::from_fn(|k| self.eye[k] - self.pivot[k]));
        camera.eye = std::array::from_fn(|k| self.pivot[k] + offset[k]);
        camera.axes = self.axes.map(turn);
        camera
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

    /// The point that is seen at a pixel and a depth: the inverse of [`Camera::project`].
    pub(crate) fn unproject(&self, [x, y, depth]: [f32; 3]) -> [f32; 3] {
        let depth = f64::from(depth);
        let right = (f64::from(x) - self.shift[0]) * depth / self.focal;
        let up = (self.shift[1] - f64::from(y)) * depth / self.focal;
        let offset = rotate_back(&self.axes, [right, up, -depth]);
        std::array::from_fn(|k| (self.eye[k] + offset[k]) as f32)
    }

    /// Whether a point is in the scene or not far from it: what is farther away casts no shadow on it.
    pub(crate) fn is_near(&self, point: [f32; 3]) -> bool {
        let squared: f64 = (0..3).map(|k| (f64::from(point[k]) - self.center[k]).powi(2)).sum();
        squared.sqrt() <= SHADOW_REACH * self.reach
    }

    /// Up, a unit vector.
    pub(crate) fn up(&self) -> [f32; 3] {
        self.up.map(|x| x as f32)
    }

    /// The direction to the lamp, a unit vector.
    pub(crate) fn lamp(&self) -> [f32; 3] {
        self.lamp.map(|x| x as f32)
    }

    /// The height along [`Camera::up`] above which walls are cut away, metres.
    pub(crate) fn top(&self) -> f32 {
        self.top as f32
    }

    /// A direction in the camera's axes: right, up, to the viewer.
    pub(crate) fn turn(&self, direction: [f32; 3]) -> [f32; 3] {
        rotate(&self.axes, direction.map(f64::from)).map(|x| x as f32)
    }

    /// The direction that has these parts along the camera's axes: the inverse of [`Camera::turn`].
    pub(crate) fn to_world(&self, direction: [f32; 3]) -> [f32; 3] {
        rotate_back(&self.axes, direction.map(f64::from)).map(|x| x as f32)
    }

    /// The direction from a point to the eye, a unit vector.
    pub(crate) fn toward_eye(&self, point: [f32; 3]) -> [f32; 3] {
        unit(std::array::from_fn(|k| (self.eye[k] - f64::from(point[k])) as f32))
    }

    /// Chooses focal length, shift and height so that `points` fill the picture to its margins all the way of the
    /// sweep; `least` is the least extent to fill it with, at a focal length of 1.
    fn frame(&mut self, points: &[[f64; 3]], view: &View, least: f64) -> Result<()> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let steps = (view.sweep.abs().min(360.0) / SWEEP_STEP).ceil();
        let turn = |step: usize| {
            let part = if steps > 0.0 { step as f32 / steps } else { 0.0 };
            part * view.sweep.clamp(-360.0, 360.0)
        };
        for step in 0..=steps as usize {
            let camera = self.turned(turn(step));
            for &point in points {
                let [x, y, depth] = camera.project_wide(point);
                if depth <= self.near {
                    continue;
                }
                for (k, value) in [x, y].into_iter().enumerate() {
                    low[k] = low[k].min(value);
                    high[k] = high[k].max(value);
                }
            }
        }
        let is_given = view.eye.is_some() || view.look_at.is_some() || view.field_of_view.is_some();
        if is_given || view.sweep != 0.0 {
            // What is looked at is in the middle.
            let half = [0, 1].map(|k| low[k].abs().max(high[k].abs()));
            (low, high) = (half.map(|x| -x), half);
        }
        // A scene without extent is shown as large as a particle.
        let span = [0, 1].map(|k| (high[k] - low[k]).max(least));
        let margin = f64::from(view.margin.min(view.width / 4));
        let width = f64::from(view.width);
        let natural = match is_given {
            true => USUAL_ASPECT * width,
            false => (width - 2.0 * margin) / span[0] * span[1] + 2.0 * margin,
        };
        self.height = view.height.unwrap_or_else(|| {
            natural.clamp((ASPECT[0] * width).ceil(), ASPECT[1] * width).round().clamp(1.0, MAX_SIDE.into())
                as u32
        });
        let size = [width, f64::from(self.height)];
        let margins = [margin, margin.min(size[1] / 4.0)];
        self.focal = match view.field_of_view {
            Some(angle) => 0.5 * size[1] / (0.5 * f64::from(angle).to_radians()).tan(),
            None => (0..2).map(|k| (size[k] - 2.0 * margins[k]) / span[k]).fold(f64::INFINITY, f64::min),
        };
        self.shift = [0, 1].map(|k| size[k] / 2.0 - self.focal * (low[k] + high[k]) / 2.0);
        let is_placed = view.eye.is_some() || view.look_at.is_some();
        if is_placed && !(0..=steps as usize).any(|step| self.turned(turn(step)).may_see(points)) {
            return Err(Error::OutOfView);
        }
        Ok(())
    }

    /// Whether what lies between `points` may be in the picture: if they are not all behind the camera or all beyond
    /// the same edge.
    fn may_see(&self, points: &[[f64; 3]]) -> bool {
        // How far a point is behind the camera and beyond each edge. Not divided by the depth, which has no meaning
        // behind the camera.
        let beyond = |point: &[f64; 3]| {
            let [right, up, back] = self.seen(*point);
            let (x, y) = (self.focal * right - self.shift[0] * back, -self.focal * up - self.shift[1] * back);
            let (width, height) = (f64::from(self.width) * -back, f64::from(self.height) * -back);
            [self.near + back, -x, x - width, -y, y - height]
        };
        let least = points
            .iter()
            .map(beyond)
            .fold([f64::INFINITY; 5], |least, beyond| std::array::from_fn(|k| least[k].min(beyond[k])));
        least.iter().all(|&beyond| beyond <= 0.0)
    }

    /// A point in the camera's axes: right, up and to the viewer from the eye, metres.
    fn seen(&self, point: [f64; 3]) -> [f64; 3] {
        rotate(&self.axes, std::array::from_fn(|k| point[k] - self.eye[k]))
    }

    fn project_wide(&self, point: [f64; 3]) -> [f64; 3] {
        let [x, y, back] = self.seen(point);
        [self.shift[0] + self.focal * x / -back, self.shift[1] + self.focal * y / back, -back]
    }
}

/// Right, up, back for a yaw and a pitch, y up.
fn view_axes(view: &View) -> [[f64; 3]; 3] {
    let (sy, cy) = f64::from(view.yaw).to_radians().sin_cos();
    let (sp, cp) = f64::from(view.pitch).to_radians().sin_cos();
    [[cy, 0.0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]]
}

/// Right, up, back for a camera at `eye` that looks at `pivot`, y up.
fn axes_from(eye: [f64; 3], pivot: [f64; 3]) -> Result<[[f64; 3]; 3]> {
    let back: [f64; 3] = std::array::from_fn(|k| eye[k] - pivot[k]);
    let (flat, length) = (back[0].hypot(back[2]), back[0].hypot(back[2]).hypot(back[1]));
    let least = length * f64::from(MAX_PITCH).to_radians().cos();
    if flat <= least || !length.is_finite() {
        let found = format!("{:?} above or below what it looks at", eye.map(|x| x as f32));
        return Err(Error::parameter("place of the camera in metres", found, "a place beside it"));
    }
    let (sy, cy) = (back[0] / flat, back[2] / flat);
    let (sp, cp) = (back[1] / length, flat / length);
    Ok([[cy, 0.0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]])
}

/// How far the lamp stands to the right, above and before the scene as the camera first sees it.
const LAMP: [f64; 3] = [-0.55, 0.95, 0.42];

/// The direction to the lamp for a camera's axes, y up: a unit vector.
fn lamp([[cosine, _, sine], ..]: [[f64; 3]; 3]) -> [f64; 3] {
    let [right, up, before] = LAMP;
    let lamp = [right * cosine - before * sine, up, right * sine + before * cosine];
    let length = lamp.iter().map(|x| x * x).sum::<f64>().sqrt();
    lamp.map(|x| x / length)
}
