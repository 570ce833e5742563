//! The parameters of position-based fluids, their defaults and their ranges.

use crate::rollout::positive;
use crate::substep::Substep;
use crate::{Error, Result};

/// Parameters of the solver. h is the support radius of the kernel, 4 particle radii.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// How a frame interval is divided (at most 4 ms).
    pub substep: Substep,
    /// With [`Substep::AtMost`]: how far the fastest particle may move in a substep, particle radii (1).
    pub travel: f32,
    /// Iterations a substep (7).
    pub iterations: u32,
    /// Factor of the multipliers' change in an iteration (0.6; undamped Jacobi, 1, overshoots).
    pub damping: f32,
    /// Part of an iteration's change that is repeated in the next (0.6; below 1; from 0.75 on a pool at rest trembles).
    pub momentum: f32,
    /// ε of Eq. 11 in 1 / h² (1): keeps the corrections of particles with few neighbours small.
    pub relaxation: f32,
    /// k of Eq. 13 in h² (5e-4): how strongly near pairs repel, against clumps.
    pub artificial_pressure: f32,
    /// c of Eq. 17 per second (2): a substep smooths velocities with c times its length, at most 1.
    pub viscosity: f32,
    /// Below this part of rest density (0.78) the fluid may be pressed together freely.
    pub loose_density: f32,
    /// Above it, by how much of rest density the target may grow, per second (0.25, as in the reference).
    pub compaction_rate: f32,
    /// By how much of rest density the target of fluid denser than at rest falls, per second (10).
    pub expansion_rate: f32,
    /// How far from the walls the centres of particles are kept, particle radii (0.5).
    pub wall_clearance: f32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            substep: Substep::AtMost(0.004),
            travel: 1.0,
            iterations: 7,
            damping: 0.6,
            momentum: 0.6,
            relaxation: 1.0,
            artificial_pressure: 5e-4,
            viscosity: 2.0,
            loose_density: 0.78,
            compaction_rate: 0.25,
            expansion_rate: 10.0,
            wall_clearance: 0.5,
        }
    }
}

impl Params {
    /// An error that names the first parameter out of range.
    pub(super) fn check(&self) -> Result<()> {
        positive("substep", self.substep.longest())?;
        positive("travel", self.travel)?;
        positive("damping", self.damping)?;
        positive("wall_clearance", self.wall_clearance)?;
        let not_negative = [
            ("relaxation", self.relaxation),
            ("artificial_pressure", self.artificial_pressure),
            ("viscosity", self.viscosity),
            ("loose_density", self.loose_density),
            ("compaction_rate", self.compaction_rate),
            ("expansion_rate", self.expansion_rate),
        ];
        for (name, value) in not_negative {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::Parameter(format!("{name} {value}, expected a number not below 0")));
            }
        }
        if !(0.0..1.0).contains(&self.momentum) {
            return Err(Error::Parameter(format!("momentum {}, expected 0 <= momentum < 1", self.momentum)));
        }
        Ok(())
    }
}
