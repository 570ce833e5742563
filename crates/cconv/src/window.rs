//! The window function a(x_i, x) of Eq. 8 and its alternatives of Table 5.

/// The weight of a neighbour by its distance. q is the squared distance divided by R², along each axis with
/// its own R where the extent is anisotropic. Every window but [`Window::None`] is 0 at R and beyond.
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
    /// The window's value at the squared normalised distance `q`.
    #[inline(always)]
    pub fn value(self, q: f32) -> f32 {
        match self {
            Window::Poly6 => {
                let t = (1.0 - q).max(0.0);
                t * t * t
            }
            Window::Triangular => (1.0 - q.sqrt()).max(0.0),
            Window::None => 1.0,
        }
    }
}
