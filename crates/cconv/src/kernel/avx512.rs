//! AVX-512: 16 floats a vector, 32 registers.

use std::arch::x86_64::*;

use super::{Bf16, InstructionSet, Operation, Outer, Product, avx512_bf16, bf16, instructions};

/// How many rows of weights ahead are asked for: a panel streams from the second-level cache, and its own
/// prefetcher is a little late. Measured between 6 and 40, with no difference.
pub const PREFETCH_ROWS: usize = 12;

/// With `BF16` the matrix products in bfloat16 have instructions too.
pub struct Avx512<const BF16: bool>;

/// Whether this processor has what [`run`] needs.
pub fn available() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("fma")
}

/// Whether this processor has what [`run_bf16`] needs beside that.
pub fn bf16_available() -> bool {
    is_x86_feature_detected!("avx512bf16")
}

/// # Safety
/// [`available`] must hold.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,fma")]
pub unsafe fn run(operation: impl Operation) {
    operation.run::<Avx512<false>>();
}

/// # Safety
/// [`available`] and [`bf16_available`] must hold.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16,fma")]
pub unsafe fn run_bf16(operation: impl Operation) {
    operation.run::<Avx512<true>>();
}

impl<const BF16: bool> InstructionSet for Avx512<BF16> {
    type Vector = __m512;
    type Mask = __mmask16;
    type Quad = __m128;
    const LANES: usize = 16;

    instructions! {
        fn splat(x: f32) -> __m512 { _mm512_set1_ps(x) }
        fn add(a: __m512, b: __m512) -> __m512 { _mm512_add_ps(a, b) }
        fn sub(a: __m512, b: __m512) -> __m512 { _mm512_sub_ps(a, b) }
        fn mul(a: __m512, b: __m512) -> __m512 { _mm512_mul_ps(a, b) }
        fn div(a: __m512, b: __m512) -> __m512 { _mm512_div_ps(a, b) }
        fn min(a: __m512, b: __m512) -> __m512 { _mm512_min_ps(a, b) }
        fn max(a: __m512, b: __m512) -> __m512 { _mm512_max_ps(a, b) }
        fn sqrt(x: __m512) -> __m512 { _mm512_sqrt_ps(x) }
        fn abs(x: __m512) -> __m512 { _mm512_abs_ps(x) }
        fn copysign(x: __m512, sign: __m512) -> __m512 {
            let bit = _mm512_set1_ps(-0.0);
            _mm512_or_ps(_mm512_andnot_ps(bit, x), _mm512_and_ps(bit, sign))
        }
        fn truncate(x: __m512) -> __m512 { _mm512_roundscale_ps::<_MM_FROUND_TO_ZERO>(x) }
        fn less_equal(a: __m512, b: __m512) -> __mmask16 { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b) }
        fn select(mask: __mmask16, a: __m512, b: __m512) -> __m512 { _mm512_mask_blend_ps(mask, b, a) }
        fn multiply_add(a: __m512, b: __m512, c: __m512) -> __m512 { _mm512_fmadd_ps(a, b, c) }
        fn load(from: &[f32]) -> __m512 { _mm512_loadu_ps(from[..16].as_ptr()) }
        fn store(x: __m512, to: &mut [f32]) { _mm512_storeu_ps(to[..16].as_mut_ptr(), x) }
        fn store_u16(x: __m512, to: &mut [u16]) {
            let integers = _mm512_cvtepi32_epi16(_mm512_cvttps_epi32(x));
            _mm256_storeu_si256(to[..16].as_mut_ptr().cast(), integers)
        }
        fn quad_splat(x: f32) -> __m128 { _mm_set1_ps(x) }
        fn quad_load(from: &[f32]) -> __m128 { _mm_loadu_ps(from[..4].as_ptr()) }
        fn quad_store(x: __m128, to: &mut [f32]) { _mm_storeu_ps(to[..4].as_mut_ptr(), x) }
        fn quad_multiply_add(a: __m128, b: __m128, c: __m128) -> __m128 { _mm_fmadd_ps(a, b, c) }
        fn sum(x: __m512) -> f32 { _mm512_reduce_add_ps(x) }
        fn prefetch(value: &f32) { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast()) }
    }

    #[inline(always)]
    fn multiply(product: Product<'_>) {
        product.validate();
        // SAFETY: this set is only used inside `run`, so the processor has the instructions, and the
        // lengths were validated.
        unsafe {
            match product.width {
                64 => tiles::<6, 4>(product),
                48 => tiles::<6, 3>(product),
                32 => tiles::<12, 2>(product),
                _ => tiles::<12, 1>(product),
            }
        }
    }

    #[inline(always)]
    fn multiply_outer(outer: Outer<'_>) {
        outer.validate(1);
        // SAFETY: as above.
        unsafe {
            match outer.width {
                64 => outer_tiles::<4>(outer),
                48 => outer_tiles::<3>(outer),
                32 => outer_tiles::<2>(outer),
                _ => outer_tiles::<1>(outer),
            }
        }
    }

    #[inline(always)]
    fn multiply_bf16(product: Product<'_, Bf16>) {
        if BF16 {
            // SAFETY: this set is only used inside `run_bf16`, so the processor has the instructions.
            unsafe { avx512_bf16::multiply(product) }
        } else {
            bf16::multiply(product);
        }
    }

    #[inline(always)]
    fn multiply_outer_bf16(outer: Outer<'_, Bf16>) {
        if BF16 {
            // SAFETY: as above.
            unsafe { avx512_bf16::multiply_outer(outer) }
        } else {
            bf16::multiply_outer(outer);
        }
    }

    #[inline(always)]
    fn round_bf16(from: &[f32], to: &mut [Bf16]) {
        if BF16 {
            // SAFETY: as above.
            unsafe { avx512_bf16::round(from, to) }
        } else {
            bf16::round(from, to);
        }
    }

    #[inline(always)]
    fn interleave_bf16(first: &[f32], second: &[f32], to: &mut [Bf16]) {
        if BF16 {
            // SAFETY: as above.
            unsafe { avx512_bf16::interleave(first, second, to) }
        } else {
            bf16::interleave(first, second, to);
        }
    }
}

