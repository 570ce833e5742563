//! Mesh files: the published models, one body in many guises, every kind of fault, and damage at random.

mod common;
#[path = "formats/memory.rs"]
mod memory;

use std::path::Path;

use common::reference;
use fluvia_sim::mesh::{Format, TriangleMesh};
use fluvia_sim::shapes::Shape;
use proptest::prelude::*;

/// The most memory that a parser may hold for a byte of its file. The shortest triangle is that of an OBJ file,
/// 8 bytes; it takes 3 corners of 4 bytes, an end, a line number and 12 bytes in the mesh, twice while vectors grow.
const BYTES_FOR_A_BYTE: usize = 64;

/// What messages and small vectors take.
const BYTES_FOR_A_FILE: usize = 16 << 10;

#[track_caller]
fn rejected(bytes: impl AsRef<[u8]>, format: Format, texts: &[&str]) {
    let message = TriangleMesh::parse(bytes.as_ref(), format).expect_err("an error");
    assert!(!message.contains('\n'), "one line: {message}");
    for text in texts {
        assert!(message.contains(text), "`{text}` in: {message}");
    }
}

#[test]
fn published_models_are_closed_and_face_outwards() {
    let Some(folder) = reference().map(|folder| folder.join("official/datasets/models")) else { return };
    let mut count = 0;
    for entry in folder.read_dir().expect("a folder") {
        let path = entry.expect("an entry").path();
        let mesh = TriangleMesh::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(mesh.open_edges(), 0, "{}", path.display());
        assert!(mesh.is_oriented(), "{}", path.display());
        assert!(mesh.volume() > 0.0, "{}", path.display());
        count += 1;
    }
    assert_eq!(count, 15);
}

/// The corners of the faces of a cube of side 2, counter-clockwise from outside.
const CORNERS: [[f32; 3]; 8] = [
    [-1., -1., -1.],
    [1., -1., -1.],
    [1., 1., -1.],
    [-1., 1., -1.],
    [-1., -1., 1.],
    [1., -1., 1.],
    [1., 1., 1.],
    [-1., 1., 1.],
];
const FACES: [[usize; 4]; 6] =
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [2, 3, 7, 6], [0, 4, 7, 3], [1, 2, 6, 5]];

fn triangles() -> impl Iterator<Item = [usize; 3]> {
    FACES.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
}

fn obj() -> String {
    let vertices = CORNERS.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    vertices.collect::<String>() + &faces_from(1)
}

/// The faces in an OBJ file whose first corner has that number.
fn faces_from(first: usize) -> String {
    let face =
        |f: &[usize; 4]| format!("f {} {} {} {}\n", f[0] + first, f[1] + first, f[2] + first, f[3] + first);
    FACES.iter().map(face).collect()
}

