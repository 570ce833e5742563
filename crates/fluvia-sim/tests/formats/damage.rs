//! Files cut short, changed at random, or with counts that are not true: errors, not panics, within bounded memory.

use std::fs;
use std::io::Write;

use fluvia_sim::frames::{Format, State};
use proptest::prelude::*;
use zip::CompressionMethod::{Deflated, Stored};

use crate::memory::peak_of;
use crate::odd::{archive, blocks, f32s, gzip, houdini, inline, npy, vtu};
use crate::{BYTES_FOR_A_BYTE, READER_STATE, file_of, one_line, parse, rejected, state};

#[test]
fn every_truncation_is_an_error() {
    for format in Format::ALL {
        let bytes = file_of(format, 3);
        // What follows the last array that is read may be missing without loss.
        let spare = match format {
            Format::Npz | Format::Ply => 0,
            Format::Bgeo => b"\x00\xff".len(),
            Format::Vtk => b"\n".len(),
            // The end of the XML may lack the line end only.
            Format::Vtu => b"\n".len(),
        };
        let whole = parse(format, &bytes).unwrap();
        for length in 0..bytes.len() - spare {
            match parse(format, &bytes[..length]) {
                Err(_) => {}
                // Legacy VTK has no end mark and no table of its arrays: a cut between two of them cannot be seen.
                Ok(data) if format == Format::Vtk => {
                    assert_eq!(data.position, whole.position, "{length} bytes");
                    assert!(data.velocity.is_none() || data.velocity == whole.velocity, "{length} bytes");
                    assert!(data.id.is_none() && data.body.is_none(), "{length} bytes");
                }
                Ok(_) => panic!("{format}: {length} of {} bytes were enough", bytes.len()),
            }
        }
        assert!(parse(format, &bytes[..bytes.len() - spare]).is_ok(), "{format}: the rest is not needed");
    }
}

#[test]
fn claimed_counts_cost_nothing() {
    let npz = |shape: &str| archive(Stored, &[("pos.npy", npy("<f4", false, shape, &[0; 12]))]);
    rejected(Format::Npz, &npz("(1000000000, 3)"), &["'pos'", "(1000000000, 3)", "found 12"]);
    rejected(Format::Npz, &npz("(9223372036854775807, 3)"), &["'pos'", "too large"]);

    for (encoding, row) in [("ascii", "1 2 3\n"), ("binary_little_endian", "123456789012")] {
        let ply = format!(
            "ply\nformat {encoding} 1.0\nelement vertex 1000000000\nproperty float x\nproperty float y\n\
             property float z\nend_header\n{row}"
        );
        rejected(Format::Ply, ply.as_bytes(), &["truncated", "vertex"]);
        // Rows without properties take no bytes: they must take no time either.
        let junk = format!(
            "ply\nformat {encoding} 1.0\nelement junk 4000000000\nelement vertex 4000000000\nend_header\n"
        );
        rejected(Format::Ply, junk.as_bytes(), &["x y z"]);
    }
    let list = b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint double i\nelement vertex 0\n\
                 property float x\nproperty float y\nproperty float z\nend_header\n\xff\xff\xff\xff";
    rejected(Format::Ply, list, &["truncated", "face"]);

    let mut points = houdini(&[1]);
    points[9..13].copy_from_slice(&1_000_000_000i32.to_be_bytes());
    rejected(Format::Bgeo, &points, &["truncated", "1000000000"]);
    rejected(Format::Bgeo, &gzip(&points), &["truncated", "1000000000"]);
    let mut attributes = houdini(&[1]);
    attributes[25..29].copy_from_slice(&i32::MAX.to_be_bytes());
    rejected(Format::Bgeo, &attributes, &[]);

    for kind in ["ASCII", "BINARY"] {
        let start = format!("# vtk DataFile Version 3.0\nx\n{kind}\nDATASET POLYDATA\n");
        for rest in ["POINTS 1000000000 float\n1 2 3\n", "VERTICES 1 18446744073709551615\n1 2 3\n"] {
            rejected(Format::Vtk, format!("{start}{rest}").as_bytes(), &["truncated"]);
        }
    }

    let one = String::from_utf8(vtu("", "format=\"ascii\">1 2 3", "format=\"ascii\">4 5 6", "")).unwrap();
    let claim = one.replace("NumberOfPoints=\"1\"", "NumberOfPoints=\"1000000000\"");
    rejected(Format::Vtu, claim.as_bytes(), &["expected 3000000000"]);
}

#[test]
fn a_small_file_that_unpacks_to_much_is_read_no_further_than_its_shape() {
    let zeros = vec![0; 16 << 20];
    let member = npy("<f4", false, "(1, 3)", &zeros);
    rejected(Format::Npz, &archive(Deflated, &[("pos.npy", member)]), &["'pos'", "more"]);
    let inline = blocks(&zeros, zeros.len());
    let bytes = vtu("compressor=\"vtkZLibDataCompressor\"", &inline, &inline, "");
    rejected(Format::Vtu, &bytes, &["'velocity'", "more"]);
}

