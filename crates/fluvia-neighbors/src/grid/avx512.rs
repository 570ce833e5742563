//! Sixteen points at once: squared Euclidean distances with AVX-512, hits compressed in registers.

use std::arch::x86_64::*;

use crate::Point;

/// Points of one run of cells, by coordinate, and their indices among the caller's points.
pub struct Run<'a> {
    pub x: &'a [f32],
    pub y: &'a [f32],
    pub z: &'a [f32],
    pub order: &'a [u32],
}

/// Appends the indices of the points whose squared distance d has `lowest <= d <= limit`.
///
/// # Safety
/// The processor must have AVX-512F.
#[target_feature(enable = "avx512f")]
pub unsafe fn scan(run: &Run<'_>, query: Point, lowest: f32, limit: f32, indices: &mut Vec<u32>) {
    let count = run.x.len();
    assert!(run.y.len() == count && run.z.len() == count && run.order.len() == count, "runs of one length");
    indices.reserve(count + 16);
    let mut length = indices.len();
    let [qx, qy, qz] = query.map(|q| _mm512_set1_ps(q));
    let (lowest, limit) = (_mm512_set1_ps(lowest), _mm512_set1_ps(limit));
    for i in (0..count).step_by(16) {
        let live: __mmask16 = if count - i >= 16 { !0 } else { (1 << (count - i)) - 1 };
        // SAFETY: the masked loads read only entries i..count of slices of that length, and the store
        // writes 16 entries into room reserved for count + 16 more than the vector held.
        unsafe {
            let dx = _mm512_sub_ps(_mm512_maskz_loadu_ps(live, run.x.as_ptr().add(i)), qx);
            let dy = _mm512_sub_ps(_mm512_maskz_loadu_ps(live, run.y.as_ptr().add(i)), qy);
            let dz = _mm512_sub_ps(_mm512_maskz_loadu_ps(live, run.z.as_ptr().add(i)), qz);
            // The same operations in the same order as `distance`: no fused multiply-add.
            let d = _mm512_add_ps(
                _mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy)),
                _mm512_mul_ps(dz, dz),
            );
            let near = _mm512_mask_cmp_ps_mask::<_CMP_LE_OQ>(live, d, limit);
            let hits = _mm512_mask_cmp_ps_mask::<_CMP_GE_OQ>(near, d, lowest);
            let order = _mm512_maskz_loadu_epi32(live, run.order.as_ptr().add(i).cast());
            let packed = _mm512_maskz_compress_epi32(hits, order);
            _mm512_storeu_si512(indices.as_mut_ptr().add(length).cast(), packed);
            length += hits.count_ones() as usize;
        }
    }
    // SAFETY: the entries up to `length` have been written and lie within the reserved room.
    unsafe { indices.set_len(length) };
}