fn ascii_stl() -> String {
    let facet = |t: [usize; 3]| {
        let vertices = t.map(|v| CORNERS[v]).map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).concat();
        format!("facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    };
    format!(
        "solid cube with a name\n{}endsolid cube with a name\n",
        triangles().map(facet).collect::<String>()
    )
}

fn binary_stl() -> Vec<u8> {
    // Programs write `solid` here too.
    let mut bytes = [&b"solid cube"[..], &[0; 70]].concat();
    bytes.extend(12_u32.to_le_bytes());
    for t in triangles() {
        bytes.extend([0; 12]);
        bytes.extend(t.iter().flat_map(|&v| CORNERS[v]).flat_map(f32::to_le_bytes));
        bytes.extend([7, 7]);
    }
    bytes
}

/// What a PLY file of the cube is like.
#[derive(Clone, Copy)]
struct Ply {
    format: &'static str,
    coordinate: &'static str,
    index: &'static str,
    line_end: &'static str,
}

fn ply(ply: Ply) -> Vec<u8> {
    let Ply { format, coordinate, index, line_end } = ply;
    let header = format!(
        "ply\nformat {format} 1.0\ncomment a cube\nelement material 1\nproperty list uchar short ids\n\
         element vertex 8\nproperty {coordinate} x\nproperty {coordinate} y\nproperty uchar red\nproperty \
         {coordinate} z\nelement face 6\nproperty int flags\nproperty list uchar {index} vertex_indices\nend_header\n"
    );
    let mut bytes = header.replace('\n', line_end).into_bytes();
    let mut number = |value: f64, kind: &str| {
        let mut raw = match kind {
            "double" => value.to_le_bytes().to_vec(),
            "float" => (value as f32).to_le_bytes().to_vec(),
            "int" | "uint" => (value as u32).to_le_bytes().to_vec(),
            "short" | "ushort" => (value as u16).to_le_bytes().to_vec(),
            _ => vec![value as u8],
        };
        match format {
            "ascii" => bytes.extend(format!("{value}{}", if value < 0.0 { " " } else { line_end }).bytes()),
            "binary_big_endian" => {
                raw.reverse();
                bytes.extend(raw);
            }
            _ => bytes.extend(raw),
        }
    };
    for (value, kind) in [(2.0, "uchar"), (5.0, "short"), (6.0, "short")] {
        number(value, kind);
    }
    for [x, y, z] in CORNERS {
        for (value, kind) in [(x, coordinate), (y, coordinate), (200.0, "uchar"), (z, coordinate)] {
            number(value.into(), kind);
        }
    }
    for face in FACES {
        number(9.0, "int");
        number(4.0, "uchar");
        face.iter().for_each(|&v| number(v as f64, index));
    }
    bytes
}

#[track_caller]
fn assert_cube(mesh: &TriangleMesh) {
    assert_eq!(mesh.positions.len(), 8);
    assert_eq!(mesh.triangles.len(), 12);
    assert_eq!((mesh.open_edges(), mesh.volume(), mesh.area()), (0, 8.0, 24.0));
}

#[test]
fn guises_of_a_cube() {
    let parse = |bytes: &[u8], format| TriangleMesh::parse(bytes, format).unwrap_or_else(|e| panic!("{e}"));
    assert_cube(&parse(obj().as_bytes(), Format::Obj));
    assert_cube(&parse(ascii_stl().as_bytes(), Format::Stl));
    assert_cube(&parse(&binary_stl(), Format::Stl));
    // No name, exponents, the keywords in capitals, a normal that is no number.
    let odd =
        ascii_stl().replace(" cube with a name", "").replace(" -1", " -1.000E+00").replace(" 1", " 10e-01");
    assert_cube(&parse(odd.to_uppercase().as_bytes(), Format::Stl));
    assert_cube(&parse(odd.replace("normal 0 0 0", "normal nan -nan inf").as_bytes(), Format::Stl));
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for (coordinate, index) in [("float", "int"), ("double", "uchar"), ("float", "ushort")] {
            for line_end in ["\n", "\r\n", "\r"] {
                assert_cube(&parse(&ply(Ply { format, coordinate, index, line_end }), Format::Ply));
            }
        }
    }
}

