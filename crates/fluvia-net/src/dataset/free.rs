//! Particles that fall freely, which data sets have few of: a network learns that nothing is to be corrected where there is
//! nothing near.

use fluvia_neighbors::Point;
use rand_pcg::Pcg64;

use super::Batch;
use super::order::normal;

/// A cloud of particles that do not see each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeFall {
    /// How many there are; 0 makes no cloud.
    pub count: usize,
    /// Metres per second squared.
    pub gravity: Point,
    /// Seconds between frames.
    pub dt: f32,
}

/// The least distance between two, metres: beyond any filter radius.
const APART: f32 = 1.0;

/// The standard deviation of each component of velocities, metres per second: most are slower than 6 m/s, as what has fallen
/// 2 m.
const SPEED: f32 = 3.0;

/// How fast two of them may approach each other, in these deviations.
const FAST: f32 = 5.0;

impl Batch {
    /// Adds the cloud, without walls. Extra inputs are those of the first particles of the batch.
    pub fn push_free(&mut self, fall: FreeFall, random: &mut Pcg64) {
        let FreeFall { count, gravity, dt } = fall;
        if count == 0 {
            return;
        }
        let extras = self.extra.len() / self.start.position.len().max(1);
        let extra: Vec<f32> = self.extra.iter().copied().cycle().take(count * extras).collect();
        self.extra.extend(extra);
        // A lattice around the origin, where float32 resolves well.
        let spacing = APART + FAST * SPEED * dt * self.truth.len() as f32;
        let side = (count as f64).cbrt().ceil() as usize;
        let place = |k: usize| spacing * (k as f32 - (side - 1) as f32 / 2.0);
        for k in 0..count {
            let mut x: Point = [place(k % side), place(k / side % side), place(k / side / side)];
            let mut v: Point = std::array::from_fn(|_| SPEED * normal(random));
            self.start.position.push(x);
            self.start.velocity.push(v);
            for state in &mut self.truth {
                let before = v;
                v = std::array::from_fn(|axis| v[axis] + dt * gravity[axis]);
                x = std::array::from_fn(|axis| x[axis] + dt * (before[axis] + v[axis]) / 2.0);
                state.position.push(x);
                state.velocity.push(v);
            }
        }
        self.clouds.push(self.start.position.len());
        self.wall_clouds.push(self.wall_position.len());
        self.free += count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::order::stream;

    #[test]
    fn nothing_moves_them_but_gravity() {
        let fall = FreeFall { count: 5, gravity: [0.0, -9.81, 0.5], dt: 0.02 };
        let mut batch = Batch::new(2, 0);
        batch.push_free(fall, &mut stream(1, [2, 3]));
        assert_eq!((batch.clouds.as_slice(), batch.wall_clouds.as_slice()), (&[0, 5][..], &[0, 0][..]));
        for i in 0..5 {
            let (x, v) = (batch.start.position[i], batch.start.velocity[i]);
            let (end, speed) = (batch.truth[1].position[i], batch.truth[1].velocity[i]);
            for axis in 0..3 {
                let (g, t) = (fall.gravity[axis], 0.04);
                assert!((end[axis] - (x[axis] + t * v[axis] + 0.5 * t * t * g)).abs() < 1e-6);
                assert!((speed[axis] - (v[axis] + t * g)).abs() < 1e-5);
            }
        }
        let before = batch.clone();
        batch.push_free(FreeFall { count: 0, ..fall }, &mut stream(1, [2, 3]));
        assert_eq!(batch, before);
    }
}
