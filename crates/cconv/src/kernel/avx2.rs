//! AVX2 with fused multiply-add: 8 floats a vector, 16 registers.

use std::arch::x86_64::*;

use super::{InstructionSet, Operation, Outer, Product, instructions};

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
    type Vector = __m256;
    type Mask = __m256;
    type Quad = __m128;
    const LANES: usize = 8;

    instructions! {
        fn splat(x: f32) -> __m256 { _mm256_set1_ps(x) }
        fn add(a: __m256, b: __m256) -> __m256 { _mm256_add_ps(a, b) }
        fn sub(a: __m256, b: __m256) -> __m256 { _mm256_sub_ps(a, b) }
        fn mul(a: __m256, b: __m256) -> __m256 { _mm256_mul_ps(a, b) }
        fn div(a: __m256, b: __m256) -> __m256 { _mm256_div_ps(a, b) }
        fn min(a: __m256, b: __m256) -> __m256 { _mm256_min_ps(a, b) }
        fn max(a: __m256, b: __m256) -> __m256 { _mm256_max_ps(a, b) }
        fn sqrt(x: __m256) -> __m256 { _mm256_sqrt_ps(x) }
        fn abs(x: __m256) -> __m256 { _mm256_andnot_ps(_mm256_set1_ps(-0.0), x) }
        fn copysign(x: __m256, sign: __m256) -> __m256 {
            let bit = _mm256_set1_ps(-0.0);
            _mm256_or_ps(_mm256_andnot_ps(bit, x), _mm256_and_ps(bit, sign))
        }
        fn truncate(x: __m256) -> __m256 { _mm256_round_ps::<{ _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC }>(x) }
        fn less_equal(a: __m256, b: __m256) -> __m256 { _mm256_cmp_ps::<_CMP_LE_OQ>(a, b) }
        fn select(mask: __m256, a: __m256, b: __m256) -> __m256 { _mm256_blendv_ps(b, a, mask) }
        fn multiply_add(a: __m256, b: __m256, c: __m256) -> __m256 { _mm256_fmadd_ps(a, b, c) }
        fn load(from: &[f32]) -> __m256 { _mm256_loadu_ps(from[..8].as_ptr()) }
        fn store(x: __m256, to: &mut [f32]) { _mm256_storeu_ps(to[..8].as_mut_ptr(), x) }
        fn store_u16(x: __m256, to: &mut [u16]) {
            let integers = _mm256_cvttps_epi32(x);
            let halves = (_mm256_castsi256_si128(integers), _mm256_extracti128_si256::<1>(integers));
            _mm_storeu_si128(to[..8].as_mut_ptr().cast(), _mm_packus_epi32(halves.0, halves.1))
        }
        fn quad_splat(x: f32) -> __m128 { _mm_set1_ps(x) }
        fn quad_load(from: &[f32]) -> __m128 { _mm_loadu_ps(from[..4].as_ptr()) }
        fn quad_store(x: __m128, to: &mut [f32]) { _mm_storeu_ps(to[..4].as_mut_ptr(), x) }
        fn quad_multiply_add(a: __m128, b: __m128, c: __m128) -> __m128 { _mm_fmadd_ps(a, b, c) }
        fn sum(x: __m256) -> f32 {
            let fours = _mm_add_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps::<1>(x));
            let twos = _mm_add_ps(fours, _mm_movehl_ps(fours, fours));
            _mm_cvtss_f32(_mm_add_ss(twos, _mm_movehdup_ps(twos)))
        }
        fn prefetch(value: &f32) { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast()) }
    }

    #[inline(always)]
    fn multiply(product: Product<'_>) {
        product.validate();
        // SAFETY: this set is only used inside `run`, so the processor has the instructions, and the
        // lengths were validated.
        unsafe { tiles(product) }
    }

    #[inline(always)]
    fn multiply_outer(outer: Outer<'_>) {
        outer.validate(1);
        // SAFETY: as above.
        unsafe { outer_tiles(outer) }
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
            // SAFETY: as above.
            unsafe { add_tile(&sums, c.as_mut_ptr().add(row * c_stride + column), c_stride) };
        }
    }
}

/// Rows of a tile of [`outer_tiles`].
const OUTER_ROWS: usize = 4;

/// Goes through rows and columns in tiles.
///
/// # Safety
/// The processor must have AVX2 and FMA, and the product be valid.
#[target_feature(enable = "avx2,fma")]
unsafe fn outer_tiles(outer: Outer<'_>) {
    let Outer { rows, depth, width, a, a_stride, b, c, c_stride } = outer;
    for row in (0..rows).step_by(OUTER_ROWS) {
        for column in (0..width).step_by(8 * TILE_VECTORS) {
            let mut sums = [[_mm256_setzero_ps(); TILE_VECTORS]; OUTER_ROWS];
            for k in 0..depth {
                // SAFETY: OUTER_ROWS divides the rows, and the width is a multiple of the tile's.
                unsafe {
                    let a = a.as_ptr().add(k * a_stride + row);
                    let b = b.as_ptr().add(k * width + column);
                    let columns: [__m256; TILE_VECTORS] =
                        std::array::from_fn(|v| _mm256_loadu_ps(b.add(8 * v)));
                    for (r, sums) in sums.iter_mut().enumerate() {
                        let value = _mm256_set1_ps(*a.add(r));
                        for (sum, column) in sums.iter_mut().zip(columns) {
                            *sum = _mm256_fmadd_ps(value, column, *sum);
                        }
                    }
                }
            }
            // SAFETY: as above.
            unsafe { add_tile(&sums, c.as_mut_ptr().add(row * c_stride + column), c_stride) };
        }
    }
}

/// c += sums.
///
/// # Safety
/// The processor must have AVX2, and `c` R rows of a tile's columns.
#[target_feature(enable = "avx2,fma")]
#[inline]
unsafe fn add_tile<const R: usize>(sums: &[[__m256; TILE_VECTORS]; R], c: *mut f32, c_stride: usize) {
    for (r, sums) in sums.iter().enumerate() {
        for (v, sum) in sums.iter().enumerate() {
            // SAFETY: as the caller promises.
            unsafe {
                let c = c.add(r * c_stride + 8 * v);
                _mm256_storeu_ps(c, _mm256_add_ps(_mm256_loadu_ps(c), *sum));
            }
        }
    }
}