#[test]
fn odd_obj_files() {
    let parse = |text: &[u8]| TriangleMesh::parse(text, Format::Obj).unwrap_or_else(|e| panic!("{e}"));
    let text = obj();
    assert_cube(&parse(format!("\u{feff}{text}").as_bytes()));
    assert_cube(&parse(text.replace('\n', "\r").as_bytes()));
    assert_cube(&parse(text.replace(" 1\n", " 1 # a remark\r\n").as_bytes()));
    assert_cube(&parse(text.replace("f ", "f \\\n ").as_bytes()));
    // A name in Latin-1, and a remark that ends like a continued line.
    assert_cube(&parse(&[b"o W\xfcrfel\n# c:\\models\\\n".to_vec(), text.clone().into_bytes()].concat()));
    // Faces before the vertices that they name.
    let (vertices, faces) = text.split_at(text.find('f').expect("faces"));
    assert_cube(&parse(format!("{faces}{vertices}").as_bytes()));
    // Tabs, blanks at the ends of lines, CR LF, and no line end after the last face.
    assert_cube(&parse(text.replace(' ', " \t ").replace('\n', " \r\n").trim_end().as_bytes()));
    // Colours, or a fourth coordinate.
    assert_cube(&parse(text.replace(" 1\n", " 1 0.2 0.3 0.4\n").replace(" -1\n", " -1 1.0\n").as_bytes()));
    // Elements that are no faces, and names of files that are not there.
    let other = "mtllib none.mtl\ng a b\ns off\nusemtl red\nl 1 2 3\np 4\nvt 0 0\nvn 0 0 1\n";
    assert_cube(&parse(format!("{other}{text}{other}").as_bytes()));
    // Corners that count backwards, and name texture coordinates and normals, some of which are not there.
    let corner = |v: usize, k: usize| match k % 3 {
        0 => format!("{}//7", v as i64 - 8),
        1 => format!("{}/1/-1", v as i64 - 8),
        _ => format!("{}/2", v + 1),
    };
    let face = |f: &[usize; 4]| {
        let corners: Vec<String> = f.iter().enumerate().map(|(k, &v)| corner(v, k)).collect();
        format!("f {}\n", corners.join(" "))
    };
    assert_cube(&parse(format!("{vertices}{}", FACES.iter().map(face).collect::<String>()).as_bytes()));
    // Three vertices to every triangle: closed all the same.
    let separate = triangles().map(|t| {
        let vertices = t.map(|v| CORNERS[v]).map(|[x, y, z]| format!("v {x:.3} {y:e} {z}\n")).concat();
        format!("{vertices}f -3 -2 -1\n")
    });
    assert_cube(&parse(separate.collect::<String>().as_bytes()));
    // Two bodies in one file.
    let moved = CORNERS.map(|[x, y, z]| format!("v {} {y} {z}\n", x + 5.0)).concat();
    let pair = parse(format!("o a\n{text}o b\n{moved}{}", faces_from(9)).as_bytes());
    assert_eq!((pair.open_edges(), pair.is_oriented(), pair.volume()), (0, true, 16.0));
    assert_eq!(pair.contains(&[[0.0; 3], [2.5, 0.0, 0.0], [5.0, 0.0, 0.0]]), [true, false, true]);
    // A prism of six sides.
    let around = |k: i32, z: i32| {
        let (sin, cos) = f64::from(60 * k).to_radians().sin_cos();
        format!("v {cos:.6} {sin:.6} {z}\n")
    };
    let ends: String = (0..12).map(|k| around(k % 6, k / 6)).collect();
    let sides: String =
        (0..6).map(|k| format!("f {} {} {} {}\n", k + 1, (k + 1) % 6 + 1, (k + 1) % 6 + 7, k + 7)).collect();
    let prism = parse(format!("{ends}{sides}f 6 5 4 3 2 1\nf 7 8 9 10 11 12\n").as_bytes());
    assert_eq!((prism.open_edges(), prism.is_oriented(), prism.triangles.len()), (0, true, 20));
    // 3 sqrt(3) / 2, of coordinates with six digits.
    assert!((prism.volume() - 1.5 * 3.0_f64.sqrt()).abs() < 1e-5, "{}", prism.volume());
    // Unused vertices, and a triangle without area that welding leaves out.
    let mesh = parse(b"v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 0 -0\nf 2 3 4\nf 3 5 4\n");
    assert_eq!((mesh.positions.len(), mesh.triangles.len(), mesh.area()), (3, 1, 0.5));
}

#[test]
fn faults_of_obj_files() {
    rejected("", Format::Obj, &["empty"]);
    rejected("hello\nworld\n", Format::Obj, &["no faces"]);
    rejected("v 0 0 0\nv 1 0 0\nv 0 1 0\n", Format::Obj, &["no faces"]);
    let with = |line: &str| format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n\n{line}\n");
    rejected(with("f 1 2 4"), Format::Obj, &["line 5", "vertex 4 of 3"]);
    rejected(with("f 1 2 -4"), Format::Obj, &["line 5", "vertex -4 of 3"]);
    rejected(with("f 0 1 2"), Format::Obj, &["line 5", "vertex 0 of 3"]);
    rejected(with("f 1 2 99999999999"), Format::Obj, &["line 5", "vertex 99999999999"]);
    rejected(with("f 1 2"), Format::Obj, &["line 5", "2 corners"]);
    rejected(with("f 1 2 x"), Format::Obj, &["line 5", "`x`"]);
    rejected(with("f 1 2 //3"), Format::Obj, &["line 5", "`//3`"]);
    rejected(with("v 1 2"), Format::Obj, &["line 5", "without z"]);
    rejected(with("v 1 2 nan"), Format::Obj, &["line 5", "`nan`"]);
    rejected(with("v 1 2 1e99"), Format::Obj, &["line 5", "`1e99`"]);
    rejected(with("v 0,5 1 2"), Format::Obj, &["line 5", "`0,5`"]);
}

