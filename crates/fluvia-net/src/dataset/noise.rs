//! Normal noise on the states that windows start from: what a network then learns to make good.

use rand_pcg::Pcg64;

use super::Batch;
use super::order::normal;

/// How much noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// The standard deviation of every coordinate of positions, metres.
    pub position: f32,
    /// That of velocities, metres per second.
    pub velocity: f32,
}

impl Batch {
    /// Adds noise to the start of the last cloud; what is true stays.
    pub fn disturb(&mut self, noise: Noise, random: &mut Pcg64) {
        let first = self.clouds[self.clouds.len().saturating_sub(2)];
        for (values, deviation) in
            [(&mut self.start.position, noise.position), (&mut self.start.velocity, noise.velocity)]
        {
            if deviation > 0.0 {
                let values = values[first..].as_flattened_mut();
                values.iter_mut().for_each(|value| *value += deviation * normal(random));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::order::stream;
    use crate::integrate::State;

    #[test]
    fn the_last_cloud_alone_is_disturbed() {
        let count = 4000;
        let mut batch =
            Batch { start: State::zeros(count + 10), clouds: vec![0, 10, count + 10], ..Batch::new(0, 0) };
        batch.disturb(Noise { position: 0.002, velocity: 0.0 }, &mut stream(1, [2, 3]));
        assert_eq!(batch.start.velocity, State::zeros(count + 10).velocity);
        assert_eq!(batch.start.position[..10], [[0.0; 3]; 10]);
        let values: Vec<f64> =
            batch.start.position[10..].as_flattened().iter().map(|&x| f64::from(x) / 0.002).collect();
        let moment = |power: i32| values.iter().map(|x| x.powi(power)).sum::<f64>() / values.len() as f64;
        // Of 12,000 normal numbers, within four times what these moments scatter by.
        assert!(moment(1).abs() < 0.04 && (moment(2) - 1.0).abs() < 0.06, "{} {}", moment(1), moment(2));
        assert!((moment(4) - 3.0).abs() < 0.4, "{}", moment(4));
    }
}
