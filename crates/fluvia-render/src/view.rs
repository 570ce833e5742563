//! From where a scene is looked at.

use crate::vector::finite;
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
    /// Where the camera stands, metres; `None`: where yaw and pitch say, far enough for a calm perspective.
    pub eye: Option<[f32; 3]>,
    /// The point in the middle of the picture, around which the camera turns, metres; `None`: that of the scene, which then
    /// fills the picture.
    pub look_at: Option<[f32; 3]>,
    /// The angle of view from the lower to the upper edge, degrees; `None`: as wide as what is to be seen.
    pub field_of_view: Option<f32>,
    /// How far the camera will be [`turned`](crate::Camera::turned) from its yaw, degrees: what is to be seen is seen all the way.
    pub sweep: f32,
}

/// The lowest and highest ratio of height to width that a camera chooses by itself.
pub(crate) const ASPECT: [f64; 2] = [0.4, 1.8];
/// The largest side of a picture, pixels: what viewers still open.
pub(crate) const MAX_SIDE: u32 = 16_384;
/// The ratio of height to width where the view is given and the height is not.
pub(crate) const USUAL_ASPECT: f64 = 9.0 / 16.0;
/// Steps of a sweep that are looked at, degrees.
pub(crate) const SWEEP_STEP: f32 = 7.5;
/// The widest angle of view, degrees: beyond it the edges are all that is seen.
const MAX_FIELD: f32 = 150.0;
/// The steepest pitch, degrees: straight up and down the horizontal directions are lost.
pub(crate) const MAX_PITCH: f32 = 89.0;

impl Default for View {
    fn default() -> View {
        View {
            yaw: 24.0,
            pitch: 18.0,
            width: 640,
            height: None,
            margin: 4,
            top: None,
            eye: None,
            look_at: None,
            field_of_view: None,
            sweep: 0.0,
        }
    }
}

/// Makes sure that a view is one.
pub(crate) fn check(view: &View) -> Result<()> {
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
    if !view.sweep.is_finite() {
        return Err(Error::parameter("turn of the camera in degrees", view.sweep, "a finite number"));
    }
    if let Some(angle) = view.field_of_view.filter(|angle| !(1.0..=MAX_FIELD).contains(angle)) {
        return Err(Error::parameter("angle of view in degrees", angle, "1 to 150"));
    }
    for (what, point) in
        [("place of the camera in metres", view.eye), ("point to look at in metres", view.look_at)]
    {
        if let Some(point) = point.filter(|point| !finite(point)) {
            return Err(Error::parameter(what, format!("{point:?}"), "finite numbers"));
        }
    }
    match view.top {
        Some(top) if !top.is_finite() => Err(Error::parameter("top in metres", top, "a finite number")),
        _ => Ok(()),
    }
}
