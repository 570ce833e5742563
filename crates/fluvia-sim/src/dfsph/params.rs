//! The parameters of divergence-free SPH, their defaults and their ranges; what it reports.

use crate::rollout::positive;
use crate::substep::Substep;
use crate::{Error, Result};

/// Parameters of the solver. The defaults are those of the published data, but for the step, which was fixed there,
/// and the least number of iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// The solver's own step: at most 5 ms.
    pub substep: Substep,
    /// With [`Substep::AtMost`]: how far the fastest particle may move in a step, particle diameters (0.4).
    pub travel: f32,
    /// The mean compression at which the constant-density solver is done, as a part of rest density (1e-4).
    pub density_tolerance: f32,
    /// The mean compression within one step at which the divergence solver is done, as a part of rest density (1e-3).
    pub divergence_tolerance: f32,
    /// Iterations of the constant-density solver at least (3: with the 2 of the published data the mean compression is
    /// 1.6 times as high, for 7 % less time).
    pub min_iterations: u32,
    /// Iterations of either pressure solver at most (100).
    pub max_iterations: u32,
    /// The mean error of the strain rate at which the viscosity solver is done, per second (0.05).
    pub viscosity_tolerance: f32,
    /// Iterations of the viscosity solver at most (200).
    pub max_viscosity_iterations: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            substep: Substep::AtMost(0.005),
            travel: 0.4,
            density_tolerance: 1e-4,
            divergence_tolerance: 1e-3,
            min_iterations: 3,
            max_iterations: 100,
            viscosity_tolerance: 0.05,
            max_viscosity_iterations: 200,
        }
    }
}

impl Params {
    /// An error that names the first parameter out of range.
    pub(super) fn check(&self) -> Result<()> {
        positive("step", self.substep.longest())?;
        positive("travel", self.travel)?;
        positive("density_tolerance", self.density_tolerance)?;
        positive("divergence_tolerance", self.divergence_tolerance)?;
        positive("viscosity_tolerance", self.viscosity_tolerance)?;
        if self.max_iterations == 0 || self.max_iterations < self.min_iterations {
            let Params { min_iterations, max_iterations, .. } = self;
            return Err(Error::Parameter(format!(
                "max_iterations {max_iterations}, expected at least 1 and the min_iterations {min_iterations}"
            )));
        }
        Ok(())
    }
}

/// What one body of fluid is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Liquid {
    /// The coefficient of Bender & Koschier (2017), 0 to 1: the part of the strain rate that viscosity takes away in a
    /// step (0.01). What it does depends on the step; the published data have a fixed one of 1 ms.
    pub viscosity: f32,
    /// Rest density, kilograms per cubic metre (1000).
    pub density: f32,
}

impl Default for Liquid {
    fn default() -> Self {
        Liquid { viscosity: 0.01, density: 1000.0 }
    }
}

impl Liquid {
    /// An error that names what is out of range.
    pub(super) fn check(&self) -> Result<()> {
        positive("density", self.density)?;
        if !(0.0..=1.0).contains(&self.viscosity) {
            return Err(Error::Parameter(format!("viscosity {}, expected 0 to 1", self.viscosity)));
        }
        Ok(())
    }
}

/// How an iteration went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Solve {
    /// Iterations done.
    pub iterations: u32,
    /// The mean error that the last of them found: of the density as a part of rest density, of the divergence and of
    /// the strain rate per second.
    pub error: f32,
    /// Whether that is within the tolerance.
    pub converged: bool,
}

/// What one step of the solver's own did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepInfo {
    /// Its length, seconds.
    pub dt: f32,
    /// The divergence solver.
    pub divergence: Solve,
    /// The viscosity solver.
    pub viscosity: Solve,
    /// The constant-density solver.
    pub density: Solve,
}

impl StepInfo {
    /// How many of the solvers ended at their limit of iterations, short of their tolerance.
    pub fn unconverged(&self) -> u32 {
        [self.divergence, self.viscosity, self.density].iter().filter(|solve| !solve.converged).count() as u32
    }
}