/// Goes through the rows in tiles of R rows and V vectors of columns.
///
/// # Safety
/// The processor must have AVX-512F, and the product be valid.
#[target_feature(enable = "avx512f")]
unsafe fn tiles<const R: usize, const V: usize>(product: Product<'_>) {
    let Product { rows, depth, a, a_stride, b, c, c_stride, .. } = product;
    for row in (0..rows).step_by(R) {
        // SAFETY: R divides ROWS, and the slices hold ROWS rows.
        unsafe {
            tile::<R, V>(
                depth,
                a.as_ptr().add(row * a_stride),
                a_stride,
                b.as_ptr(),
                c.as_mut_ptr().add(row * c_stride),
                c_stride,
            );
        }
    }
}

/// One tile: R × V vectors of sums in registers.
///
/// # Safety
/// The processor must have AVX-512F; `a` must have R rows of `depth` floats, `b` `depth` rows of 16 V, and `c` R rows
/// of 16 V.
#[target_feature(enable = "avx512f")]
#[inline]
unsafe fn tile<const R: usize, const V: usize>(
    depth: usize,
    a: *const f32,
    a_stride: usize,
    mut b: *const f32,
    c: *mut f32,
    c_stride: usize,
) {
    let mut sums = [[_mm512_setzero_ps(); V]; R];
    for k in 0..depth {
        // SAFETY: as the caller promises.
        unsafe {
            let columns: [__m512; V] = std::array::from_fn(|v| _mm512_loadu_ps(b.add(16 * v)));
            for v in 0..V {
                // The address may lie beyond the panel: a prefetch reads nothing.
                _mm_prefetch::<_MM_HINT_T0>(b.wrapping_add(16 * V * PREFETCH_ROWS + 16 * v).cast());
            }
            for (r, sums) in sums.iter_mut().enumerate() {
                let value = _mm512_set1_ps(*a.add(r * a_stride + k));
                for (sum, column) in sums.iter_mut().zip(columns) {
                    *sum = _mm512_fmadd_ps(value, column, *sum);
                }
            }
            b = b.add(16 * V);
        }
    }
    // SAFETY: as the caller promises.
    unsafe { add_tile(&sums, c, c_stride) };
}

/// c += sums.
///
/// # Safety
/// The processor must have AVX-512F, and `c` R rows of 16 V floats.
#[target_feature(enable = "avx512f")]
#[inline]
pub unsafe fn add_tile<const R: usize, const V: usize>(
    sums: &[[__m512; V]; R],
    c: *mut f32,
    c_stride: usize,
) {
    for (r, sums) in sums.iter().enumerate() {
        for (v, sum) in sums.iter().enumerate() {
            // SAFETY: as the caller promises.
            unsafe {
                let c = c.add(r * c_stride + 16 * v);
                _mm512_storeu_ps(c, _mm512_add_ps(_mm512_loadu_ps(c), *sum));
            }
        }
    }
}

/// Rows of a tile of [`outer_tiles`].
pub const OUTER_ROWS: usize = 4;

/// Goes through the rows in tiles of V vectors of columns.
///
/// # Safety
/// The processor must have AVX-512F, and the product be valid.
#[target_feature(enable = "avx512f")]
unsafe fn outer_tiles<const V: usize>(outer: Outer<'_>) {
    let Outer { rows, depth, a, a_stride, b, c, c_stride, .. } = outer;
    for row in (0..rows).step_by(OUTER_ROWS) {
        let mut sums = [[_mm512_setzero_ps(); V]; OUTER_ROWS];
        for k in 0..depth {
            // SAFETY: OUTER_ROWS divides the rows, and the slices hold the whole factors.
            unsafe {
                let a = a.as_ptr().add(k * a_stride + row);
                let b = b.as_ptr().add(k * 16 * V);
                let columns: [__m512; V] = std::array::from_fn(|v| _mm512_loadu_ps(b.add(16 * v)));
                for (r, sums) in sums.iter_mut().enumerate() {
                    let value = _mm512_set1_ps(*a.add(r));
                    for (sum, column) in sums.iter_mut().zip(columns) {
                        *sum = _mm512_fmadd_ps(value, column, *sum);
                    }
                }
            }
        }
        // SAFETY: as above.
        unsafe { add_tile(&sums, c.as_mut_ptr().add(row * c_stride), c_stride) };
    }
}
