//! One picture: the liquid as shaded spheres or as a surface of water, and its walls, in the light of a lamp and a sky.
//!
//! ```text
//! walls, particles, surface -> Sky, Shadow        what light reaches
//!                           -> Shapes -> Layers   what each sample shows, band by band
//!                           -> Light              the colour of what a pixel shows, once for each thing in it
//! ```
//!
//! A pixel has several samples. They decide what it shows, and of each thing how much; its light is computed once, in the
//! middle of its samples.

use rayon::prelude::*;

use crate::camera::Camera;
use crate::color::{NO_VALUE, OUTSIDE, Ramp, Scale, linear};
use crate::frame::{Frame, Surface, Values};
use crate::image::Image;
use crate::layers::{self, Shapes};
use crate::light::{Lit, Scene, Shadow, Sky};
use crate::paint::{Painter, surface_points, wall_points};
use crate::shade::{Light, WATER};
use crate::stage::Stage;
use crate::vector::{Vec3, add, finite, scaled};
use crate::{Error, Result};

/// How things look.
#[derive(Clone, Debug, PartialEq)]
pub struct Style {
    /// Radius of a particle, metres.
    pub radius: f32,
    /// How [`Values::Scalar`] become colours.
    pub scale: Scale,
    /// Pixels a side that one pixel of the picture averages, 1 to 4.
    pub supersample: u32,
}

impl Default for Style {
    fn default() -> Style {
        Style { radius: 0.025, scale: Scale::speed(4.0), supersample: 3 }
    }
}

/// The largest picture, in samples: it takes about 40 bytes for each pixel while it is drawn, and as many for each
/// sample of the bands that are drawn at once.
const MAX_SAMPLES: u64 = 1 << 27;

/// How far over the middle of a sphere what covers it lies, in radii: over its own top.
const SPHERE_BIAS: f32 = 1.25;
/// How far over a surface the sky is looked at, in particle radii: over its own bumps.
const SKY_OFF: f32 = 0.6;

/// Draws the liquid and the walls as `camera` sees them. Particles that are not finite, behind the camera or
/// at it are left out.
///
/// # Errors
/// `Length` if a slice does not match the particles, `Parameter` if the style is out of range, a triangle has a vertex
/// that is not there or the picture is too large.
pub fn draw_frame(frame: &Frame<'_>, stage: &Stage, camera: &Camera, style: &Style) -> Result<Image> {
    check_frame(frame)?;
    check_style(style, camera)?;
    let ramp = Ramp::new();
    // What is thrown far out of the scene must not make the maps of the light coarse.
    let particles: Vec<Vec3> = frame.position.iter().copied().filter(|&p| camera.is_near(p)).collect();
    let surface = frame.surface.filter(|surface| !surface.triangles.is_empty());
    let scene = Scene {
        stage,
        particles: &particles,
        radius: style.radius,
        surface: surface.map(|surface| (surface.position, surface.triangles)),
    };
    let sky = Sky::new(&scene, camera.up());
    let shadow = Shadow::new(&scene, camera.lamp());

    let is_outside = |i: usize| frame.outside.get(i) == Some(&true);
    let spheres: Vec<(u32, Vec3)> = (0..frame.position.len())
        .filter(|&i| finite(&frame.position[i]) && (frame.surface.is_none() || is_outside(i)))
        .map(|i| (i as u32, frame.position[i]))
        .collect();
    let mut sphere_sky = vec![0.0; frame.position.len()];
    let mut sphere_lamp = vec![Lit::default(); frame.position.len()];
    let places: Vec<Vec3> = spheres.iter().map(|&(_, place)| place).collect();
    let lit = |&p: &Vec3| shadow.lit(p, camera.lamp(), SPHERE_BIAS * style.radius);
    let lamps: Vec<Lit> = places.par_iter().map(lit).collect();
    for ((&(i, _), seen), lamp) in spheres.iter().zip(sky.of_particles(&places)).zip(lamps) {
        (sphere_sky[i as usize], sphere_lamp[i as usize]) = (seen, lamp);
    }
    let sphere_color = |i: usize| match is_outside(i) {
        true => OUTSIDE,
        false => frame.values.color(i, &style.scale, &ramp).unwrap_or(NO_VALUE),
    };
    let vertex_color = |surface: &Surface<'_>, v: usize| match surface.values {
        Values::None => WATER,
        values => linear(values.color(v, &style.scale, &ramp).unwrap_or(NO_VALUE)),
    };
    let vertex_colors: Vec<Vec3> = surface.map_or_else(Vec::new, |surface| {
        (0..surface.position.len()).map(|v| vertex_color(&surface, v)).collect()
    });
    let tint = mean(&vertex_colors);
    let light = Light { lamp: camera.lamp(), up: camera.up(), tint, radius: style.radius };
    let off = SKY_OFF * style.radius;
    // Averaged: the sky's few directions would draw the shadows of particles on the walls.
    let wall_sky = stage.smoothed(&sky.of_surface(&stage.position, &stage.normal, off));
    let painter = Painter {
        camera,
        light,
        shadow: &shadow,
        stage,
        walls: wall_points(stage, &wall_sky),
        spheres: frame.position,
        outside: frame.outside,
        sphere_color: (0..frame.position.len()).map(|i| linear(sphere_color(i))).collect(),
        sphere_sky,
        sphere_lamp,
        surface: surface.unwrap_or_default(),
        vertices: surface.map_or_else(Vec::new, |surface| {
            let seen = sky.of_surface(surface.position, surface.normal, off);
            surface_points(&surface, &vertex_colors, &seen, &shadow, style.radius)
        }),
    };
    let shapes = |samples| Shapes::new(&spheres, surface.as_ref(), stage, camera, style.radius, samples);
    // Behind water one sample a pixel does: it is seen displaced and blurred.
    let behind = match surface {
        Some(_) => painter.behind(&shapes(1)),
        None => Vec::new(),
    };
    Ok(painter.paint(&shapes(style.supersample as usize), &behind))
}

