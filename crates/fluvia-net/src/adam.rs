//! Adam (Kingma & Ba 2015), and averaged weights.
//!
//! ```text
//! m = β1 m + (1 − β1) g,  v = β2 v + (1 − β2) g²
//! w = w − rate · m / (1 − β1^t) / (sqrt(v / (1 − β2^t)) + ε)
//! ```

use rayon::prelude::*;

/// The constants of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// β1.
    pub beta1: f32,
    /// β2.
    pub beta2: f32,
    /// ε.
    pub epsilon: f32,
}

impl Default for Params {
    /// Those of the published training.
    fn default() -> Params {
        Params { beta1: 0.9, beta2: 0.999, epsilon: 1e-6 }
    }
}

/// The optimiser and its moments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adam {
    /// Constants.
    pub params: Params,
    /// Updates made: t.
    pub updates: u64,
    /// m, a tensor for each of the weights.
    pub first: Vec<Vec<f32>>,
    /// v.
    pub second: Vec<Vec<f32>>,
}

impl Adam {
    /// Moments of zero for tensors of these lengths.
    pub fn new(params: Params, lengths: impl Iterator<Item = usize>) -> Adam {
        let zeros: Vec<Vec<f32>> = lengths.map(|length| vec![0.0; length]).collect();
        Adam { params, updates: 0, second: zeros.clone(), first: zeros }
    }

    /// One update of the weights; the rate of each is `rate` times its factor.
    ///
    /// # Panics
    /// If the gradients or the factors are not shaped as the weights.
    pub fn update(
        &mut self,
        weights: Vec<&mut [f32]>,
        gradients: &[Vec<f32>],
        rate: f32,
        factors: &[Vec<f32>],
    ) {
        assert_eq!(weights.len(), gradients.len(), "a gradient for each tensor");
        assert_eq!(weights.len(), factors.len(), "factors for each tensor");
        self.updates += 1;
        let Adam { params: Params { beta1, beta2, epsilon }, updates, first, second } = self;
        let t = i32::try_from(*updates).unwrap_or(i32::MAX);
        // In float64: 1 − β2^t is small at first.
        let correction = |beta: f32| (1.0 - f64::from(beta).powi(t)) as f32;
        let (first_scale, second_scale) = (rate / correction(*beta1), correction(*beta2).sqrt().recip());
        let tensors = weights.into_par_iter().zip(gradients).zip(first).zip(second).zip(factors);
        tensors.for_each(|((((weights, gradient), first), second), factors)| {
            assert_eq!(weights.len(), gradient.len(), "a derivative by each weight");
            assert_eq!(weights.len(), factors.len(), "a factor for each weight");
            let each = weights.iter_mut().zip(gradient).zip(first).zip(second).zip(factors);
            for ((((w, g), m), v), factor) in each {
                *m += (1.0 - *beta1) * (g - *m);
                *v += (1.0 - *beta2) * (g * g - *v);
                *w -= factor * (first_scale * *m / (v.sqrt() * second_scale + *epsilon));
            }
        });
    }
}

/// Moves an average of weights towards those of now: average = decay · average + (1 − decay) · weights.
///
/// # Panics
/// If they are not shaped alike.
pub fn average(averages: &mut [Vec<f32>], weights: &[&[f32]], decay: f32) {
    assert_eq!(averages.len(), weights.len(), "an average for each tensor");
    for (average, weights) in averages.iter_mut().zip(weights) {
        assert_eq!(average.len(), weights.len(), "an average for each weight");
        average.iter_mut().zip(*weights).for_each(|(average, w)| *average += (1.0 - decay) * (w - *average));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_updates_are_those_of_the_formula() {
        let mut weights = vec![1.0f32, -2.0];
        let mut adam = Adam::new(Params::default(), [2].into_iter());
        let gradients = [[0.5f32, -1e-3], [0.25, 2e-3], [-1.0, 0.0]];
        let (mut m, mut v, mut expected) = ([0.0f64; 2], [0.0f64; 2], [1.0f64, -2.0]);
        for (t, gradient) in (1..).zip(gradients) {
            adam.update(vec![&mut weights], &[gradient.to_vec()], 0.01, &[vec![1.0, 20.0]]);
            for i in 0..2 {
                let g = f64::from(gradient[i]);
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let (m, v) = (m[i] / (1.0 - 0.9f64.powi(t)), v[i] / (1.0 - 0.999f64.powi(t)));
                expected[i] -= 0.01 * [1.0, 20.0][i] * m / (v.sqrt() + 1e-6);
                // Rounding in float32 of numbers of the order of 1.
                assert!((f64::from(weights[i]) - expected[i]).abs() < 1e-6, "{t}: {weights:?} {expected:?}");
            }
        }
    }

    #[test]
    fn an_average_follows() {
        let mut averages = vec![vec![0.0]];
        for _ in 0..3 {
            average(&mut averages, &[&[1.0]], 0.5);
        }
        assert_eq!(averages, [[0.875]]);
    }
}
