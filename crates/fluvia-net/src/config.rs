//! What a set of weights was made for: everything that a solver needs beside the numbers.
//!
//! The channel counts are not here: the tensors have them.

use cconv::{Interpolation, Options, Window};

/// The smallest number of inputs of a fluid particle: the constant 1 and the velocity.
pub const BASE_INPUTS: usize = 4;

/// The inputs of a wall particle: its normal.
pub const WALL_INPUTS: usize = 3;

/// The configuration of a network. The default is that of the published model.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Cells of every filter: depth (z), height (y), width (x).
    pub filter_size: [usize; 3],
    /// How filters are looked up between their cells.
    pub interpolation: Interpolation,
    /// The window function of all convolutions (Eq. 8).
    pub window: Window,
    /// Whether each particle has a fully connected part of its own beside every convolution; without it the particle is one
    /// of its neighbours.
    pub fully_connected: bool,
    /// Names of the input features that follow the constant 1 and the velocity: "viscosity".
    pub extra_inputs: Vec<String>,
    /// Particle radius r, metres; the particle spacing is 2 r.
    pub particle_radius: f32,
    /// Filter radius R, metres: how far a particle sees. 4.5 r in the published model.
    pub filter_radius: f32,
    /// Seconds between frames.
    pub dt: f32,
    /// The external acceleration of the training data (Eq. 10), metres per second squared.
    pub gravity: [f32; 3],
    /// The viscosity of the training data (the coefficient of Bender & Koschier 2017, dimensionless); the
    /// value for a scene that gives none if viscosity is an input.
    pub viscosity: f32,
    /// The lowest and the highest viscosity of the training data, where it is an input and they are known.
    pub viscosity_range: Option<[f32; 2]>,
    /// The rest density of the training data, kilograms per cubic metre.
    pub density: f32,
    /// The factor between the last layer and the correction in metres.
    pub output_scale: f32,
    /// What the outputs correct.
    pub integration: Integration,
}

impl Default for Config {
    fn default() -> Config {
        Config {
            filter_size: [4; 3],
            interpolation: Interpolation::Linear,
            window: Window::Poly6,
            fully_connected: true,
            extra_inputs: Vec::new(),
            particle_radius: 0.025,
            filter_radius: 0.1125,
            dt: 0.02,
            gravity: [0.0, -9.81, 0.0],
            viscosity: 0.01,
            viscosity_range: None,
            density: 1000.0,
            output_scale: 1.0 / 128.0,
            integration: Integration::Paper,
        }
    }
}

impl Config {
    /// The options of all convolutions.
    pub fn options(&self) -> Options {
        Options {
            filter_size: self.filter_size,
            interpolation: self.interpolation,
            window: self.window,
            ..Options::default()
        }
    }

    /// How neighbours are searched for.
    pub(crate) fn search(&self) -> fluvia_neighbors::Options {
        fluvia_neighbors::Options { ignore_coincident: self.fully_connected, ..Default::default() }
    }

    /// The number of input features of a fluid particle.
    pub fn fluid_inputs(&self) -> usize {
        BASE_INPUTS + self.extra_inputs.len()
    }

    /// Says what is wrong with the values, if anything: `key value, expected ...`.
    pub(crate) fn fault(&self) -> Option<String> {
        let positive = [
            ("particle_radius", self.particle_radius),
            ("filter_radius", self.filter_radius),
            ("dt", self.dt),
            ("density", self.density),
            ("output_scale", self.output_scale),
        ];
        if let Some((key, value)) = positive.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return Some(format!("{key} is {value}, expected a number above 0"));
        }
        if !(self.viscosity.is_finite() && self.viscosity >= 0.0) {
            return Some(format!("viscosity is {}, expected a number of at least 0", self.viscosity));
        }
        if let Some(range @ [low, high]) = self.viscosity_range
            && !(0.0 <= low && low <= high && high.is_finite())
        {
            return Some(format!(
                "viscosity_range is {range:?}, expected two ascending numbers of at least 0"
            ));
        }
        if self.gravity.iter().any(|component| !component.is_finite()) {
            return Some(format!("gravity is {:?}, expected three finite numbers", self.gravity));
        }
        if self.filter_size.contains(&0) {
            return Some(format!(
                "filter_size is {:?}, expected at least one cell each way",
                self.filter_size
            ));
        }
        None
    }
}

/// What the outputs of the network correct; stored with the weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integration {
    /// Eq. 10-14: three outputs move the particle, its velocity is the distance moved over dt. The only mode
    /// for the published weights.
    Paper,
    /// Six outputs: three move the particle, three change the velocity at the frame time.
    Velocity,
}

impl Integration {
    /// The number of outputs of the last layer.
    pub fn outputs(self) -> usize {
        match self {
            Integration::Paper => 3,
            Integration::Velocity => 6,
        }
    }

    /// The name in files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Integration::Paper => "paper",
            Integration::Velocity => "velocity",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_named() {
        assert_eq!(Config::default().fault(), None);
        let fault = Config { dt: -0.02, ..Config::default() }.fault();
        assert_eq!(fault.as_deref(), Some("dt is -0.02, expected a number above 0"));
        assert!(Config { filter_size: [4, 0, 4], ..Config::default() }.fault().is_some());
        assert!(Config { density: f32::NAN, ..Config::default() }.fault().is_some());
    }
}
