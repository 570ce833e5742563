//! The points of a convolution, as the caller gives them.

use fluvia_neighbors::{Neighbors, Point, check_clouds};

/// The diameter of the filter's support: 2 R, in the unit of the points.
#[derive(Clone, Copy, Debug)]
pub enum Extent<'a> {
    /// The same for all output points.
    Uniform(f32),
    /// The same for all output points, one along each axis.
    PerAxis([f32; 3]),
    /// One per output point.
    PerPoint(&'a [f32]),
    /// One per output point along each axis.
    PerPointAndAxis(&'a [[f32; 3]]),
}

impl Extent<'_> {
    #[inline(always)]
    pub(crate) fn of(&self, row: usize) -> [f32; 3] {
        match self {
            Extent::Uniform(extent) => [*extent; 3],
            Extent::PerAxis(extent) => *extent,
            Extent::PerPoint(extents) => [extents[row]; 3],
            Extent::PerPointAndAxis(extents) => extents[row],
        }
    }
}

/// The points of a convolution and which of them are neighbours.
#[derive(Clone, Copy, Debug)]
pub struct PointSets<'a> {
    /// Input points x_i.
    pub inputs: &'a [Point],
    /// Output points x.
    pub outputs: &'a [Point],
    /// The input points near each output point; their indices are those of `inputs`.
    pub neighbors: &'a Neighbors,
    /// The filter's diameter.
    pub extent: Extent<'a>,
    /// The importance m_i of each input point; 1 if absent.
    pub importance: Option<&'a [f32]>,
    /// A window value for each pair, in the order of the neighbours, in place of [`Options::window`](crate::Options::window).
    pub window_values: Option<&'a [f32]>,
    /// Where the input points of each cloud start, if they are several clouds: clouds + 1 entries, the last the
    /// number of points. Empty for one cloud.
    pub input_clouds: &'a [usize],
    /// Where the output points of each cloud start.
    pub output_clouds: &'a [usize],
}

impl<'a> PointSets<'a> {
    /// Points without importance, with the window of the options.
    pub fn new(
        inputs: &'a [Point],
        outputs: &'a [Point],
        neighbors: &'a Neighbors,
        extent: Extent<'a>,
    ) -> Self {
        PointSets {
            inputs,
            outputs,
            neighbors,
            extent,
            importance: None,
            window_values: None,
            input_clouds: &[],
            output_clouds: &[],
        }
    }

    /// The same points, said to be several clouds. Which points are neighbours is not changed by that; but sums
    /// over points are taken cloud by cloud, so that all results are those of one call a cloud, bit for bit.
    pub fn with_clouds(self, input_clouds: &'a [usize], output_clouds: &'a [usize]) -> Self {
        PointSets { input_clouds, output_clouds, ..self }
    }

    /// # Panics
    /// If a length or a neighbour's index does not fit the points, an extent is not a positive number, or a position is
    /// not finite.
    pub(crate) fn validate(&self) {
        let (inputs, outputs) = (self.inputs.len(), self.outputs.len());
        let splits = &self.neighbors.row_splits;
        assert_eq!(splits.len(), outputs + 1, "row splits for {outputs} output points");
        assert!(splits.is_sorted() && splits[0] == 0, "row splits must ascend from 0");
        let pairs = self.neighbors.indices.len();
        assert_eq!(splits[outputs], pairs, "the last row split is the number of pairs");
        if let Some(i) = self.neighbors.indices.iter().max().filter(|&&i| i as usize >= inputs) {
            panic!("neighbour index {i} of {inputs} input points");
        }
        match self.extent {
            Extent::Uniform(extent) => check_extent(0, [extent; 3]),
            Extent::PerAxis(extent) => check_extent(0, extent),
            Extent::PerPoint(extents) => {
                assert_eq!(extents.len(), outputs, "one extent per output point");
                extents.iter().enumerate().for_each(|(row, &extent)| check_extent(row, [extent; 3]));
            }
            Extent::PerPointAndAxis(extents) => {
                assert_eq!(extents.len(), outputs, "one extent per output point");
                extents.iter().enumerate().for_each(|(row, &extent)| check_extent(row, extent));
            }
        }
        if let Some(importance) = self.importance {
            assert_eq!(importance.len(), inputs, "one importance per input point");
        }
        if let Some(values) = self.window_values {
            assert_eq!(values.len(), pairs, "one window value per pair");
        }
        assert_eq!(self.input_clouds.len(), self.output_clouds.len(), "input and output clouds");
        check_positions("input", self.inputs);
        check_positions("output", self.outputs);
    }
}

/// Where clouds start; without any, all points are one.
///
/// # Panics
/// If they do not ascend from 0 to the number of points.
pub(crate) fn boundaries(clouds: &[usize], points: usize) -> Vec<usize> {
    if clouds.is_empty() {
        return vec![0, points];
    }
    check_clouds(clouds, points);
    clouds.to_vec()
}

fn check_positions(name: &str, points: &[Point]) {
    // One pass that compilers make vectors of; the point is looked for only if there is one.
    if points.as_flattened().iter().all(|x| x.is_finite()) {
        return;
    }
    let found = points.iter().enumerate().find(|(_, point)| point.iter().any(|x| !x.is_finite()));
    if let Some((row, point)) = found {
        panic!("{name} point {row} is at {point:?}, expected finite positions");
    }
}

fn check_extent(row: usize, extent: [f32; 3]) {
    assert!(
        extent.iter().all(|&x| x > 0.0 && x.is_finite()),
        "extent {extent:?} of output point {row}, expected positive lengths"
    );
}
