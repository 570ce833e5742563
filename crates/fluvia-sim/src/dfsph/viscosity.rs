//! Viscosity as a constraint on the strain rate (Bender & Koschier 2017, section 4), and friction at the walls.
//!
//! The strain rate of particle i as six numbers (xx, yy, zz, xy, xz, yz) is
//!
//! E_i(v) = 1/2 ρ0/ρ_i Σ_j V G(∇W_ij) (v_j - v_i),   with G(g) u = (2 u_x g_x, 2 u_y g_y, 2 u_z g_z,
//!                                                     u_x g_y + u_y g_x, u_x g_z + u_z g_x, u_y g_z + u_z g_y).
//!
//! Viscosity ν means that (1 - ν) E_i is left of it after a step. Impulses approach that,
//!
//! μ_i = 2 K_i^-1 (Σ_j V G v_ji - its target),   Δv_i = ω/2 Σ_j V G(∇W_ij)^T (μ_i + μ_j),
//!
//! with K_i = Σ_j G_ij G_ij^T + G_i G_i^T over g = V ∇W_ij and their sum. Every entry of K is a sum of entries of the
//! second moments M of these vectors, and K has a diagonal block, so that its inverse is that of a 3 x 3 matrix.

use rayon::prelude::*;

use super::boundary::WallSums;
use super::pairs::Pairs;
use super::params::{Params, Solve};
use super::row::Row;
use crate::parallel;

/// ω. In the solver of the published data this factor is the mass of a particle, 0.1 kg; it decides how far the
/// iteration gets before it ends, and so what a coefficient does.
const RELAXATION: f32 = 0.1;

/// Friction at the walls as a part of the viscosity, as in the published data.
const WALL_FRICTION: f32 = 0.1;

/// K is taken for singular if its determinant is below this part of the product of its diagonal: too few neighbours.
const SINGULAR: f64 = 1e-6;

/// A symmetric tensor: xx, yy, zz, xy, xz, yz.
type Tensor = [f32; 6];

/// μ of a particle, and the error that it takes away.
#[derive(Clone, Copy, Debug, Default)]
struct Impulse {
    /// The rows of the symmetric matrix T with G(g)^T μ = T g: μ, and twice μ on the diagonal.
    rows: [Row; 3],
    /// The error of the strain rate, the mean of its six numbers, per second.
    error: f32,
}

/// What one particle's strain rate is held with.
#[derive(Clone, Copy, Debug, Default)]
struct Constraint {
    /// Σ_j V G v_ji that is to be left.
    target: Tensor,
    inverse: Inverse,
}

/// What the iteration writes to.
#[derive(Default)]
pub struct Workspace {
    constraint: Vec<Constraint>,
    impulse: Vec<Impulse>,
    next: Vec<Row>,
}

/// The fluid that the viscosity acts on.
pub struct Fluid<'a> {
    pub pairs: &'a Pairs,
    pub walls: &'a [WallSums],
    /// ρ_i / ρ0.
    pub density: &'a [f32],
    /// ρ0_i over the rest density of the first liquid.
    pub relative_density: &'a [f32],
    /// ν_i.
    pub viscosity: &'a [f32],
}

/// Applies viscosity to the velocities.
pub fn apply(fluid: &Fluid<'_>, params: &Params, velocity: &mut Vec<Row>, work: &mut Workspace) -> Solve {
    let mut solve = Solve { converged: true, ..Solve::default() };
    if fluid.viscosity.iter().all(|&viscosity| viscosity == 0.0) {
        return solve;
    }
    while solve.iterations < params.max_viscosity_iterations {
        solve.error = match solve.iterations {
            0 => fluid.begin(velocity, work),
            _ => fluid.find_impulses(velocity, work),
        };
        fluid.apply_impulses(velocity, work);
        solve.iterations += 1;
        solve.converged = solve.error < params.viscosity_tolerance;
        if solve.converged || !solve.error.is_finite() {
            break;
        }
    }
    for (i, velocity) in velocity.iter_mut().enumerate() {
        let friction = WALL_FRICTION * fluid.viscosity[i] * fluid.walls[i].density / fluid.density[i];
        *velocity = velocity.scaled(1.0 - friction.min(1.0));
    }
    solve
}

