//! Whether every value of the settings can be what it is, and other numbers of updates.

use anyhow::{Result, bail};

use super::{Config, IntegrationName, Rate};

impl Config {
    /// Changes the number of updates, and the schedule in proportion.
    pub fn set_updates(&mut self, updates: u64) {
        let old = std::mem::replace(&mut self.training.updates, updates);
        let scaled = |at: u64| (u128::from(at) * u128::from(updates) / u128::from(old.max(1))) as u64;
        match &mut self.rate {
            Rate::Steps { at, .. } => at.iter_mut().for_each(|at| *at = scaled(*at)),
            Rate::Cosine { warmup, .. } => *warmup = scaled(*warmup),
            // Theirs are parts of all updates.
            Rate::Paper {} | Rate::Published {} => {}
        }
    }

    /// Makes sure that every value can be what it is.
    ///
    /// # Errors
    /// One line that names the key, what it is and what was expected.
    pub fn check(&self) -> Result<()> {
        let Config { network, loss, training, optimizer, validation, .. } = self;
        let counts = [
            ("network.first", network.first as u64),
            ("training.updates", training.updates),
            ("training.batch", training.batch as u64),
            ("training.steps", training.steps as u64),
            ("training.group", training.group as u64),
            ("validation.every", validation.every),
            ("validation.windows", validation.windows as u64),
        ];
        if let Some((key, _)) = counts.into_iter().find(|(_, count)| *count == 0) {
            bail!("`{key}`: 0, expected at least 1");
        }
        if network.hidden.contains(&0) {
            bail!("`network.hidden`: {:?}, expected at least 1 channel a layer", network.hidden);
        }
        let (mut positive, mut parts) = (vec![("loss.exponent", loss.exponent)], Vec::new());
        positive.push(("network.dt", network.dt));
        positive.push(("optimizer.epsilon", optimizer.epsilon));
        positive.push(("optimizer.viscosity_rate", optimizer.viscosity_rate));
        match self.rate {
            Rate::Steps { highest, factor, ref at } => {
                positive.extend([("rate.highest", highest), ("rate.factor", factor)]);
                if let Some(at) = at.iter().find(|at| **at >= training.updates) {
                    bail!("`rate.at`: {at}, expected below the {} updates", training.updates);
                }
            }
            Rate::Cosine { highest, warmup } => {
                positive.push(("rate.highest", highest));
                if warmup >= training.updates {
                    let updates = training.updates;
                    bail!("`rate.warmup`: {warmup}, expected below the {updates} updates");
                }
            }
            Rate::Paper {} | Rate::Published {} => {}
        }
        if let Some((key, value)) = positive.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            bail!("`{key}`: {value}, expected a number above 0");
        }
        parts.extend([("optimizer.beta1", optimizer.beta1), ("optimizer.beta2", optimizer.beta2)]);
        parts.push(("training.average", training.average));
        if let Some((key, value)) = parts.iter().find(|(_, value)| !(0.0..1.0).contains(value)) {
            bail!("`{key}`: {value}, expected a number from 0 to below 1");
        }
        let at_least_zero = [
            ("loss.neighbors", loss.neighbors),
            ("loss.compression", loss.compression),
            ("loss.walls", loss.walls),
            ("training.position_noise", training.position_noise),
            ("training.velocity_noise", training.velocity_noise),
        ];
        if let Some((key, value)) = at_least_zero.iter().find(|(_, x)| !(x.is_finite() && *x >= 0.0)) {
            bail!("`{key}`: {value}, expected a number of at least 0");
        }
        if loss.velocity == Some(true) && network.integration == IntegrationName::Paper {
            bail!(
                "`loss.velocity`: true, but with `network.integration` \"paper\" velocities follow from positions"
            );
        }
        if optimizer.viscosity_rate != 1.0 && !network.viscosity {
            bail!(
                "`optimizer.viscosity_rate`: {}, but `network.viscosity` is false",
                optimizer.viscosity_rate
            );
        }
        Ok(())
    }
}
