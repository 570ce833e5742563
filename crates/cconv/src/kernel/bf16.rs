//! bfloat16 without instructions for it: correct, and slow.
//!
//! Factors are rounded to bfloat16, products and sums are float32.

use super::{Bf16, Outer, Product};

/// The float32 of a bfloat16.
#[inline(always)]
pub fn widen(x: Bf16) -> f32 {
    f32::from_bits(u32::from(x) << 16)
}

/// The nearest bfloat16, ties to even.
#[inline(always)]
pub fn nearest(x: f32) -> Bf16 {
    let bits = x.to_bits();
    if x.is_nan() {
        // A NaN whose payload lies in the lower half must not become an infinity.
        return (bits >> 16) as Bf16 | 0x40;
    }
    ((bits + 0x7fff + (bits >> 16 & 1)) >> 16) as Bf16
}

#[inline(always)]
pub fn round(from: &[f32], to: &mut [Bf16]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = nearest(*from));
}

#[inline(always)]
pub fn interleave(first: &[f32], second: &[f32], to: &mut [Bf16]) {
    for (to, (first, second)) in to.chunks_exact_mut(2).zip(first.iter().zip(second)) {
        to[0] = nearest(*first);
        to[1] = nearest(*second);
    }
}

#[inline(always)]
pub fn multiply(product: Product<'_, Bf16>) {
    product.validate();
    let Product { rows, depth, width, a, a_stride, b, c, c_stride } = product;
    for row in 0..rows {
        let c = &mut c[row * c_stride..][..width];
        for (a, b) in a[row * a_stride..][..depth].chunks_exact(2).zip(b.chunks_exact(2 * width)) {
            add_pair([a[0], a[1]], b, c);
        }
    }
}

#[inline(always)]
pub fn multiply_outer(outer: Outer<'_, Bf16>) {
    outer.validate(2);
    let Outer { rows, depth, width, a, a_stride, b, c, c_stride } = outer;
    for row in 0..rows {
        let c = &mut c[row * c_stride..][..width];
        for (k, b) in b.chunks_exact(2 * width).enumerate().take(depth) {
            let a = &a[k * a_stride + 2 * row..][..2];
            add_pair([a[0], a[1]], b, c);
        }
    }
}

/// c += a₀ b₀ + a₁ b₁ for each pair of b.
#[inline(always)]
fn add_pair(a: [Bf16; 2], b: &[Bf16], c: &mut [f32]) {
    let (a0, a1) = (widen(a[0]), widen(a[1]));
    for (c, b) in c.iter_mut().zip(b.chunks_exact(2)) {
        *c += a0 * widen(b[0]) + a1 * widen(b[1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_to_nearest_even() {
        // 1 + 2⁻⁸ lies halfway between 1 and 1 + 2⁻⁷, whose last bit is odd.
        for (x, expected) in [
            (1.0, 0x3f80),
            (1.0 + 0.003_906_25, 0x3f80),
            (1.0 + 0.003_906_5, 0x3f81),
            (1.0 + 3.0 * 0.003_906_25, 0x3f82),
            (-0.0, 0x8000),
            (f32::INFINITY, 0x7f80),
            (f32::MAX, 0x7f80),
        ] {
            assert_eq!(nearest(x), expected, "{x}");
        }
        assert!(widen(nearest(f32::from_bits(0x7f80_0001))).is_nan());
    }
}