impl Fluid<'_> {
    /// Σ_j V G(∇W_ij) (v_j - v_i), from the matrix Σ_j (v_j - v_i) V ∇W_ij^T.
    #[inline]
    fn strain(&self, i: usize, velocity: &[Row]) -> Tensor {
        let own = velocity[i];
        let mut rows = [Row::default(); 3];
        self.pairs.for_each(i, |j, factor, offset| {
            add_outer(&mut rows, velocity[j] - own, offset.scaled(factor));
        });
        let [x, y, z] = rows.map(Row::vector);
        [2.0 * x[0], 2.0 * y[1], 2.0 * z[2], x[1] + y[0], x[2] + z[0], y[2] + z[1]]
    }

    /// K_i^-1, from M = Σ_j g g^T + (Σ_j g)(Σ_j g)^T with g = V ∇W_ij.
    fn inverse(&self, i: usize) -> Inverse {
        let (mut rows, mut sum) = ([Row::default(); 3], Row::default());
        self.pairs.for_each(i, |_, factor, offset| {
            let gradient = offset.scaled(factor);
            sum.add_scaled(1.0, gradient);
            add_outer(&mut rows, gradient, gradient);
        });
        add_outer(&mut rows, sum, sum);
        let [x, y, z] = rows.map(Row::vector);
        Inverse::new([x[0], y[1], z[2], x[1], x[2], y[2]])
    }

    /// The targets, and the impulses of the first iteration; returns the mean error of the strain rate.
    fn begin(&self, velocity: &[Row], work: &mut Workspace) -> f32 {
        let begin = |i: usize| {
            let (strain, left) = (self.strain(i, velocity), 1.0 - self.viscosity[i]);
            let constraint = Constraint { target: strain.map(|s| left * s), inverse: self.inverse(i) };
            (constraint, self.impulse(i, &constraint, strain))
        };
        let all = (0..velocity.len()).into_par_iter().map(begin);
        all.unzip_into_vecs(&mut work.constraint, &mut work.impulse);
        mean_error(&work.impulse)
    }

    /// The impulses of a later iteration; returns the mean error of the strain rate.
    fn find_impulses(&self, velocity: &[Row], work: &mut Workspace) -> f32 {
        let Workspace { constraint, impulse, .. } = work;
        let find = |i: usize| self.impulse(i, &constraint[i], self.strain(i, velocity));
        (0..velocity.len()).into_par_iter().map(find).collect_into_vec(impulse);
        mean_error(impulse)
    }

    #[inline]
    fn impulse(&self, i: usize, constraint: &Constraint, strain: Tensor) -> Impulse {
        let excess: Tensor = std::array::from_fn(|c| strain[c] - constraint.target[c]);
        let error = 0.5 / self.density[i] * excess.iter().map(|e| e.abs()).sum::<f32>() / 6.0;
        let [xx, yy, zz, xy, xz, yz] = constraint.inverse.times(excess).map(|x| 2.0 * x);
        let rows = [[2.0 * xx, xy, xz], [xy, 2.0 * yy, yz], [xz, yz, 2.0 * zz]];
        Impulse { rows: rows.map(Row::from), error }
    }

    /// v_i + ω/2 Σ_j V G(∇W_ij)^T (μ_i + μ_j). Between liquids the lighter one's share of momentum is exchanged.
    fn apply_impulses(&self, velocity: &mut Vec<Row>, work: &mut Workspace) {
        let Workspace { impulse, next, .. } = work;
        let impulse = &*impulse;
        let moved = |i: usize| {
            let (own, density) = (impulse[i].rows, self.relative_density[i]);
            let mut sum = Row::default();
            self.pairs.for_each(i, |j, factor, offset| {
                let share = (self.relative_density[j] / density).min(1.0);
                let gradient = offset.scaled(factor * share).vector();
                let other = &impulse[j].rows;
                for c in 0..3 {
                    // T is symmetric: its columns are its rows.
                    sum.add_scaled(gradient[c], own[c] + other[c]);
                }
            });
            let mut moved = velocity[i];
            moved.add_scaled(0.5 * RELAXATION, sum);
            moved
        };
        (0..velocity.len()).into_par_iter().map(moved).collect_into_vec(next);
        std::mem::swap(velocity, next);
    }
}

fn mean_error(impulse: &[Impulse]) -> f32 {
    let count = impulse.len();
    (parallel::sum(count, |i| f64::from(impulse[i].error)) / count.max(1) as f64) as f32
}

/// Adds a b^T to a matrix of rows.
#[inline]
fn add_outer(rows: &mut [Row; 3], a: Row, b: Row) {
    rows.iter_mut().zip(a.vector()).for_each(|(row, a)| row.add_scaled(a, b));
}