/// The mean of colours; grey without any.
fn mean(colors: &[Vec3]) -> Vec3 {
    let sum = colors.iter().fold([0.0; 3], |sum, &color| add(sum, color));
    if colors.is_empty() { [1.0; 3] } else { scaled(sum, 1.0 / colors.len() as f32) }
}

fn check_frame(frame: &Frame<'_>) -> Result<()> {
    let marks = if frame.outside.is_empty() { frame.position.len() } else { frame.outside.len() };
    check_length("values of a frame", frame.values.count(frame.position.len()), frame.position.len())?;
    check_length("outside marks of a frame", marks, frame.position.len())?;
    let Some(surface) = &frame.surface else { return Ok(()) };
    let vertices = surface.position.len();
    check_length("normals of a surface", surface.normal.len(), vertices)?;
    check_length("values of a surface", surface.values.count(vertices), vertices)?;
    let highest = surface.triangles.iter().flatten().max().map_or(0, |&vertex| vertex as usize + 1);
    if highest > vertices || surface.triangles.len() > layers::SURFACE as usize {
        let found = format!("{} triangles, the highest vertex {highest}", surface.triangles.len());
        return Err(Error::parameter("triangles of a surface", found, "vertices that are there"));
    }
    Ok(())
}

fn check_length(what: &'static str, found: usize, expected: usize) -> Result<()> {
    if found == expected { Ok(()) } else { Err(Error::Length { what, found, expected }) }
}

fn check_style(style: &Style, camera: &Camera) -> Result<()> {
    if !(style.radius > 0.0 && style.radius.is_finite()) {
        return Err(Error::parameter("particle radius in metres", style.radius, "a positive number"));
    }
    if !(1..=4).contains(&style.supersample) {
        return Err(Error::parameter("supersampling", style.supersample, "1 to 4"));
    }
    let pixels = u64::from(camera.width()) * u64::from(camera.height());
    if pixels * u64::from(style.supersample).pow(2) > MAX_SAMPLES {
        let size = format!("{} x {}", camera.width(), camera.height());
        return Err(Error::parameter("picture size in pixels", size, "a smaller picture"));
    }
    Ok(())
}