#[test]
fn faults_of_stl_files() {
    rejected("", Format::Stl, &["empty"]);
    rejected("soli", Format::Stl, &["4 bytes", "binary header of 84 bytes"]);
    rejected([0; 84], Format::Stl, &["no faces"]);
    rejected("solid nothing\nendsolid nothing\n", Format::Stl, &["no faces"]);
    let bytes = binary_stl();
    for length in 84..bytes.len() {
        rejected(
            &bytes[..length],
            Format::Stl,
            &["12 triangles", "684 bytes", &length.to_string(), "cut short"],
        );
    }
    rejected([&bytes[..], b"more"].concat(), Format::Stl, &["684 bytes", "688", "more than"]);
    let mut nan = bytes.clone();
    nan[84 + 2 * 50 + 12..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    rejected(&nan, Format::Stl, &["triangle 2", "NaN"]);

    let text = ascii_stl();
    let lines: Vec<&str> = text.lines().collect();
    for end in 1..lines.len() {
        let cut = lines[..end].join("\n");
        rejected(&cut, Format::Stl, &["cut short"]);
    }
    rejected(text.replacen("vertex -1", "vertex x", 1), Format::Stl, &["line 4", "`x`"]);
    rejected(text.replacen("outer loop", "outer", 1), Format::Stl, &["line 4", "outside of a loop"]);
    rejected(text.replacen("endloop", "endloop endloop", 1), Format::Stl, &["line 7", "without a loop"]);
    rejected(text.replacen("endloop", "end", 1), Format::Stl, &["line 7", "`end`"]);
    rejected(
        "solid\nfacet normal 0 0 1 outer loop vertex 0 0 0 endloop endfacet\nendsolid",
        Format::Stl,
        &["line 2", "1 corners"],
    );
}

#[test]
fn faults_of_ply_files() {
    let text = |header: &str, body: &str| format!("ply\n{header}\nend_header\n{body}");
    let ascii = "format ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement \
                 face 1\nproperty list uchar int vertex_indices";
    let vertices = "0 0 0\n1 0 0\n0 1 0\n";
    assert!(TriangleMesh::parse(text(ascii, &format!("{vertices}3 0 1 2")).as_bytes(), Format::Ply).is_ok());
    rejected("", Format::Ply, &["empty"]);
    rejected("plx\n", Format::Ply, &["`ply`"]);
    rejected("ply\nformat ascii 1.0\n", Format::Ply, &["cut short"]);
    rejected(text("element vertex 3", ""), Format::Ply, &["`format`"]);
    rejected(text("format utf8 1.0", ""), Format::Ply, &["line 2", "expected ascii"]);
    rejected(text("format ascii 1.0\nelement vertex x", ""), Format::Ply, &["line 3", "a count"]);
    rejected(text("format ascii 1.0\nproperty float x", ""), Format::Ply, &["line 3", "before any element"]);
    rejected(
        text("format ascii 1.0\nelement a 1\nproperty half x", ""),
        Format::Ply,
        &["line 4", "unknown type"],
    );
    rejected(text("format ascii 1.0\nhello", ""), Format::Ply, &["line 3", "`hello`"]);
    rejected(text(ascii, vertices), Format::Ply, &["face 0 of 1", "cut short"]);
    rejected(text(ascii, &format!("{vertices}3 0 1 3")), Format::Ply, &["face 0", "vertex 3 of 3"]);
    rejected(text(ascii, &format!("{vertices}3 0 1 -1")), Format::Ply, &["face 0", "vertex -1"]);
    rejected(text(ascii, &format!("{vertices}-3 0 1 2")), Format::Ply, &["face 0", "-3 entries"]);
    rejected(text(ascii, &format!("{vertices}2 0 1")), Format::Ply, &["face 0", "2 corners"]);
    rejected(text(ascii, "0 0 0\n1 x 0"), Format::Ply, &["vertex 1 of 3", "`x`"]);
    rejected(text(ascii, "0 0 0\n1 inf 0"), Format::Ply, &["vertex 1 of 3", "inf"]);
    let cloud = ascii.split("element face").next().expect("vertices").trim_end();
    rejected(text(cloud, vertices), Format::Ply, &["3 points and no faces", "`particles`"]);
    rejected(text(&ascii.replace(" z", " w"), ""), Format::Ply, &["`z`"]);

    let whole = ply(Ply { format: "binary_big_endian", coordinate: "double", index: "int", line_end: "\n" });
    for length in 0..whole.len() {
        rejected(&whole[..length], Format::Ply, &[]);
    }
}

/// Counts that a file claims cost neither memory nor time.
#[test]
fn claimed_counts() {
    for encoding in ["ascii", "binary_little_endian"] {
        let claims = |elements: &str| format!("ply\nformat {encoding} 1.0\n{elements}end_header\n1");
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        let claim = "element vertex 18446744073709551615\n";
        rejected(claims(&format!("{claim}{xyz}")), Format::Ply, &["vertex 0 of 18446744073709551615"]);
        rejected(claims("element empty 18446744073709551615\nelement a 0\n"), Format::Ply, &["no faces"]);
        let list = "element face 4000000000\nproperty list double double vertex_indices\n";
        rejected(claims(list) + "e300 1 2 3", Format::Ply, &["face 0 of 4000000000"]);
    }
    let mut bytes = [0_u8; 84].to_vec();
    bytes[80..].copy_from_slice(&u32::MAX.to_le_bytes());
    rejected(&bytes, Format::Stl, &["4294967295 triangles", "cut short"]);
}

/// A comb of 998 corners has 498 reflex ones, and others cross themselves everywhere.
#[test]
fn large_polygons_are_cut_and_larger_ones_refused() {
    let comb = |teeth: u32| {
        let mut comb = vec![[0.0, 0.0, 0.0], [teeth as f32, 0.0, 0.0]];
        for tooth in (0..teeth).rev() {
            let x = tooth as f32;
            comb.extend([[x + 1.0, 2.0, 0.0], [x + 0.75, 2.0, 0.0], [x + 0.5, 1.0, 0.0], [x, 1.0, 0.0]]);
        }
        comb
    };
    for teeth in [249, 1000] {
        let comb = comb(teeth);
        let corners: Vec<u32> = (0..comb.len() as u32).collect();
        let mesh = TriangleMesh::from_polygons(comb.clone(), [&corners[..]]);
        assert_eq!(mesh.triangles.len(), comb.len() - 2);
        // Each tooth is 1 high below and (1/4 + 1/2) / 2 above; all coordinates are multiples of a quarter: exact.
        assert_eq!(mesh.area(), 1.375 * f64::from(teeth));
    }
    let comb = comb(2500);
    let vertices = comb.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    let corners: Vec<String> = (1..=comb.len()).map(|i| i.to_string()).collect();
    let obj = vertices.collect::<String>() + "f 1 2 3\nf " + &corners.join(" ") + "\n";
    rejected(obj, Format::Obj, &["face 2", "10002 corners", "at most 10000"]);

    // A thin ring, cut open: each outer corner's triangle has an inner corner in it, and the only ears are at the
    // cut. Other orders of the corners cross themselves and may have no ears at all.
    let n = 1000_u32;
    let at = |angle: f64, radius: f64| [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32, 0.0];
    let outer = (0..n / 2).map(|i| at(f64::from(i) * 0.0125, 1.0));
    let inner = (0..n / 2).rev().map(|i| at(f64::from(i) * 0.0125, 1.0 - 1e-5));
    let positions: Vec<[f32; 3]> = outer.chain(inner).collect();
    let ring: Vec<u32> = (0..n).map(|i| (i + n / 4) % n).collect();
    let mut random = ring.clone();
    random.sort_by_key(|i| i.wrapping_mul(0x9e37_79b9).rotate_left(16));
    let polygons: Vec<&[u32]> = [&ring[..], &random[..]].repeat(20);
    let mesh = TriangleMesh::from_polygons(positions, polygons);
    assert_eq!(mesh.triangles.len(), 40 * 998);
}

#[test]
fn files_that_are_no_meshes() {
    let folder = tempfile::tempdir().expect("a folder");
    let error = |path: &Path| TriangleMesh::load(path).expect_err("an error").to_string();
    assert!(error(&folder.path().join("none.obj")).contains("none.obj"));
    assert!(error(&folder.path().join("mesh.fbx")).contains("expected .obj, .ply or .stl"));
    std::fs::create_dir(folder.path().join("folder.obj")).expect("a folder");
    assert!(error(&folder.path().join("folder.obj")).contains("a directory"));
    std::fs::write(folder.path().join("CUBE.OBJ"), obj()).expect("writes");
    assert_cube(&TriangleMesh::load(folder.path().join("CUBE.OBJ")).expect("a mesh"));
}

/// A solid angle says the same as the crossings of a line: the winding number of van Oosterom & Strackee 1983.
fn winding_number(mesh: &TriangleMesh, point: [f32; 3]) -> f64 {
    let solid_angle = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| {
            let x = mesh.positions[v as usize];
            [0, 1, 2].map(|k| f64::from(x[k]) - f64::from(point[k]))
        });
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let [la, lb, lc] = [a, b, c].map(|x| dot(x, x).sqrt());
        let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
        let denominator = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
        2.0 * dot(a, cross).atan2(denominator)
    };
    mesh.triangles.iter().map(solid_angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

fn damaged(bytes: &[u8], changes: &[(usize, u8)], length: Option<usize>) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for &(at, value) in changes {
        let at = at % bytes.len();
        bytes[at] = value;
    }
    bytes.truncate(length.unwrap_or(usize::MAX));
    bytes
}