/// The inverse of K = [D B; B^T C] with D diagonal, by its Schur complement C - B^T D^-1 B; zero where K is singular.
#[derive(Clone, Copy, Debug, Default)]
struct Inverse {
    /// D^-1.
    diagonal: [f32; 3],
    /// B in its rows: it has six entries, the others are 0.
    coupling: [[f32; 3]; 3],
    /// (C - B^T D^-1 B)^-1.
    complement: [[f32; 3]; 3],
}

impl Inverse {
    /// From the second moments M.
    fn new(moments: Tensor) -> Inverse {
        let [xx, yy, zz, xy, xz, yz] = moments.map(f64::from);
        let diagonal = [4.0 * xx, 4.0 * yy, 4.0 * zz];
        let coupling = [[2.0 * xy, 2.0 * xz, 0.0], [2.0 * xy, 0.0, 2.0 * yz], [0.0, 2.0 * xz, 2.0 * yz]];
        let shear = [[xx + yy, yz, xz], [yz, xx + zz, xy], [xz, xy, yy + zz]];
        let s: [[f64; 3]; 3] = std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                shear[a][b] - (0..3).map(|k| coupling[k][a] * coupling[k][b] / diagonal[k]).sum::<f64>()
            })
        });
        let minor = |a: usize, b: usize| {
            let ([a1, a2], [b1, b2]) = ([(a + 1) % 3, (a + 2) % 3], [(b + 1) % 3, (b + 2) % 3]);
            s[a1][b1] * s[a2][b2] - s[a1][b2] * s[a2][b1]
        };
        let determinant = s[0][0] * minor(0, 0) + s[0][1] * minor(0, 1) + s[0][2] * minor(0, 2);
        let singular = SINGULAR * shear[0][0] * shear[1][1] * shear[2][2];
        // Without neighbours these are NaN.
        if determinant.is_nan() || determinant.abs() <= singular {
            return Inverse::default();
        }
        Inverse {
            diagonal: diagonal.map(|d| (1.0 / d) as f32),
            coupling: coupling.map(|row| row.map(|b| b as f32)),
            complement: std::array::from_fn(|a| std::array::from_fn(|b| (minor(b, a) / determinant) as f32)),
        }
    }

    fn times(&self, [a0, a1, a2, b0, b1, b2]: Tensor) -> Tensor {
        let Inverse { diagonal, coupling, complement } = self;
        let normal: [f32; 3] = std::array::from_fn(|k| diagonal[k] * [a0, a1, a2][k]);
        let rest: [f32; 3] = std::array::from_fn(|c| {
            [b0, b1, b2][c] - (0..3).map(|k| coupling[k][c] * normal[k]).sum::<f32>()
        });
        let shear: [f32; 3] =
            std::array::from_fn(|c| (0..3).map(|k| complement[c][k] * rest[k]).sum::<f32>());
        let back: [f32; 3] = std::array::from_fn(|k| {
            normal[k] - diagonal[k] * (0..3).map(|c| coupling[k][c] * shear[c]).sum::<f32>()
        });
        [back[0], back[1], back[2], shear[0], shear[1], shear[2]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_undoes_the_matrix() {
        let moments = [1.3, 0.9, 2.1, 0.2, -0.4, 0.3];
        let [xx, yy, zz, xy, xz, yz] = moments;
        let k = [
            [4.0 * xx, 0.0, 0.0, 2.0 * xy, 2.0 * xz, 0.0],
            [0.0, 4.0 * yy, 0.0, 2.0 * xy, 0.0, 2.0 * yz],
            [0.0, 0.0, 4.0 * zz, 0.0, 2.0 * xz, 2.0 * yz],
            [2.0 * xy, 2.0 * xy, 0.0, xx + yy, yz, xz],
            [2.0 * xz, 0.0, 2.0 * xz, yz, xx + zz, xy],
            [0.0, 2.0 * yz, 2.0 * yz, xz, xy, yy + zz],
        ];
        let x = [0.3, -1.0, 0.7, 2.0, -0.1, 0.4];
        let product = k.map(|row| row.iter().zip(x).map(|(k, x)| k * x).sum::<f32>());
        for (found, expected) in Inverse::new(moments).times(product).iter().zip(x) {
            // A condition number of about 10 times float32 rounding.
            assert!((found - expected).abs() < 1e-5, "{found} and {expected}");
        }
        assert_eq!(Inverse::new([0.0; 6]).times([1.0; 6]), [0.0; 6]);
        // All neighbours in one direction.
        assert_eq!(Inverse::new([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]).times([1.0; 6]), [0.0; 6]);
    }
}