#[test]
fn arrays_that_share_their_data_are_refused() {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("pos.npy", zip::write::SimpleFileOptions::default()).unwrap();
    zip.write_all(&npy("<f4", false, "(1, 3)", &[0; 12])).unwrap();
    zip.shallow_copy_file("pos.npy", "vel.npy").unwrap();
    rejected(Format::Npz, zip.finish().unwrap().get_ref(), &["share"]);

    const POINTS: usize = 2000;
    let array = "<DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>";
    let piece = format!("<Piece NumberOfPoints=\"{POINTS}\"><Points>{array}</Points></Piece>");
    let pieces = piece.repeat(500);
    let bytes = [
        b"<VTKFile type=\"PolyData\"><PolyData>",
        pieces.as_bytes(),
        b"</PolyData><AppendedData encoding=\"raw\">_",
        &(12 * POINTS as u32).to_le_bytes(),
        &[0; 12 * POINTS],
        b"</AppendedData></VTKFile>",
    ];
    rejected(Format::Vtu, &bytes.concat(), &["'points'", "overlaps"]);
}

/// A change to a file.
#[derive(Clone, Debug)]
enum Damage {
    Truncate(prop::sample::Index),
    Set(prop::sample::Index, u8),
    Insert(prop::sample::Index, Vec<u8>),
    Remove(prop::sample::Index, usize),
}

fn damage() -> impl Strategy<Value = Vec<Damage>> {
    let at = any::<prop::sample::Index>;
    let byte = prop_oneof![any::<u8>(), Just(0), Just(255), Just(b'9')];
    let bytes = prop_oneof![Just(b"9999999999".to_vec()), Just(b"\n-".to_vec()), any::<Vec<u8>>()];
    let one = prop_oneof![
        at().prop_map(Damage::Truncate),
        (at(), byte).prop_map(|(at, byte)| Damage::Set(at, byte)),
        (at(), bytes).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
        (at(), 1..40usize).prop_map(|(at, count)| Damage::Remove(at, count)),
    ];
    prop::collection::vec(one, 1..6)
}

fn damaged(mut bytes: Vec<u8>, damage: &[Damage]) -> Vec<u8> {
    for one in damage {
        if bytes.is_empty() {
            break;
        }
        match one {
            Damage::Truncate(at) => bytes.truncate(at.index(bytes.len())),
            Damage::Set(at, byte) => {
                let at = at.index(bytes.len());
                bytes[at] = *byte;
            }
            Damage::Insert(at, inserted) => {
                let at = at.index(bytes.len());
                bytes.splice(at..at, inserted.iter().copied());
            }
            Damage::Remove(at, count) => {
                let at = at.index(bytes.len());
                bytes.drain(at..(at + count).min(bytes.len()));
            }
        }
    }
    bytes
}

/// Whole files to damage: ours, and those of other programs that ours do not resemble.
fn originals() -> Vec<(Format, Vec<u8>)> {
    let mut files: Vec<(Format, Vec<u8>)> = Format::ALL.map(|format| (format, file_of(format, 4))).into();
    let fortran = npy("<f8", true, "(2, 3)", &[0; 48]);
    files.push((Format::Npz, archive(Deflated, &[("pos.npy", fortran)])));
    files.push((Format::Bgeo, houdini(&[2, 1])));
    files.push((Format::Bgeo, gzip(&houdini(&[2, 1]))));
    let ply = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int i\nelement vertex 2\nproperty float x\n\
               property float y\nproperty float z\nend_header\n3 0 1 2\n1 2 3\n4 5 6\n";
    files.push((Format::Ply, ply.into()));
    let vtk = "# vtk DataFile Version 5.1\nx\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n1 2 3\nMETADATA\nINFORMATION 0\n\n\
               VERTICES 2 1\nOFFSETS vtktypeint64\n0 1\nCONNECTIVITY vtktypeint64\n0\nPOINT_DATA 1\nFIELD f 2\n\
               t 1 1 string\nx\nvel 3 1 float\n1 2 3\n";
    files.push((Format::Vtk, vtk.into()));
    let points = f32s(&[1.0, 2.0, 3.0]);
    files.push((Format::Vtu, vtu("", &inline(&points), "format=\"ascii\">4 5 6", "")));
    let zlib = "compressor=\"vtkZLibDataCompressor\"";
    files.push((Format::Vtu, vtu(zlib, &blocks(&points, 8), &blocks(&points, 4), "")));
    files
}

#[test]
fn damaged_files_neither_panic_nor_fill_memory() {
    let originals = originals();
    for (format, bytes) in &originals {
        parse(*format, bytes).unwrap();
    }
    proptest!(ProptestConfig::with_cases(6000), |(which in 0..originals.len(), damage in damage())| {
        let (format, bytes) = &originals[which];
        // Accepted or rejected: `parse` checks the memory and the message.
        let _ = parse(*format, &damaged(bytes.clone(), &damage));
    });
}

#[test]
fn damaged_states_neither_panic_nor_fill_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state.npz");
    state().save(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    proptest!(ProptestConfig::with_cases(500), |(damage in damage())| {
        let damaged = damaged(bytes.clone(), &damage);
        fs::write(&path, &damaged).unwrap();
        let (result, peak) = peak_of(|| State::load(&path));
        prop_assert!(peak <= BYTES_FOR_A_BYTE * damaged.len() + READER_STATE);
        if let Err(error) = result {
            one_line(&error, &path);
        }
    });
}
