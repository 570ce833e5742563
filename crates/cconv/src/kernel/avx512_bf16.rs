//! AVX512-BF16: products of pairs of bfloat16, summed in float32.

use std::arch::x86_64::*;

use super::avx512::{OUTER_ROWS, PREFETCH_ROWS, add_tile};
use super::{Bf16, Outer, Product, bf16};

/// # Safety
/// The processor must have AVX-512 F, BW and BF16.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub unsafe fn multiply(product: Product<'_, Bf16>) {
    product.validate();
    assert!(product.depth.is_multiple_of(2), "an even depth, not {}", product.depth);
    // SAFETY: as the caller promises; the lengths were validated.
    unsafe {
        match product.width {
            64 => tiles::<6, 4>(product),
            48 => tiles::<6, 3>(product),
            32 => tiles::<12, 2>(product),
            _ => tiles::<12, 1>(product),
        }
    }
}

/// Goes through the rows in tiles of R rows and V vectors of columns.
///
/// # Safety
/// The processor must have AVX-512 F and BF16, and the product be valid.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
unsafe fn tiles<const R: usize, const V: usize>(product: Product<'_, Bf16>) {
    let Product { rows, depth, a, a_stride, b, c, c_stride, .. } = product;
    for row in (0..rows).step_by(R) {
        let mut sums = [[_mm512_setzero_ps(); V]; R];
        // SAFETY: R divides ROWS, and the slices hold ROWS rows.
        unsafe {
            let a = a.as_ptr().add(row * a_stride);
            let mut b = b.as_ptr();
            for k in (0..depth).step_by(2) {
                let columns: [__m512bh; V] = std::array::from_fn(|v| pairs(b.add(32 * v)));
                for v in 0..V {
                    // The address may lie beyond the panel: a prefetch reads nothing.
                    let ahead = b.wrapping_add(32 * V * PREFETCH_ROWS + 32 * v);
                    _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
                }
                for (r, sums) in sums.iter_mut().enumerate() {
                    let pair = splat(a.add(r * a_stride + k));
                    for (sum, column) in sums.iter_mut().zip(columns) {
                        *sum = _mm512_dpbf16_ps(*sum, pair, column);
                    }
                }
                b = b.add(32 * V);
            }
        }
        // SAFETY: as above.
        unsafe { add_tile(&sums, c.as_mut_ptr().add(row * c_stride), c_stride) };
    }
}

/// # Safety
/// The processor must have AVX-512 F, BW and BF16.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub unsafe fn multiply_outer(outer: Outer<'_, Bf16>) {
    outer.validate(2);
    // SAFETY: as the caller promises; the lengths were validated.
    unsafe {
        match outer.width {
            64 => outer_tiles::<4>(outer),
            48 => outer_tiles::<3>(outer),
            32 => outer_tiles::<2>(outer),
            _ => outer_tiles::<1>(outer),
        }
    }
}

/// Goes through the rows in tiles of V vectors of columns.
///
/// # Safety
/// The processor must have AVX-512 F and BF16, and the product be valid.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
unsafe fn outer_tiles<const V: usize>(outer: Outer<'_, Bf16>) {
    let Outer { rows, depth, a, a_stride, b, c, c_stride, .. } = outer;
    for row in (0..rows).step_by(OUTER_ROWS) {
        let mut sums = [[_mm512_setzero_ps(); V]; OUTER_ROWS];
        for k in 0..depth {
            // SAFETY: OUTER_ROWS divides the rows, and the slices hold the whole factors.
            unsafe {
                let a = a.as_ptr().add(k * a_stride + 2 * row);
                let b = b.as_ptr().add(k * 32 * V);
                let columns: [__m512bh; V] = std::array::from_fn(|v| pairs(b.add(32 * v)));
                for (r, sums) in sums.iter_mut().enumerate() {
                    let pair = splat(a.add(2 * r));
                    for (sum, column) in sums.iter_mut().zip(columns) {
                        *sum = _mm512_dpbf16_ps(*sum, pair, column);
                    }
                }
            }
        }
        // SAFETY: as above.
        unsafe { add_tile(&sums, c.as_mut_ptr().add(row * c_stride), c_stride) };
    }
}

/// 16 pairs.
///
/// # Safety
/// The processor must have AVX-512F, and `from` 32 values.
#[target_feature(enable = "avx512f,avx512bf16")]
#[inline]
unsafe fn pairs(from: *const Bf16) -> __m512bh {
    // SAFETY: as the caller promises; both types are 512 bits without any invariant.
    unsafe { std::mem::transmute::<__m512i, __m512bh>(_mm512_loadu_si512(from.cast())) }
}

/// One pair in all lanes.
///
/// # Safety
/// The processor must have AVX-512F, and `from` two values.
#[target_feature(enable = "avx512f,avx512bf16")]
#[inline]
unsafe fn splat(from: *const Bf16) -> __m512bh {
    // SAFETY: as the caller promises; both types are 512 bits without any invariant.
    unsafe {
        std::mem::transmute::<__m512i, __m512bh>(_mm512_set1_epi32(from.cast::<i32>().read_unaligned()))
    }
}

/// # Safety
/// The processor must have AVX-512 F, BW and BF16.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub unsafe fn round(from: &[f32], to: &mut [Bf16]) {
    assert_eq!(from.len(), to.len(), "as many values as there is room");
    let whole = from.len() - from.len() % 16;
    for k in (0..whole).step_by(16) {
        // SAFETY: 16 values from k on lie within both slices.
        unsafe {
            let rounded = _mm512_cvtneps_pbh(_mm512_loadu_ps(from.as_ptr().add(k)));
            let rounded = std::mem::transmute::<__m256bh, __m256i>(rounded);
            _mm256_storeu_si256(to.as_mut_ptr().add(k).cast(), rounded);
        }
    }
    bf16::round(&from[whole..], &mut to[whole..]);
}

/// # Safety
/// The processor must have AVX-512 F, BW and BF16.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub unsafe fn interleave(first: &[f32], second: &[f32], to: &mut [Bf16]) {
    assert!(first.len() == second.len() && to.len() == 2 * first.len(), "two rows of one length");
    let whole = first.len() - first.len() % 16;
    for k in (0..whole).step_by(16) {
        // SAFETY: 16 values from k on lie within both rows, and 32 from 2 k on within `to`.
        unsafe {
            let first = _mm512_cvtneps_pbh(_mm512_loadu_ps(first.as_ptr().add(k)));
            let second = _mm512_cvtneps_pbh(_mm512_loadu_ps(second.as_ptr().add(k)));
            let first = _mm512_cvtepu16_epi32(std::mem::transmute::<__m256bh, __m256i>(first));
            let second = _mm512_cvtepu16_epi32(std::mem::transmute::<__m256bh, __m256i>(second));
            let both = _mm512_or_si512(first, _mm512_slli_epi32::<16>(second));
            _mm512_storeu_si512(to.as_mut_ptr().add(2 * k).cast(), both);
        }
    }
    bf16::interleave(&first[whole..], &second[whole..], &mut to[2 * whole..]);
}
