//! The kernel for every processor, left to the compiler's vectoriser.

use super::{InstructionSet, Product};

/// Rows and columns of the tile of sums that stays in registers: 4 × 8 floats are 8 of the 16 vector
/// registers of SSE2 and of the 32 of NEON.
const TILE_ROWS: usize = 4;
const TILE_COLUMNS: usize = 8;

pub struct Portable;

impl InstructionSet for Portable {
    #[inline(always)]
    fn multiply_add(a: f32, b: f32, c: f32) -> f32 {
        // `mul_add` is a function call where the processor has no such instruction.
        a * b + c
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
}
