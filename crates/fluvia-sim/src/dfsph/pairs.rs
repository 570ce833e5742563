//! Who is near whom in the fluid, and V ∇W of every pair: the operators that both pressure solvers are made of.
//!
//! ∇W(x_i - x_j) = f_ij (x_i - x_j), so that one number a pair is enough; the vector is made anew where it is needed,
//! from positions that are in the cache. V is the same for all particles.

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};

use rayon::prelude::*;

use super::row::Row;
use crate::kernel::CubicSpline;
use crate::parallel::{CHUNK, split_by_rows};

/// The pairs of fluid particles within the support radius; each particle is its own neighbour.
#[derive(Default)]
pub struct Pairs {
    pub near: Neighbors,
    /// V f_ij for every entry of `near`, per square metre.
    pub factor: Vec<f32>,
    /// x_i.
    pub position: Vec<Row>,
}

impl Pairs {
    /// Finds who is near whom. The factors are left to [`weigh`](Pairs::weigh).
    pub fn find(&mut self, positions: &[[f32; 3]], grid: &mut Grid, kernel: &CubicSpline) {
        let support = kernel.support();
        grid.build(positions, support);
        grid.search(positions, Radius::Uniform(support), &Options::default(), &mut self.near);
        self.factor.resize(self.near.indices.len(), 0.0);
        self.position.clear();
        self.position.extend(positions.iter().map(|&x| Row::from(x)));
    }

    /// Fills the factors and Σ_j V W_ij of every particle; V is `volume`.
    pub fn weigh(&mut self, kernel: &CubicSpline, volume: f32, density: &mut Vec<f32>) {
        let Pairs { near, factor, position } = self;
        density.resize(position.len(), 0.0);
        let factors = split_by_rows(factor, &near.row_splits);
        density.par_chunks_mut(CHUNK).zip(factors).enumerate().for_each(|(chunk, (densities, factors))| {
            let mut rest = factors;
            for (k, density) in densities.iter_mut().enumerate() {
                let i = chunk * CHUNK + k;
                let row = near.row(i);
                let (factors, others) = std::mem::take(&mut rest).split_at_mut(row.len());
                rest = others;
                for (factor, &j) in factors.iter_mut().zip(row) {
                    let offset = position[i] - position[j as usize];
                    *factor = offset.dot(offset);
                }
                *density = weigh(kernel, factors, |_| volume);
            }
        });
    }

    /// Calls `f(j, V f_ij, x_i - x_j)` for every neighbour j of particle i.
    #[inline]
    pub fn for_each(&self, i: usize, mut f: impl FnMut(usize, f32, Row)) {
        let (start, end) = (self.near.row_splits[i], self.near.row_splits[i + 1]);
        let x = self.position[i];
        for (&j, &factor) in self.near.indices[start..end].iter().zip(&self.factor[start..end]) {
            let j = j as usize;
            f(j, factor, x - self.position[j]);
        }
    }

    /// Σ_j V (u_i - u_j) · ∇W_ij, the rate at which the flow u compresses the fluid around i, per second.
    #[inline]
    pub fn compression_rate(&self, i: usize, u: &[Row]) -> f32 {
        let own = u[i];
        let mut sum = Row::default();
        self.for_each(i, |j, factor, offset| sum.add_scaled(factor, offset.times(own - u[j])));
        sum.sum()
    }

    /// Σ_j V (P_i + P_j) ∇W_ij.
    #[inline]
    pub fn pressure_gradient(&self, i: usize, pressure: &[f32]) -> Row {
        let own = pressure[i];
        let mut sum = Row::default();
        self.for_each(i, |j, factor, offset| sum.add_scaled(factor * (own + pressure[j]), offset));
        sum
    }
}

/// Turns squared distances into V f, with ∇W = f (x_i - x_j), and sums V W over them; V is the volume of each.
#[inline]
pub fn weigh(kernel: &CubicSpline, squared: &mut [f32], volume: impl Fn(usize) -> f32) -> f32 {
    // Four at a time: the processor does them at once.
    let mut sums = [0.0; 4];
    let weigh = |number: &mut f32, volume: f32, sum: &mut f32| {
        let distance = number.sqrt();
        *sum += volume * kernel.value(distance);
        *number = volume * kernel.gradient_factor(distance);
    };
    let (fours, rest) = squared.as_chunks_mut::<4>();
    let first = 4 * fours.len();
    for (n, four) in fours.iter_mut().enumerate() {
        let volumes: [f32; 4] = std::array::from_fn(|k| volume(4 * n + k));
        (0..4).for_each(|k| weigh(&mut four[k], volumes[k], &mut sums[k]));
    }
    rest.iter_mut().enumerate().for_each(|(k, number)| weigh(number, volume(first + k), &mut sums[k]));
    sums.iter().sum()
}
