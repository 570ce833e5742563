//! What goes wrong in a run that goes on: each kind is told once.

use fluvia_sim::rollout::StepReport;

use crate::report::counted;

/// Which warnings have been given.
#[derive(Clone, Copy, Default)]
pub struct Warned {
    outside: bool,
    piled_up: bool,
    removed: bool,
    unconverged: bool,
}

impl Warned {
    /// The warnings that this step gives for the first time.
    pub fn new_ones(&mut self, step: &StepReport) -> Vec<String> {
        let frame = step.frame;
        let mut warnings = Vec::new();
        if step.outside > 0 && !std::mem::replace(&mut self.outside, true) {
            warnings.push(format!("step {frame}: {} outside the walls", counted(step.outside, "particle")));
        }
        if step.removed > 0 && !std::mem::replace(&mut self.removed, true) {
            let particles = counted(step.removed, "particle");
            warnings.push(format!("step {frame}: {particles} removed, fallen out of the scene"));
        }
        if step.solver.unconverged > 0 && !std::mem::replace(&mut self.unconverged, true) {
            warnings.push(format!("step {frame}: the solver stopped at its limit of iterations"));
        }
        if step.piled_up && !std::mem::replace(&mut self.piled_up, true) {
            warnings.push(format!(
                "step {frame}: particles pile up: one has {} neighbours within {} m",
                step.solver.max_neighbors, step.solver.neighbor_radius
            ));
        }
        warnings
    }
}

#[cfg(test)]
mod tests {
    use fluvia_sim::rollout::StepInfo;

    use super::*;

    #[test]
    fn each_kind_is_told_once() {
        let mut warned = Warned::default();
        assert_eq!(warned.new_ones(&StepReport { frame: 1, ..StepReport::default() }), [""; 0]);
        let solver =
            StepInfo { unconverged: 2, max_neighbors: 900, neighbor_radius: 0.1, ..StepInfo::default() };
        let bad = StepReport { frame: 2, outside: 1, solver, ..StepReport::default() };
        let told = warned.new_ones(&bad);
        assert_eq!(
            told,
            ["step 2: 1 particle outside the walls", "step 2: the solver stopped at its limit of iterations"]
        );
        let worse = StepReport { frame: 3, outside: 5, removed: 2, piled_up: true, ..bad };
        let told = warned.new_ones(&worse);
        assert_eq!(
            told,
            [
                "step 3: 2 particles removed, fallen out of the scene",
                "step 3: particles pile up: one has 900 neighbours within 0.1 m"
            ]
        );
        assert_eq!(warned.new_ones(&worse), [""; 0]);
    }
}
