//! The kernel for every processor, left to the compiler's vectoriser.

use super::{InstructionSet, Outer, Product};

/// Rows and columns of the tile of sums that stays in registers: 4 × 8 floats are 8 of the 16 vector
/// registers of SSE2 and of the 32 of NEON.
const TILE_ROWS: usize = 4;
const TILE_COLUMNS: usize = 8;

pub struct Portable;

/// Four floats, in the hope that the compiler keeps them in one register.
type Four = [f32; 4];

#[inline(always)]
fn each(f: impl Fn(usize) -> f32) -> Four {
    [f(0), f(1), f(2), f(3)]
}

impl InstructionSet for Portable {
    type Vector = Four;
    type Mask = [bool; 4];
    type Quad = Four;
    const LANES: usize = 4;

    #[inline(always)]
    fn splat(x: f32) -> Four {
        [x; 4]
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Four {
        each(|i| from[i])
    }
    #[inline(always)]
    fn store(x: Four, to: &mut [f32]) {
        to[..4].copy_from_slice(&x);
    }
    #[inline(always)]
    fn store_u16(x: Four, to: &mut [u16]) {
        to.iter_mut().zip(x).for_each(|(to, x)| *to = x as u16);
    }
    #[inline(always)]
    fn add(a: Four, b: Four) -> Four {
        each(|i| a[i] + b[i])
    }
    #[inline(always)]
    fn sub(a: Four, b: Four) -> Four {
        each(|i| a[i] - b[i])
    }
    #[inline(always)]
    fn mul(a: Four, b: Four) -> Four {
        each(|i| a[i] * b[i])
    }
    #[inline(always)]
    fn div(a: Four, b: Four) -> Four {
        each(|i| a[i] / b[i])
    }
    #[inline(always)]
    fn min(a: Four, b: Four) -> Four {
        each(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn max(a: Four, b: Four) -> Four {
        each(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn sqrt(x: Four) -> Four {
        each(|i| x[i].sqrt())
    }
    #[inline(always)]
    fn abs(x: Four) -> Four {
        each(|i| x[i].abs())
    }
    #[inline(always)]
    fn copysign(x: Four, sign: Four) -> Four {
        each(|i| x[i].copysign(sign[i]))
    }
    #[inline(always)]
    fn truncate(x: Four) -> Four {
        each(|i| x[i] as i32 as f32)
    }
    #[inline(always)]
    fn less_equal(a: Four, b: Four) -> [bool; 4] {
        std::array::from_fn(|i| a[i] <= b[i])
    }
    #[inline(always)]
    fn select(mask: [bool; 4], a: Four, b: Four) -> Four {
        each(|i| if mask[i] { a[i] } else { b[i] })
    }
    /// Not fused: `mul_add` is a function call where the processor has no such instruction.
    #[inline(always)]
    fn multiply_add(a: Four, b: Four, c: Four) -> Four {
        each(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    fn quad_splat(x: f32) -> Four {
        [x; 4]
    }
    #[inline(always)]
    fn quad_load(from: &[f32]) -> Four {
        Self::load(from)
    }
    #[inline(always)]
    fn quad_store(x: Four, to: &mut [f32]) {
        Self::store(x, to);
    }
    #[inline(always)]
    fn quad_multiply_add(a: Four, b: Four, c: Four) -> Four {
        Self::multiply_add(a, b, c)
    }
    #[inline(always)]
    fn sum(x: Four) -> f32 {
        (x[0] + x[1]) + (x[2] + x[3])
    }
    #[inline(always)]
    fn prefetch(_: &f32) {}

    fn multiply(product: Product<'_>) {
        product.validate();
        let Product { rows, depth, width, a, a_stride, b, c, c_stride } = product;
        for row in (0..rows).step_by(TILE_ROWS) {
            for column in (0..width).step_by(TILE_COLUMNS) {
                let mut sums = [[0.0f32; TILE_COLUMNS]; TILE_ROWS];
                let lines: [&[f32]; TILE_ROWS] = std::array::from_fn(|r| &a[(row + r) * a_stride..][..depth]);
                for k in 0..depth {
                    let b: &[f32; TILE_COLUMNS] =
                        b[k * width + column..][..TILE_COLUMNS].try_into().expect("a tile's columns");
                    for r in 0..TILE_ROWS {
                        for j in 0..TILE_COLUMNS {
                            sums[r][j] += lines[r][k] * b[j];
                        }
                    }
                }
                for (r, sums) in sums.iter().enumerate() {
                    let c = &mut c[(row + r) * c_stride + column..][..TILE_COLUMNS];
                    c.iter_mut().zip(sums).for_each(|(c, sum)| *c += sum);
                }
            }
        }
    }

    fn multiply_outer(outer: Outer<'_>) {
        outer.validate(1);
        let Outer { rows, depth, width, a, a_stride, b, c, c_stride } = outer;
        for row in (0..rows).step_by(TILE_ROWS) {
            for column in (0..width).step_by(TILE_COLUMNS) {
                let mut sums = [[0.0f32; TILE_COLUMNS]; TILE_ROWS];
                for k in 0..depth {
                    let a: &[f32; TILE_ROWS] =
                        a[k * a_stride + row..][..TILE_ROWS].try_into().expect("a tile's rows");
                    let b: &[f32; TILE_COLUMNS] =
                        b[k * width + column..][..TILE_COLUMNS].try_into().expect("a tile's columns");
                    for r in 0..TILE_ROWS {
                        for j in 0..TILE_COLUMNS {
                            sums[r][j] += a[r] * b[j];
                        }
                    }
                }
                for (r, sums) in sums.iter().enumerate() {
                    let c = &mut c[(row + r) * c_stride + column..][..TILE_COLUMNS];
                    c.iter_mut().zip(sums).for_each(|(c, sum)| *c += sum);
                }
            }
        }
    }
}
