//! The window function a(x_i, x) of Eq. 8 and its alternatives of Table 5.

use crate::kernel::InstructionSet;

/// The weight of a neighbour by its distance. With q the squared distance divided by R² (along each axis by
/// its own R where the extent is anisotropic), every window but [`Window::None`] is 0 at R and beyond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Window {
    /// (1 − q)³, Eq. 8, after the poly6 kernel of Müller et al. (2003).
    #[default]
    Poly6,
    /// 1 − √q.
    Triangular,
    /// 1: every neighbour counts the same.
    None,
}

impl Window {
    /// The window's values at the squared normalised distances `q`.
    #[inline(always)]
    pub(crate) fn values<I: InstructionSet>(self, q: I::Vector) -> I::Vector {
        let (zero, one) = (I::splat(0.0), I::splat(1.0));
        match self {
            Window::Poly6 => {
                let t = I::max(I::sub(one, q), zero);
                I::mul(I::mul(t, t), t)
            }
            Window::Triangular => I::max(I::sub(one, I::sqrt(q)), zero),
            Window::None => one,
        }
    }

    /// ∂a/∂r = this · r, with r the normalised position of the neighbour. 0 at the kinks of the triangular
    /// window, its centre and its border.
    #[inline(always)]
    pub(crate) fn slope_over_distance<I: InstructionSet>(self, q: I::Vector) -> I::Vector {
        let (zero, one) = (I::splat(0.0), I::splat(1.0));
        match self {
            Window::Poly6 => {
                let t = I::max(I::sub(one, q), zero);
                I::mul(I::splat(-6.0), I::mul(t, t))
            }
            Window::Triangular => {
                let slope = I::div(I::splat(-1.0), I::sqrt(q));
                let inside = I::select(I::less_equal(one, q), zero, slope);
                I::select(I::less_equal(q, zero), zero, inside)
            }
            Window::None => zero,
        }
    }
}
