//! Golden vectors computed by Open3D: the operator and the neighbour search.

use std::path::{Path, PathBuf};

use cconv::{
    Extent, Filter, Geometry, Gradients, Interpolation, Kernel, Mapping, Options, PointSets, Workspace,
    reference,
};
use fluvia_neighbors::{Grid, Metric, Neighbors, Options as SearchOptions, Radius};
use serde::Deserialize;

/// A golden npz file.
struct Golden {
    path: PathBuf,
    archive: npyz::npz::NpzArchive<std::io::BufReader<std::fs::File>>,
}

impl Golden {
    fn open(path: &Path) -> Golden {
        let archive = npyz::npz::NpzArchive::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Golden { path: path.to_path_buf(), archive }
    }

    /// The shape and values of an array, converted by `T`'s own reader.
    fn array<T: npyz::Deserialize>(&mut self, name: &str) -> (Vec<u64>, Vec<T>) {
        let array = self
            .archive
            .by_name(name)
            .expect("a readable archive")
            .unwrap_or_else(|| panic!("{}: no {name}", self.path.display()));
        (array.shape().to_vec(), array.into_vec().expect("values of the type asked for"))
    }

    fn f32(&mut self, name: &str) -> Vec<f32> {
        self.array(name).1
    }

    fn points(&mut self, name: &str) -> Vec<[f32; 3]> {
        self.f32(name).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
    }

    fn text(&mut self, name: &str) -> String {
        String::from_utf8(self.array::<u8>(name).1).expect("UTF-8")
    }
}

/// The golden files whose names start with `prefix`: those of the repository, and those of the folder named by
/// `FLUVIA_GOLDEN`, by default `../shared/reference/golden` beside the repository.
fn goldens(prefix: &str) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let optional = std::env::var_os("FLUVIA_GOLDEN")
        .map_or_else(|| root.join("../shared/reference/golden"), PathBuf::from);
    let list = |folder: &Path| -> Vec<PathBuf> {
        let entries =
            std::fs::read_dir(folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
        let mut files: Vec<_> = entries
            .filter(|path| {
                let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
                name.starts_with(prefix) && name.ends_with(".npz")
            })
            .collect();
        files.sort();
        files
    };
    let mut files = list(&root.join("fixtures/golden"));
    assert!(!files.is_empty(), "fixtures/golden holds no {prefix}*.npz");
    let more = list(&optional);
    if more.is_empty() {
        eprintln!("skipped: the larger golden set, no {prefix}*.npz in {}", optional.display());
    }
    files.extend(more);
    files
}

#[derive(Deserialize)]
struct Case {
    coordinate_mapping: String,
    interpolation: String,
    align_corners: bool,
    normalize: bool,
    filter_size: [usize; 3],
    cin: usize,
    cout: usize,
}

impl Case {
    fn options(&self, offset: [f32; 3]) -> Options {
        Options {
            filter_size: self.filter_size,
            mapping: match self.coordinate_mapping.as_str() {
                "ball_to_cube_volume_preserving" => Mapping::VolumePreserving,
                "ball_to_cube_radial" => Mapping::Radial,
                "identity" => Mapping::Identity,
                other => panic!("mapping {other}"),
            },
            interpolation: match self.interpolation.as_str() {
                "linear" => Interpolation::Linear,
                "linear_border" => Interpolation::LinearBorder,
                "nearest_neighbor" => Interpolation::Nearest,
                other => panic!("interpolation {other}"),
            },
            align_corners: self.align_corners,
            offset,
            // The goldens give the window as a value per neighbour.
            window: cconv::Window::None,
            normalize: self.normalize,
        }
    }
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |a, x| if x.abs() > a || x.is_nan() { x.abs() } else { a })
}

