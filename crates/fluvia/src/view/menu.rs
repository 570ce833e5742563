//! The solvers that a scene can be moved by.

use std::path::{Path, PathBuf};

use anyhow::Result;
use fluvia_sim::scene::Setup;
use fluvia_view::SolverOffer;

use super::Args;
use crate::options::{PrecisionName, substep};
use crate::record::Source;
use crate::report::one_line;
use crate::solvers::{Choice, SolverName};
use crate::trained;

/// A solver that can be chosen.
pub struct Offer {
    pub name: String,
    pub label: String,
    pub choice: Choice,
    pub weights: Option<Source>,
}

/// All of them, the one to begin with first.
pub struct Menu(Vec<Offer>);

impl Menu {
    /// Networks from files and shipped ones, then solvers without weights; first the one that was asked for. Frames are
    /// `frame` seconds apart.
    ///
    /// # Errors
    /// If weights cannot be read, or the solver's own step is longer than that.
    pub fn new(args: &Args, frame: f32) -> Result<Menu> {
        let precision = args.precision.unwrap_or(PrecisionName::F32);
        let mut offers = Vec::new();
        let shipped = trained::shipped_names().map(PathBuf::from);
        for path in args.weights.iter().cloned().chain(shipped) {
            let (weights, source) = trained::load(&path)?;
            let name = source.name.clone();
            if offers.iter().all(|offer: &Offer| offer.name != name) {
                let label = format!("Network {}", path.file_stem().unwrap_or_default().display());
                let choice = Choice::Network(Box::new(weights), precision);
                offers.push(Offer { name, label, choice, weights: Some(source) });
            }
        }
        let substep = substep(args.solver_dt, args.solver_dt_max, frame)?;
        for (solver, label) in [(SolverName::Dfsph, "DFSPH"), (SolverName::Pbf, "PBF")] {
            let is_first = args.solver == Some(solver);
            let choice = solver.choice(substep.filter(|_| is_first));
            let offer = Offer { name: choice.name().into(), label: label.into(), choice, weights: None };
            let place = if is_first { 0 } else { offers.len() };
            offers.insert(place, offer);
        }
        Ok(Menu(offers))
    }

    pub fn get(&self, index: usize) -> &Offer {
        &self.0[index]
    }

    pub fn find(&self, name: &str) -> Option<usize> {
        self.0.iter().position(|offer| offer.name == name)
    }

    /// The first that is of another kind than offer `index` and takes the scene.
    pub fn another(&self, index: usize, path: &Path, setup: &Setup) -> Option<usize> {
        let takes = |k: &usize| self.0[*k].choice.check(path, setup).is_ok();
        let is_network = |k: usize| self.0[k].weights.is_some();
        let others = || (0..self.0.len()).filter(|&k| k != index).filter(takes);
        others().find(|&k| is_network(k) != is_network(index)).or_else(|| others().next())
    }

    /// As the page lists them.
    pub fn describe(&self, path: &Path, setup: &Setup) -> Vec<SolverOffer> {
        let offer = |offer: &Offer| SolverOffer {
            name: offer.name.clone(),
            label: offer.label.clone(),
            refused: offer.choice.check(path, setup).err().map(|error| one_line(&error)),
        };
        self.0.iter().map(offer).collect()
    }
}
