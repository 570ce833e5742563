//! One simulation of a show: its state, its solver, and what became of it.

use std::time::Instant;

use anyhow::Result;
use fluvia_sim::rollout::{Rollout, Solver};

use crate::report::one_line;
use crate::warnings::Warned;

/// The part of the newest step in the mean time of a step: the mean of about the last second.
const NEWEST: f64 = 0.05;

pub struct Panel {
    /// The place of its solver in the menu.
    pub offer: usize,
    pub solver: Box<dyn Solver + Send>,
    pub rollout: Rollout,
    /// The mean time of a step, milliseconds; 0 before the first.
    pub ms_per_step: f64,
    /// Why it stands still.
    pub error: Option<String>,
    /// What went wrong without an end to it, since it began or another solver went on.
    pub warnings: Vec<String>,
    warned: Warned,
    /// Of the frame, if it is up to date.
    pub density: Vec<f32>,
}

impl Panel {
    pub fn new(offer: usize, solver: Box<dyn Solver + Send>, rollout: Rollout) -> Panel {
        Panel {
            offer,
            solver,
            rollout,
            ms_per_step: 0.0,
            error: None,
            warnings: Vec::new(),
            warned: Warned::default(),
            density: Vec::new(),
        }
    }

    /// Takes a step, unless one has failed; a failure is kept. Whether it did.
    pub fn advance(&mut self) -> bool {
        if self.error.is_some() {
            return false;
        }
        let start = Instant::now();
        match self.rollout.advance(self.solver.as_mut()) {
            Ok(step) => {
                let ms = 1e3 * start.elapsed().as_secs_f64();
                let is_first = self.ms_per_step == 0.0;
                self.ms_per_step =
                    if is_first { ms } else { ms * NEWEST + self.ms_per_step * (1.0 - NEWEST) };
                self.density.clear();
                self.warnings.extend(self.warned.new_ones(&step));
                true
            }
            Err(error) => {
                self.error = Some(one_line(&error.into()));
                false
            }
        }
    }

    /// Goes on with another solver.
    pub fn change(&mut self, offer: usize, solver: Box<dyn Solver + Send>) {
        if offer != self.offer {
            self.rollout.forget();
        }
        (self.offer, self.solver, self.ms_per_step) = (offer, solver, 0.0);
        self.forgive();
    }

    /// Begins again.
    pub fn restart(&mut self, rollout: Rollout) {
        self.rollout = rollout;
        self.density.clear();
        self.forgive();
    }

    /// Goes on from where another simulation is.
    pub fn catch_up(&mut self, rollout: Rollout) {
        self.restart(rollout);
        self.rollout.forget();
    }

    /// What went wrong went wrong before.
    fn forgive(&mut self) {
        (self.error, self.warned) = (None, Warned::default());
        self.warnings.clear();
    }

    /// Adds a body.
    pub fn add(&mut self, position: &[[f32; 3]], body: usize) -> Result<()> {
        self.rollout.add(position, [0.0; 3], body)?;
        self.density.clear();
        Ok(())
    }

    /// The frame for the page.
    pub fn shown(&self, with_density: bool) -> fluvia_view::Panel<'_> {
        let particles = &self.rollout.state().particles;
        fluvia_view::Panel {
            position: &particles.position,
            velocity: &particles.velocity,
            density: if with_density { &self.density } else { &[] },
            body: &particles.body,
            ms_per_step: self.ms_per_step as f32,
        }
    }

    pub fn position(&self) -> &[[f32; 3]] {
        &self.rollout.state().particles.position
    }
}

#[cfg(test)]
pub mod tests {
    use fluvia_sim::particles::{Acceleration, Boundary, Particles};
    use fluvia_sim::rollout::StepInfo;
    use fluvia_sim::scene::{Emitter, Material, Setup};

    use super::*;

    /// Throws a particle out of the walls in its second step, and out of the numbers in its third; so many are behind it.
    pub struct Explodes(pub u32);

    impl Solver for Explodes {
        fn name(&self) -> &'static str {
            "explodes"
        }

        fn step(
            &mut self,
            particles: &mut Particles,
            _: Acceleration<'_>,
            _: f32,
        ) -> fluvia_sim::Result<StepInfo> {
            self.0 += 1;
            match self.0 {
                2 => particles.position[0] = [9.0; 3],
                3 => particles.position[0][1] = f32::NAN,
                _ => {}
            }
            Ok(StepInfo::default())
        }
    }

    #[test]
    fn what_fails_stands_still_until_it_begins_again_or_another_solver_goes_on() {
        let emitter = Emitter {
            source: "one".into(),
            path: None,
            position: vec![[0.0; 3]],
            velocity: vec![[0.0; 3]],
            unused_velocity: None,
            start: 0,
            stop: 1,
            step: 1,
            material: Material::default(),
        };
        let setup = Setup {
            boundary: Boundary { position: vec![[-1.0; 3], [1.0; 3]], normal: vec![[0.0, 1.0, 0.0]; 2] },
            walls: Vec::new(),
            emitters: vec![emitter],
            gravity: [0.0; 3],
            dt: 0.02,
            particle_radius: 0.025,
        };
        let rollout = Rollout::new(&setup).unwrap();
        let mut panel = Panel::new(0, Box::new(Explodes(0)), rollout.clone());
        assert!(panel.advance() && panel.warnings.is_empty());
        assert!(panel.advance());
        assert_eq!(panel.warnings, ["step 2: 1 particle outside the walls"]);
        assert!((0..3).all(|_| !panel.advance()));
        let error = panel.error.clone().unwrap();
        assert!(error.contains("step 3") && error.contains("position"), "{error}");
        assert_eq!((panel.rollout.state().step, panel.position()), (2, &[[9.0; 3]][..]));
        assert_eq!(panel.warnings.len(), 1, "they stay");
        // Another solver begins with what it finds, which it is told of again.
        panel.change(1, Box::new(Explodes(9)));
        assert!(panel.warnings.is_empty());
        assert!(panel.advance() && panel.error.is_none());
        assert_eq!(panel.warnings, ["step 3: 1 particle outside the walls"]);
        panel.change(0, Box::new(Explodes(2)));
        assert!(!panel.advance() && panel.error.is_some());
        panel.restart(rollout);
        assert!(panel.warnings.is_empty() && panel.advance());
        assert_eq!((panel.rollout.state().step, panel.warnings.len()), (1, 0));
    }
}