#[test]
fn the_operator_gives_open3ds_output_and_gradients() {
    for path in goldens("cconv_") {
        let mut golden = Golden::open(&path);
        let case: Case = serde_json::from_str(&golden.text("meta")).unwrap();
        let offset: [f32; 3] = golden.f32("offset").try_into().unwrap();
        let options = case.options(offset);
        let (inputs, outputs) = (golden.points("inp_positions"), golden.points("out_positions"));
        let neighbors = Neighbors {
            indices: golden.array::<i32>("neighbors_index").1.into_iter().map(|i| i as u32).collect(),
            row_splits: golden
                .array::<i64>("neighbors_row_splits")
                .1
                .into_iter()
                .map(|i| i as usize)
                .collect(),
            distances: Vec::new(),
        };
        let (shape, extents) = golden.array::<f32>("extents");
        let extent = match shape.as_slice() {
            [1, 1] => Extent::Uniform(extents[0]),
            [1, 3] => Extent::PerAxis([extents[0], extents[1], extents[2]]),
            [_, 1] => Extent::PerPoint(&extents),
            other => panic!("extents of shape {other:?}"),
        };
        let importance = golden.f32("inp_importance");
        let windows = golden.f32("neighbors_importance");
        let sets = PointSets {
            importance: (!importance.is_empty()).then_some(importance.as_slice()),
            window_values: (!windows.is_empty()).then_some(windows.as_slice()),
            ..PointSets::new(&inputs, &outputs, &neighbors, extent)
        };
        let (filter, features) = (golden.f32("filters"), golden.f32("inp_features"));
        let expected = golden.f32("output");
        let output_gradient = golden.f32("out_grad");
        let expected_by_filter = golden.f32("filters_grad");
        let expected_by_features = golden.f32("inp_features_grad");
        // Relative to the largest magnitude; both sides are float32 sums, of some hundred terms for the output
        // and the features, of a term for every pair for the filter.
        let check = |name: &str, result: &[f64], expected: &[f32], tolerance: f64| {
            assert_eq!(result.len(), expected.len());
            let scale = largest(expected.iter().map(|&x| f64::from(x)));
            let error = largest(result.iter().zip(expected).map(|(a, b)| a - f64::from(*b))) / scale;
            assert!(error <= tolerance, "{} {name}: off by {error:.2e}", path.display());
        };

        let (wide_filter, wide_features) = (reference::widen(&filter), reference::widen(&features));
        let weights = reference::Weights {
            in_channels: case.cin,
            out_channels: case.cout,
            filter: &wide_filter,
            bias: None,
            pointwise: None,
        };
        let wide_sets = reference::Sets::from(&sets);
        let output = reference::forward(&options, &wide_sets, &weights, &wide_features);
        check("reference", &output, &expected, 1e-5);
        let wide_gradient = reference::widen(&output_gradient);
        let gradients = reference::backward(&options, &wide_sets, &weights, &wide_features, &wide_gradient);
        check("reference, filter", &gradients.filter, &expected_by_filter, 1e-4);
        check("reference, features", &gradients.features, &expected_by_features, 1e-4);
        for kernel in Kernel::available() {
            let mut geometry = Geometry::default();
            geometry.build(&options, &sets, kernel);
            let filter = Filter::new(&options, case.cin, case.cout, &filter);
            let (mut output, mut workspace) = (vec![f32::NAN; expected.len()], Workspace::default());
            cconv::forward(&geometry, &filter, &features, &mut output, &mut workspace);
            check(kernel.name(), &reference::widen(&output), &expected, 1e-5);
            geometry.prepare_backward();
            let mut by_filter = vec![0.0; expected_by_filter.len()];
            let mut by_features = vec![0.0; features.len()];
            let gradients = Gradients {
                filter: Some(&mut by_filter),
                features: Some(&mut by_features),
                ..Gradients::default()
            };
            cconv::backward(&geometry, &filter, &features, &output_gradient, gradients, &mut workspace);
            check(kernel.name(), &reference::widen(&by_filter), &expected_by_filter, 1e-4);
            check(kernel.name(), &reference::widen(&by_features), &expected_by_features, 1e-4);
        }
    }
}

#[test]
fn the_search_finds_open3ds_neighbours() {
    for path in goldens("radius_") {
        let mut golden = Golden::open(&path);
        let (points, queries) = (golden.points("points"), golden.points("queries"));
        let radius = golden.f32("radius")[0];
        let metric = match golden.text("metric").as_str() {
            "L1" => Metric::L1,
            "L2" => Metric::L2,
            "Linf" => Metric::Linf,
            other => panic!("metric {other}"),
        };
        let ignore_coincident = golden.array::<bool>("ignore_query_point").1[0];
        let expected_index = golden.array::<i32>("neighbors_index").1;
        let expected_splits = golden.array::<i64>("neighbors_row_splits").1;
        let expected_distance = golden.f32("distance");

        for distances in [false, true] {
            let options = SearchOptions { metric, ignore_coincident, distances };
            let (mut grid, mut found) = (Grid::new(), Neighbors::default());
            grid.build(&points, radius);
            grid.search(&queries, Radius::Uniform(radius), &options, &mut found);
            assert_eq!(found.queries() + 1, expected_splits.len());
            for q in 0..found.queries() {
                let (start, end) = (expected_splits[q] as usize, expected_splits[q + 1] as usize);
                let mut expected: Vec<_> = (start..end).map(|k| (expected_index[k] as u32, k)).collect();
                let mut row: Vec<_> =
                    (found.row_splits[q]..found.row_splits[q + 1]).map(|k| (found.indices[k], k)).collect();
                expected.sort_unstable();
                row.sort_unstable();
                let ids = |row: &[(u32, usize)]| row.iter().map(|(i, _)| *i).collect::<Vec<_>>();
                assert_eq!(ids(&row), ids(&expected), "{}: query {q}", path.display());
                for ((_, k), (_, e)) in row.iter().zip(&expected).filter(|_| distances) {
                    let error = (found.distances[*k] - expected_distance[*e]).abs();
                    assert!(error <= 1e-6, "{}: query {q}: distance off by {error:.1e}", path.display());
                }
            }
        }
    }
}
