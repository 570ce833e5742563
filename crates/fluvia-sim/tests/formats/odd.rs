//! Files as other programs write them, and the faults that users meet, made byte by byte.

use std::io::{Cursor, Write};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use fluvia_sim::frames::Format;
use zip::CompressionMethod::{self, Deflated, Stored};

use crate::{file_of, parse, rejected};

/// A `.npy` member with any header.
pub(crate) fn npy(kind: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let fortran = if fortran { "True" } else { "False" };
    let header = format!("{{'descr': '{kind}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let length = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat()
}

pub(crate) fn archive(method: CompressionMethod, members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    for (name, bytes) in members {
        zip.start_file(*name, options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

pub(crate) fn f32s(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn u32s(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn npz_in_column_major_float64_deflated_and_big_endian() {
    // Particles (0, 1, 2) and (3, 4, 5): in column-major order all x come first.
    let fortran: Vec<u8> = [0.0f64, 3.0, 1.0, 4.0, 2.0, 5.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let big: Vec<u8> = (0..6u8).flat_map(|i| f32::from(i).to_be_bytes()).collect();
    let members = [
        ("pos.npy", npy("<f8", true, "(2, 3)", &fortran)),
        ("vel.npy", npy(">f4", false, "(2, 3)", &big)),
        ("id.npy", npy("<i8", false, "(2,)", &[9, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0])),
        ("comment.npy", npy("<U3", false, "()", &[0; 12])),
    ];
    let data = parse(Format::Npz, &archive(Deflated, &members)).unwrap();
    assert_eq!(data.position, [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]);
    assert_eq!(data.velocity, Some(data.position.clone()));
    assert_eq!(data.id, Some(vec![9, 7]), "npz keeps the order of the file");
}

#[test]
fn npz_walls_may_have_their_normals_under_either_name() {
    for (name, has_normal) in [("normals.npy", true), ("vel.npy", false)] {
        let member = |name| (name, npy("<f4", false, "(1, 3)", &f32s(&[0.0, 1.0, 0.0])));
        let data = parse(Format::Npz, &archive(Stored, &[member("pos.npy"), member(name)])).unwrap();
        assert_eq!((data.normal.is_some(), data.velocity.is_some()), (has_normal, !has_normal));
    }
}

#[test]
fn npz_faults_name_the_array() {
    let one = |name, member| archive(Stored, &[(name, member)]);
    let second =
        |name, member| archive(Stored, &[("pos.npy", npy("<f4", false, "(2, 3)", &[0; 24])), (name, member)]);
    let check = |bytes: &[u8], mentions: &[&str]| rejected(Format::Npz, bytes, mentions);

    let wide = npy("<f4", false, "(3, 40)", &[0; 480]);
    check(&one("pos.npy", wide), &["'pos'", "(3, 40)", "(N, 3)"]);
    let nan = npy("<f4", false, "(2, 3)", &f32s(&[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0]));
    check(&second("vel.npy", nan), &["'vel'", "particle 1", "NaN", "finite"]);
    let large: Vec<u8> = [1e300f64, 0.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    check(&one("pos.npy", npy("<f8", false, "(1, 3)", &large)), &["'pos'", "particle 0", "float32"]);
    check(&second("vel.npy", npy("<f4", false, "(1, 3)", &[0; 12])), &["'vel'", "1 particles", "expected 2"]);
    check(&second("vel.npy", npy("<f4", false, "(2, 3)", &[0; 20])), &["'vel'", "24 bytes", "20"]);
    check(&second("vel.npy", npy("<f4", false, "(2, 3)", &[0; 28])), &["'vel'", "24 bytes", "more"]);
    check(&second("vel.npy", npy("<i4", false, "(2, 3)", &[0; 24])), &["'vel'", "<i4", "float32 or float64"]);
    let negative = npy("<i4", false, "(2,)", &[[0; 4], [0xff; 4]].concat());
    check(&second("id.npy", negative), &["'id'", "particle 1", "-1"]);
    check(&second("body.npy", npy("<u4", false, "(1, 2)", &[0; 8])), &["'body'", "(1, 2)", "(N,)"]);
    check(&one("points.npy", npy("<f4", false, "(0, 3)", &[])), &["'pos'", "points.npy"]);
    check(&one("pos.npy", b"\x93NUMPX".to_vec()), &["'pos'"]);
    check(b"PK but no archive", &["npz"]);
}

#[test]
fn a_flipped_bit_in_an_npz_is_noticed() {
    let mut bytes = file_of(Format::Npz, 50);
    let positions = bytes.windows(3).position(|window| window == b"'<f").unwrap() + 200;
    bytes[positions] ^= 4;
    rejected(Format::Npz, &bytes, &["'pos'", "damaged"]);
}

/// Classic Houdini geometry with the attributes `id` (integer), `density`, `name` (text), `v`.
pub(crate) fn houdini(id: &[i32]) -> Vec<u8> {
    let mut bytes = b"BgeoV".to_vec();
    for number in [5, id.len() as i32, 0, 0, 0, 4, 0, 0, 0] {
        bytes.extend(number.to_be_bytes());
    }
    let mut attribute = |name: &str, size: u16, kind: i32, rest: &[u8]| {
        bytes.extend((name.len() as u16).to_be_bytes());
        bytes.extend(name.as_bytes());
        bytes.extend(size.to_be_bytes());
        bytes.extend(kind.to_be_bytes());
        bytes.extend(rest);
    };
    attribute("id", 1, 1, &[0; 4]);
    attribute("density", 1, 0, &[0; 4]);
    attribute("name", 1, 4, b"\x00\x00\x00\x02\x00\x02ab\x00\x01c");
    attribute("v", 3, 5, &[0; 12]);
    for &id in id {
        for value in [id as f32, 0.5, 0.25, 1.0] {
            bytes.extend(value.to_be_bytes());
        }
        bytes.extend(id.to_be_bytes());
        bytes.extend(1000f32.to_be_bytes());
        bytes.extend(1i32.to_be_bytes());
        for value in [id as f32 + 0.5, 2.0, 3.0] {
            bytes.extend(value.to_be_bytes());
        }
    }
    bytes.extend(b"\x00\xff");
    bytes
}

/// Bytes of a point of [`houdini`].
const HOUDINI_POINT: usize = 40;

pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn bgeo_compressed_with_unknown_attributes_and_in_any_order() {
    let plain = houdini(&[30, 10, 20]);
    for bytes in [plain.clone(), gzip(&plain)] {
        let data = parse(Format::Bgeo, &bytes).unwrap();
        assert_eq!(data.id, Some(vec![10, 20, 30]));
        assert_eq!(data.position, [[10.0, 0.5, 0.25], [20.0, 0.5, 0.25], [30.0, 0.5, 0.25]]);
        assert_eq!(data.velocity, Some(vec![[10.5, 2.0, 3.0], [20.5, 2.0, 3.0], [30.5, 2.0, 3.0]]));
        assert_eq!((data.body, data.normal), (None, None));
    }
}

#[test]
fn bgeo_faults() {
    let check = |bytes: &[u8], mentions: &[&str]| rejected(Format::Bgeo, bytes, mentions);
    let good = houdini(&[3, 1, 2]);
    check(b"\x7fNSJb\x5b\x27\x0bfileversion", &["newer", "classic", ".bhclassic"]);
    check(&good[..good.len() - 10], &["truncated", "points 0 to 2 of 3"]);
    check(&gzip(&good)[..60], &["gzip"]);
    let mut damaged = gzip(&good);
    let checksum = damaged.len() - 8;
    damaged[checksum] ^= 1;
    check(&damaged, &["gzip"]);
    check(&houdini(&[1, -1]), &["'id'", "particle 1", "-1"]);
    let mut old = good.clone();
    old[8] = 4;
    check(&old, &["version 4", "expected 5"]);
    let mut nan = good.clone();
    let second_point = good.len() - 2 - 2 * HOUDINI_POINT;
    nan[second_point..second_point + 4].copy_from_slice(&f32::NAN.to_be_bytes());
    check(&nan, &["'P'", "particle 1", "NaN"]);
    check(b"GeoV5 or so", &["bgeo"]);
}

#[test]
fn ply_of_other_programs() {
    let text = "ply\r\nformat ascii 1.0\r\ncomment by M\u{fc}ller\r\nobj_info x\r\nelement material 1\r\n\
                property list uchar int ids\r\nelement vertex 2\r\nproperty uchar red\r\nproperty double x\r\n\
                property float32 y\r\nproperty float z\r\nproperty float vx\r\nproperty float vy\r\n\
                property float vz\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\
                2 7 8\r\n255 1 2.5e-1 3 4 5 6\r\n0 -1 0 0 0 0 0\r\n3 0 1 2";
    // The comment in Latin-1 is no UTF-8.
    let latin1: Vec<u8> = text.chars().map(|c| c as u8).collect();
    let data = parse(Format::Ply, &latin1).unwrap();
    assert_eq!(data.position, [[1.0, 0.25, 3.0], [-1.0, 0.0, 0.0]]);
    assert_eq!(data.velocity, Some(vec![[4.0, 5.0, 6.0], [0.0; 3]]));

    let mut big = b"ply\nformat binary_big_endian 1.0\nelement strip 1\nproperty list int ushort i\nelement vertex 1\n\
                    property double x\nproperty short y\nproperty list uchar float f\nproperty float z\nend_header\n"
        .to_vec();
    big.extend([0, 0, 0, 2, 0, 1, 0, 2]);
    big.extend(0.5f64.to_be_bytes());
    big.extend((-3i16).to_be_bytes());
    big.extend([1, 9, 9, 9, 9]);
    big.extend(7f32.to_be_bytes());
    assert_eq!(parse(Format::Ply, &big).unwrap().position, [[0.5, -3.0, 7.0]]);
}

#[test]
fn ply_faults() {
    let check = |bytes: &[u8], mentions: &[&str]| rejected(Format::Ply, bytes, mentions);
    let file = |count: &str, properties: &str, rows: &str| {
        let properties: String =
            properties.split(' ').map(|name| format!("property float {name}\n")).collect();
        format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n{rows}").into_bytes()
    };
    check(&file("2", "x y z", "1 2 3\n4 nan 6\n"), &["'x y z'", "particle 1", "NaN"]);
    check(&file("2", "x y z", "1 2 3\n4 5\n"), &["truncated", "vertex 1 of 2"]);
    check(&file("1", "x y z", "1 2,5 3\n"), &["line 8", "'2,5'", "number"]);
    check(&file("1", "x y", "1 2\n"), &["x y z"]);
    check(&file("1", "x y z vx vz", "1 2 3 4 5\n"), &["vx vy vz"]);
    check(&file("-1", "x y z", ""), &["line 3", "-1"]);
    check(b"ply\nformat ascii 1.0\nelement vertex 1\n", &["end_header"]);
    check(b"ply\nformat ascii 1.0\nelement face 0\nend_header\n", &["vertex"]);
    check(b"OFF\n1 2 3\n", &["PLY"]);
}

#[test]
fn vtk_51_in_ascii_as_paraview_writes_it() {
    let text = "# vtk DataFile Version 5.1\nvtk output\nASCII\nDATASET POLYDATA\nPOINTS 2 double\n1 2 3 4 5 6 \n\
                METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1 \n\n\
                VERTICES 3 2\nOFFSETS vtktypeint64\n0 1 2 \nCONNECTIVITY vtktypeint64\n0 1 \n\
                CELL_DATA 2\nFIELD FieldData 1\nvelocity 3 2 float\n9 9 9 9 9 9\nMETADATA\nINFORMATION 0\n\n\
                POINT_DATA 2\nSCALARS density float\nLOOKUP_TABLE default\n1000 1000\nNORMALS N float\n0 1 0 0 1 0\n\
                FIELD FieldData 3\nlabel 1 2 string\nfirst point\nsecond\nMETADATA\nINFORMATION 0\n\n\
                velocity 3 2 float\n-1 -2 -3 -4 -5 -6\nMETADATA\nINFORMATION 0\n\nid 1 2 vtktypeint64\n8 9\n";
    let data = parse(Format::Vtk, text.as_bytes()).unwrap();
    assert_eq!(data.position, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(data.velocity, Some(vec![[-1.0, -2.0, -3.0], [-4.0, -5.0, -6.0]]), "not that of the cells");
    assert_eq!(data.normal, Some(vec![[0.0, 1.0, 0.0]; 2]));
    assert_eq!(data.id, Some(vec![8, 9]));
}

#[test]
fn vtk_20_in_binary() {
    let mut bytes =
        b"# vtk DataFile Version 2.0\nold\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 double\n".to_vec();
    bytes.extend([1.0f64, 2.0, 3.0].iter().flat_map(|value| value.to_be_bytes()));
    bytes.extend(
        b"\nCELLS 1 2\n\x00\x00\x00\x01\x00\x00\x00\x00\nCELL_TYPES 1\n\x00\x00\x00\x01\nPOINT_DATA 1\n",
    );
    bytes.extend(b"SCALARS pressure double 1\nLOOKUP_TABLE default\n\x3f\xf0\x00\x00\x00\x00\x00\x00\n");
    bytes.extend(b"COLOR_SCALARS c 3\n\x0a\x0a\x0a\nFIELD f 2\nnames 1 1 string\n\xc3a\nb\n");
    bytes.extend(b"vel 3 1 float\n");
    bytes.extend([4.0f32, 5.0, 6.0].iter().flat_map(|value| value.to_be_bytes()));
    let data = parse(Format::Vtk, &bytes).unwrap();
    assert_eq!(data.position, [[1.0, 2.0, 3.0]]);
    assert_eq!(data.velocity, Some(vec![[4.0, 5.0, 6.0]]));
}

#[test]
fn vtk_faults() {
    let check = |bytes: &[u8], mentions: &[&str]| rejected(Format::Vtk, bytes, mentions);
    let file =
        |rest: &str| format!("# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n{rest}").into_bytes();
    check(&file("POINTS 2 float\n1 2 3 4 5"), &["truncated", "points"]);
    check(&file("POINTS 1 float\n1 2 x"), &["line 6", "'x'"]);
    check(&file("POINTS 1 float\n1 nan 3"), &["'points'", "particle 0"]);
    check(
        &file("POINTS 1 float\n1 2 3\nPOINT_DATA 2\nVECTORS v float\n1 2 3 4 5 6"),
        &["'v'", "2", "expected 1"],
    );
    check(&file("POINTS 1 colour\n1 2 3"), &["colour"]);
    check(&file("POINTS 1 float\n1 2 3\nNONSENSE"), &["line 7", "NONSENSE"]);
    check(&file(""), &["POINTS"]);
    let grid = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 2 2 2\n";
    check(grid, &["STRUCTURED_POINTS", "POLYDATA"]);
    check(b"solid x", &["VTK"]);
}

/// A file of one particle, (1, 2, 3) with velocity (4, 5, 6); the arrays' encodings are given.
pub(crate) fn vtu(attributes: &str, points: &str, velocity: &str, appended: &str) -> Vec<u8> {
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" {attributes}>\n<UnstructuredGrid>\n\
         <FieldData><DataArray type=\"Float64\" Name=\"velocity\" NumberOfTuples=\"1\" format=\"ascii\">0</DataArray>\
         </FieldData><Piece NumberOfPoints=\"1\" NumberOfCells=\"0\">\n<PointData>\n<DataArray type=\"Float32\" \
         Name=\"velocity\" NumberOfComponents=\"3\" {velocity}</DataArray>\n<DataArray type=\"String\" Name=\"text\" \
         format=\"ascii\">97</DataArray></PointData>\n<Points>\n<DataArray type=\"Float32\" NumberOfComponents=\"3\" \
         {points}</DataArray>\n</Points>\n<Cells></Cells>\n</Piece>\n</UnstructuredGrid>\n{appended}</VTKFile>\n"
    )
    .into_bytes()
}

/// An array in base64, its count and data in one piece.
pub(crate) fn inline(data: &[u8]) -> String {
    let count = u32s(&[data.len() as u32]);
    format!("format=\"binary\">\n  {}\n", STANDARD.encode([&count[..], data].concat()))
}

/// An array in base64, compressed in blocks of `size` bytes.
pub(crate) fn blocks(data: &[u8], size: usize) -> String {
    let blocks: Vec<Vec<u8>> = data.chunks(size).map(zlib).collect();
    let last = data.len() % size;
    let mut counts = vec![blocks.len() as u32, size as u32, last as u32];
    counts.extend(blocks.iter().map(|block| block.len() as u32));
    format!("format=\"binary\">{}{}", STANDARD.encode(u32s(&counts)), STANDARD.encode(blocks.concat()))
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn vtu_in_all_its_encodings() {
    let (points, velocity) = (f32s(&[1.0, 2.0, 3.0]), f32s(&[4.0, 5.0, 6.0]));
    let big = |data: &[u8]| data.chunks(4).flat_map(|v| v.iter().rev().copied()).collect::<Vec<u8>>();
    let count = 12u64.to_be_bytes();
    let one_piece = |data: &[u8]| STANDARD.encode([&u32s(&[12])[..], data].concat());
    let zlib_attribute = "byte_order=\"LittleEndian\" compressor=\"vtkZLibDataCompressor\"";
    let files = [
        vtu("", "format=\"ascii\">\n1 2\n3e0", "format=\"ascii\">4 5 6", ""),
        // ParaView puts ranges into the element of an array.
        vtu(
            "",
            "format=\"ascii\">1 2 3<InformationKey name=\"RANGE\" length=\"2\"><Value>0</Value></InformationKey>",
            "format=\"ascii\"><InformationKey><Value index=\"0\">7</Value></InformationKey>4 5 6",
            "",
        ),
        vtu("", &inline(&points), &inline(&velocity), ""),
        vtu(
            "byte_order=\"BigEndian\" header_type=\"UInt64\"",
            &format!("format=\"binary\">{}", STANDARD.encode([&count[..], &big(&points)].concat())),
            // The count by itself, as some writers do.
            &format!("format=\"binary\">{}{}", STANDARD.encode(count), STANDARD.encode(big(&velocity))),
            "",
        ),
        vtu(zlib_attribute, &blocks(&points, 8), &blocks(&velocity, 12), ""),
        vtu(
            "byte_order=\"LittleEndian\"",
            &format!("format=\"appended\" offset=\"{}\">", one_piece(&velocity).len()),
            "format=\"appended\" offset=\"0\">",
            &format!(
                "<AppendedData encoding=\"base64\">\n _{}{}\n</AppendedData>",
                one_piece(&velocity),
                one_piece(&points)
            ),
        ),
        [
            vtu(
                "header_type=\"UInt64\" byte_order=\"BigEndian\"",
                "format=\"appended\" offset=\"0\">",
                "format=\"appended\" offset=\"20\">",
                "<AppendedData encoding=\"raw\">\n_",
            )
            .strip_suffix(b"</VTKFile>\n")
            .unwrap(),
            &count,
            &big(&points),
            &count,
            &big(&velocity),
            b"\n</AppendedData></VTKFile>",
        ]
        .concat(),
    ];
    for (number, bytes) in files.iter().enumerate() {
        let data = parse(Format::Vtu, bytes).unwrap_or_else(|message| panic!("file {number}: {message}"));
        assert_eq!(data.position, [[1.0, 2.0, 3.0]], "file {number}");
        assert_eq!(data.velocity, Some(vec![[4.0, 5.0, 6.0]]), "file {number}");
    }
}

#[test]
fn vtu_faults() {
    let check = |bytes: &[u8], mentions: &[&str]| rejected(Format::Vtu, bytes, mentions);
    let velocity = "format=\"ascii\">4 5 6";
    let points = |points: &str| vtu("", points, velocity, "");
    check(&points("format=\"ascii\">1 2"), &["'points'", "2 numbers", "expected 3"]);
    check(&points("format=\"ascii\">1 NaN 2"), &["'points'", "particle 0", "NaN"]);
    check(&points("format=\"binary\">AAAA"), &["'points'", "truncated"]);
    check(&points("format=\"binary\">!!!!!!!!"), &["'points'", "base64"]);
    check(&points("format=\"appended\" offset=\"0\">"), &["'points'", "appended"]);
    let lz4 = vtu("compressor=\"vtkLZ4DataCompressor\"", velocity, velocity, "");
    check(&lz4, &["vtkLZ4DataCompressor", "vtkZLibDataCompressor"]);
    let whole = points("format=\"ascii\">1 2 3");
    check(&whole[..whole.len() - 30], &["truncated"]);
    check(b"<html><body></body></html>", &["<html>", "VTKFile"]);
    check(b"<VTKFile type=\"Collection\"></VTKFile>", &["pvd"]);
    check(b"<VTKFile type=\"ImageData\"></VTKFile>", &["ImageData", "UnstructuredGrid"]);
}
