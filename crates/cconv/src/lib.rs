//! Continuous convolutions on points, after Ummenhofer et al., "Lagrangian Fluid Simulation with Continuous
//! Convolutions", ICLR 2020. Slices in, slices out; no tensor framework.
//!
//! For output points x and input points x_i with features f_i (Eq. 7):
//!
//! ```text
//! (f ∗ g)(x) = 1/ψ(x) · Σ_{i ∈ N(x, R)} a(x_i, x) · m_i · f_i · g(Λ(x_i − x))
//! ```
//!
//! where a is a [`Window`], m_i an optional importance, Λ a [`Mapping`] of the ball of radius R to a cube, g a filter
//! grid looked up with an [`Interpolation`], and ψ either 1 or the sum of the window values (Eq. 9).
//!
//! | array | shape | layout |
//! | --- | --- | --- |
//! | positions | \[points\] of \[x, y, z\] | |
//! | features, outputs | \[points, channels\] | row after row |
//! | filter | \[depth, height, width, in, out\] | depth is z and slowest |
//! | pointwise weights | \[in, out\] | |
//!
//! What depends on the points alone is computed once by [`Geometry::build`] and shared by every layer on
//! the same points; [`forward`] then applies one [`Filter`] to one set of features, and [`backward`] gives the gradients
//! by both; [`Geometry::backward`] those by positions, importance and window values. [`mod@reference`] is all of that in
//! float64 as double loops: the specification that everything here is tested against.
//!
//! The feature `burn` adds the module `burn`: the operator as a differentiable layer of that tensor framework.
//!
//! ```
//! use cconv::{Extent, Filter, Geometry, Kernel, Options, PointSets, Workspace};
//! use fluvia_neighbors::{Grid, Neighbors, Radius};
//!
//! let points = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.8, 0.0f32]];
//! let features = [1.0, 2.0, 3.0]; // one channel
//! let radius = 1.0;
//!
//! let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
//! grid.build(&points, radius);
//! grid.search(&points, Radius::Uniform(radius), &Default::default(), &mut neighbors);
//!
//! let options = Options::default(); // the paper's choices
//! let kernel = Kernel::detect();
//! let sets = PointSets::new(&points, &points, &neighbors, Extent::Uniform(2.0 * radius));
//! let mut geometry = Geometry::default();
//! geometry.build(&options, &sets, kernel);
//!
//! let filter = vec![0.1; 4 * 4 * 4 * 2]; // 1 channel in, 2 out
//! let filter = Filter::new(&options, 1, 2, &filter).with_bias(&[0.5, -0.5]);
//! let mut output = vec![0.0; points.len() * 2];
//! cconv::forward(&geometry, &filter, &features, &mut output, &mut Workspace::default());
//! assert!((output[0] - 0.6 - 0.1 * 2.0 * 0.75f32.powi(3) - 0.1 * 3.0 * 0.36f32.powi(3)).abs() < 1e-6);
//! ```

/// The examples of the operator's page.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/operator.md")]
struct OperatorPage;

mod aligned;
#[cfg(feature = "burn")]
pub mod burn;
mod cpu;
mod filter;
mod geometry;
mod kernel;
mod mapping;
pub mod reference;
mod window;

/// The search that makes the neighbour lists; its types are part of this crate's interface.
pub use fluvia_neighbors;

pub use cpu::{
    Columns, Dense, DenseGradients, Gradients, Workspace, backward, dense, dense_backward, forward,
    forward_into,
};
pub use filter::{Filter, Interpolation, Precision};
pub use geometry::{Extent, Geometry, PairGradient, PointGradients, PointSets};
pub use kernel::Kernel;
pub use mapping::Mapping;
pub use window::Window;

/// The options of the operator, the same for all layers on the same points. The default is the paper's.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Cells of the filter grid: depth (z), height (y), width (x).
    pub filter_size: [usize; 3],
    /// How the ball around an output point is mapped to the filter's cube.
    pub mapping: Mapping,
    /// How the filter is looked up between its cells.
    pub interpolation: Interpolation,
    /// Whether the centres of the outermost cells lie on the border of the cube, or half a cell inside.
    pub align_corners: bool,
    /// Shift of the filter coordinates, in cells: x, y, z. Added last.
    pub offset: [f32; 3],
    /// The window function a. Values given per neighbour ([`PointSets::window_values`]) replace it.
    pub window: Window,
    /// Whether to divide by the sum of the window values (ψ of Eq. 9). The importance is not part of that
    /// sum. An output point without neighbours gives 0.
    pub normalize: bool,
}

/// Whether the positions of points count as variables or as constants in a backward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PositionGradient {
    /// The exact derivatives, through the mapping, the interpolation and the window.
    #[default]
    Full,
    /// Constants, as in the published code: its layer has no derivative by positions.
    Stop,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            filter_size: [4, 4, 4],
            mapping: Mapping::VolumePreserving,
            interpolation: Interpolation::Linear,
            align_corners: true,
            offset: [0.0; 3],
            window: Window::Poly6,
            normalize: false,
        }
    }
}

impl Options {
    /// The number of filter cells.
    pub fn cells(&self) -> usize {
        self.filter_size.iter().product()
    }
}
