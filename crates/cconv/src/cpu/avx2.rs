//! AVX2 with fused multiply-add: 8 floats a vector, 16 registers.

use std::arch::x86_64::*;

use super::{InstructionSet, Operation, Product};

pub struct Avx2;

/// Rows and vectors of the tile of sums that stays in registers: 12 of 16, two more for the weights.
const TILE_ROWS: usize = 6;
const TILE_VECTORS: usize = 2;

/// Whether this processor has what [`run`] needs.
pub fn available() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// # Safety
/// [`available`] must hold.
#[target_feature(enable = "avx2,fma")]
pub unsafe fn run(operation: impl Operation) {
    operation.run::<Avx2>();
}

impl InstructionSet for Avx2 {
    #[inline(always)]
    fn multiply_add(a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn prefetch(value: &f32) {
        // SAFETY: prefetching a valid address is always allowed; SSE is part of x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast()) };
    }

    #[inline(always)]
    fn multiply(product: Product<'_>) {
        product.validate();
        // SAFETY: this set is only used inside `run`, so the processor has the instructions, and the
        // lengths were validated.
        unsafe { tiles(product) }
    }
}

/// Goes through rows and columns in tiles.
///
/// # Safety
/// The processor must have AVX2 and FMA, and the product be valid.
#[target_feature(enable = "avx2,fma")]
unsafe fn tiles(product: Product<'_>) {
    let Product { rows, depth, width, a, a_stride, b, c, c_stride } = product;
    for column in (0..width).step_by(8 * TILE_VECTORS) {
        for row in (0..rows).step_by(TILE_ROWS) {
            let mut sums = [[_mm256_setzero_ps(); TILE_VECTORS]; TILE_ROWS];
            for k in 0..depth {
                // SAFETY: TILE_ROWS divides ROWS and the slices hold ROWS rows; the width is a multiple of
                // the tile's.
                unsafe {
                    let b = b.as_ptr().add(k * width + column);
                    let columns: [__m256; TILE_VECTORS] =
                        std::array::from_fn(|v| _mm256_loadu_ps(b.add(8 * v)));
                    for (r, sums) in sums.iter_mut().enumerate() {
                        let value = _mm256_set1_ps(*a.as_ptr().add((row + r) * a_stride + k));
                        for (sum, column) in sums.iter_mut().zip(columns) {
                            *sum = _mm256_fmadd_ps(value, column, *sum);
                        }
                    }
                }
            }
            for (r, sums) in sums.iter().enumerate() {
                for (v, sum) in sums.iter().enumerate() {
                    // SAFETY: as above.
                    unsafe {
                        let c = c.as_mut_ptr().add((row + r) * c_stride + column + 8 * v);
                        _mm256_storeu_ps(c, _mm256_add_ps(_mm256_loadu_ps(c), *sum));
                    }
                }
            }
        }
    }
}