proptest! {
    // Failing cases are kept as tests by hand.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Points are inside by crossings where they are by solid angle.
    #[test]
    fn inside_agrees_with_the_winding_number(
        shape in prop::sample::select(&[Shape::Box, Shape::Sphere, Shape::Cone, Shape::Torus, Shape::Step][..]),
        // Coarse steps hit edges and vertices of the projection often.
        point in prop::array::uniform3((-8..=8_i8).prop_map(|x| f32::from(x) / 16.0)),
    ) {
        let mesh = shape.mesh();
        let winding = winding_number(&mesh, point);
        // On the surface either answer is right.
        let beside = |k: usize, step: f32| {
            let mut point = point;
            point[k] += step;
            winding_number(&mesh, point)
        };
        prop_assume!((0..3).all(|k| [-1e-3, 1e-3].iter().all(|&s| (beside(k, s) - winding).abs() < 1e-3)));
        prop_assert_eq!(mesh.contains(&[point])[0], winding.round() != 0.0, "{:?} {}", point, winding);
    }

    /// Any damage gives a mesh whose triangles name vertices that are there, or an error of one line.
    #[test]
    fn damaged_files_are_meshes_or_errors(
        file in 0..6_usize,
        changes in prop::collection::vec((any::<usize>(), any::<u8>()), 1..6),
        length in prop::option::of(0..900_usize),
    ) {
        let binary = Ply { format: "binary_little_endian", coordinate: "float", index: "int", line_end: "\n" };
        let (bytes, format) = match file {
            0 => (obj().into_bytes(), Format::Obj),
            1 => (ascii_stl().into_bytes(), Format::Stl),
            2 => (binary_stl(), Format::Stl),
            3 => (ply(binary), Format::Ply),
            4 => (ply(Ply { format: "binary_big_endian", coordinate: "double", ..binary }), Format::Ply),
            _ => (ply(Ply { format: "ascii", ..binary }), Format::Ply),
        };
        let bytes = damaged(&bytes, &changes, length);
        let (result, peak) = memory::peak_of(|| TriangleMesh::parse(&bytes, format));
        prop_assert!(peak <= BYTES_FOR_A_BYTE * bytes.len() + BYTES_FOR_A_FILE, "{peak} bytes");
        match result {
            Ok(mesh) => {
                prop_assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()));
                prop_assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < mesh.positions.len()));
                mesh.open_edges();
            }
            Err(message) => prop_assert!(!message.contains('\n'), "{message}"),
        }
    }

    /// The same for the published models, where they are there.
    #[test]
    fn damaged_models_are_meshes_or_errors(
        name in prop::sample::select(&["Box.obj", "Box_004.obj", "Fluid_003.obj"][..]),
        changes in prop::collection::vec((any::<usize>(), any::<u8>()), 1..6),
        length in prop::option::of(0..3000_usize),
    ) {
        let Some(folder) = reference() else { return Ok(()) };
        let bytes = std::fs::read(folder.join("official/datasets/models").join(name)).expect("reads");
        if let Err(message) = TriangleMesh::parse(&damaged(&bytes, &changes, length), Format::Obj) {
            prop_assert!(!message.contains('\n'), "{message}");
        }
    }
}
