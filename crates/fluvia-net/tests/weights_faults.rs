//! Weight files with faults, made by the tests: each gives an error of one line that names the file, what was
//! found and what was expected.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

mod common;

use common::{Archived, View, deflated, fixture, list, network, pt, replace_in_header, stored, view};
use fluvia_net::weights;

/// The message about the content of a file, which must be an error of one line that names the file.
fn fault(bytes: Vec<u8>) -> String {
    let message =
        weights::from_bytes("folder/some.file", bytes).expect_err("a fault must be found").to_string();
    assert!(!message.contains('\n'), "{message}");
    message.strip_prefix("folder/some.file: ").expect("the message begins with the file").to_owned()
}

#[track_caller]
fn assert_fault(bytes: Vec<u8>, parts: &[&str]) {
    let message = fault(bytes);
    for part in parts {
        assert!(message.contains(part), "`{part}` is not in `{message}`");
    }
}

#[test]
fn what_is_no_weight_file_is_named() {
    assert_fault(vec![], &["empty file (0 bytes)", "expected"]);
    assert_fault(
        b"{\"walls\": []}".to_vec(),
        &["not a weight file: 13 bytes", "begin with \"{\\\"walls\\\"\"", "safetensors"],
    );
    assert_fault(b"version https://git-lfs.github.com/spec/v1\noid".to_vec(), &["Git LFS pointer"]);
    let zip = |name: &str| Archived { members: vec![(name.into(), vec![0; 9])], options: stored() }.bytes();
    assert_fault(zip("pos.npy"), &["npz"]);
    assert_fault(zip("model.weights.h5"), &["Keras 3"]);
    assert_fault(zip("readme"), &["without data.pkl"]);
    let missing = weights::load("no/such.pt").unwrap_err().to_string();
    assert!(missing.starts_with("no/such.pt: "), "{missing}");
    let old = weights::load(fixture("old.pt")).unwrap_err().to_string();
    assert!(old.contains("old.pt: the old PyTorch form") && old.contains("save it again"), "{old}");
}

#[test]
fn a_tensor_or_key_that_does_not_fit_is_named() {
    let bytes = weights::to_safetensors(&network(3)).unwrap();
    let replacements: [(&str, &str, &str); 15] = [
        ("conv1.bias", "conv1.bios", "tensor `conv1.bias` is missing"),
        ("[2,3,4,6,2]", "[2,3,4,2,6]", "`conv1.kernel` has shape [2, 3, 4, 2, 6], expected [2, 3, 4, 6, 6]"),
        ("[1,4]", "[4,1]", "`dense0_fluid.weight` has shape [4, 1], expected [4, 4]"),
        ("\"gravity\":{", "\"fc.bias\":{", "tensor `fc.bias` is no part of this network"),
        ("conv2.kernel", "conv3.kernel", "tensor `conv2.kernel` is missing"),
        ("conv0_fluid.kernel", "fluid.kernel", "tensor `conv0_fluid.kernel` is missing"),
        ("[2,3,4,4,3]", "[2,3,4,12]", "`conv0_fluid.kernel` has shape [2, 3, 4, 12], expected [depth"),
        ("F32", "I32", "elements of type i32, expected f64, f32, f16 or bf16"),
        (
            "\\\"paper\\\"",
            "\\\"velocity\\\"",
            "`conv2.kernel` has shape [2, 3, 4, 2, 3], expected [2, 3, 4, 2, 6]",
        ),
        ("\\\"extra_inputs\\\":[]", "\\\"extra_inputs\\\":[\\\"age\\\"]", "expected [2, 3, 4, 5, 3]"),
        (
            "\\\"gravity\\\":[0.0,-9.81",
            "\\\"gravity\\\":[0.0,-3.71",
            "tensor `gravity` is [0.0, -9.81, 0.0], expected [0.0, -3.71, 0.0]",
        ),
        ("\\\"format_version\\\":1", "\\\"format_version\\\":2", "format version 2, expected 1"),
        ("\\\"density\\\"", "\\\"dansity\\\"", "metadata `fluvia`: unknown field `dansity`"),
        ("\\\"dt\\\":0.02", "\\\"dt\\\":-1.0", "dt is -1, expected"),
        ("metre,", "inch,", "units `inch, second"),
    ];
    for (from, to, message) in replacements {
        assert_fault(replace_in_header(&bytes, from, to), &[message]);
    }
}

#[test]
fn a_network_of_five_outputs_or_a_shifted_filter_is_another_one() {
    let mut weights = network(6);
    weights.config.gravity = [0.0, -1.0, 0.0];
    let bytes = weights::to_safetensors(&weights).unwrap();
    // Without the record the tensors alone say what the network is.
    let bytes = replace_in_header(&bytes, "\"fluvia\"", "\"other\"");
    assert_eq!(weights::from_bytes("x", bytes.clone()).unwrap(), weights);
    let five = replace_in_header(&bytes, "[2,3,4,2,6]", "[2,3,4,12,1]");
    assert_fault(five, &["`conv2.kernel` has 1 outputs, expected 3 (positions) or 6"]);

    let mut shifted = bytes;
    let place = shifted.len() - data_from_end(&shifted, "conv1.offset");
    shifted[place..place + 4].copy_from_slice(&0.5_f32.to_le_bytes());
    assert_fault(shifted, &["tensor `conv1.offset` is [0.5, 0.0, 0.0], expected zeros"]);
}

#[test]
fn a_number_that_is_not_finite_is_named() {
    let mut bytes = weights::to_safetensors(&network(3)).unwrap();
    let place = bytes.len() - data_from_end(&bytes, "dense2.weight") + 4 * 4;
    bytes[place..place + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_fault(bytes, &["tensor `dense2.weight`: value 4 is NaN"]);
    // Too large for f32.
    let mut bytes = std::fs::read(fixture("types.h5")).unwrap();
    let first = (-30.0_f64 / 32.0).to_be_bytes();
    let place = bytes.windows(8).position(|window| window == first).unwrap();
    bytes[place..place + 8].copy_from_slice(&1e300_f64.to_be_bytes());
    assert_fault(bytes, &["tensor `conv0_fluid.kernel`: value 5 is inf"]);
}

/// How far before the end of a safetensors file the data of a tensor begin.
fn data_from_end(bytes: &[u8], name: &str) -> usize {
    let header = common::header(bytes);
    let tensor = &header[header.find(&format!("\"{name}\"")).unwrap()..];
    let offsets = &tensor[tensor.find("offsets\":[").unwrap() + "offsets\":[".len()..];
    let begin: usize = offsets[..offsets.find(',').unwrap()].parse().unwrap();
    bytes.len() - 8 - header.len() - begin
}

#[test]
fn a_safetensors_file_that_was_cut_says_how_long_it_should_be() {
    let bytes = weights::to_safetensors(&network(3)).unwrap();
    let expected = format!("{} bytes expected", bytes.len());
    for lost in [1, 700, 3000] {
        let cut = bytes[..bytes.len() - lost].to_vec();
        assert_fault(cut, &["truncated", &expected, &format!("{} found", bytes.len() - lost)]);
    }
    assert_fault(bytes[..100].to_vec(), &["truncated", "100 found"]);
    let longer = [bytes.clone(), vec![0; 3]].concat();
    assert_fault(longer, &[&format!("{} expected", bytes.len())]);
    let claim = |text: &str| [&(text.len() as u64).to_le_bytes()[..], text.as_bytes()].concat();
    assert_fault(
        claim("{\"a\":{\"dtype\":\"F32\",\"shape\":[1000000000],\"data_offsets\":[0,4000000000]}}"),
        &["4000000080 bytes expected, 80 found"],
    );
    assert_fault(claim("{\"a\":1}"), &["damaged safetensors file"]);
}

#[test]
fn an_hdf5_file_that_was_cut_says_how_long_it_should_be() {
    let bytes = std::fs::read(fixture("plain.h5")).unwrap();
    let found = bytes.len() - 700;
    assert_fault(bytes[..found].to_vec(), &[&bytes.len().to_string(), &found.to_string()]);
    assert_fault(bytes[..100].to_vec(), &["HDF5", "100"]);
}

#[test]
fn chunks_of_hdf5_files_must_be_there_and_in_their_places() {
    let bytes = std::fs::read(fixture("model.h5")).unwrap();
    // The index of the chunks of one array: a node of type 1 with the count of chunks at byte 6 and, from byte 24
    // on, length and filter mask of the first chunk and its place.
    let node = bytes.windows(5).position(|window| window == b"TREE\x01").unwrap();
    let mut elsewhere = bytes.clone();
    elsewhere[node + 32..node + 40].copy_from_slice(&u64::MAX.to_le_bytes());
    assert_fault(elsewhere, &["tensor `conv", "chunks in their places, expected "]);
    let mut missing = bytes;
    missing[node + 6..node + 8].copy_from_slice(&[0; 2]);
    assert_fault(missing, &["tensor `conv", "0 of 0 chunks in their places, expected "]);
}

#[test]
fn a_pytorch_file_that_was_cut_is_named() {
    let bytes = std::fs::read(fixture("plain.pt")).unwrap();
    for length in [4, 30, 1000, bytes.len() - 1] {
        assert_fault(bytes[..length].to_vec(), &[&format!("{length} bytes"), "truncated"]);
    }
}

#[test]
fn views_of_pytorch_files_are_checked() {
    const NAME: &str = "conv0_fluid.kernel";
    let four = list(&[0.0; 4]);
    let file = |view: View| pt(&[view], &[("0", four.clone())], stored());
    assert_fault(
        file(view(NAME, "0", 4, 1, &[4], &[1])),
        &[NAME, "shape [4]", "beyond its storage of 4 elements"],
    );
    assert_fault(file(view(NAME, "0", 9, 0, &[9], &[1])), &["data/0`: 36 bytes expected, 16 found"]);
    assert_fault(file(view(NAME, "1", 4, 0, &[4], &[1])), &["data/1` is missing"]);
    assert_fault(
        file(view(NAME, "0", 4, 0, &[1_000_000_000], &[0])),
        &[NAME, "[1000000000]", "more data than a file of"],
    );
    assert_fault(file(view(NAME, "0", 4, 0, &[1; 65], &[1; 65])), &["65 extents", "at most 64"]);
    assert_fault(file(view(NAME, "0", 4, 0, &[4], &[])), &["1 extents and 0 strides"]);
    assert_fault(
        file(view(NAME, "0", 4, 0, &[1 << 40, 1 << 40], &[0, 0])),
        &["more elements than memory can hold"],
    );
    // No element at all, though the other extents are large: nothing may be counted through.
    let empty = file(view(NAME, "0", 4, 0, &[1 << 40, 0], &[0, 0]));
    assert_eq!(weights::summarize_bytes("x", empty).unwrap().parameters(), 0);
}

#[test]
fn pickles_are_read_and_not_executed() {
    let file = |pickle: &[u8]| {
        Archived { members: vec![("a/data.pkl".into(), pickle.to_vec())], options: deflated() }.bytes()
    };
    assert_fault(file(b"\x80\x02cos\nsystem\nX\x02\x00\x00\x00ls\x85R."), &["pickled object (os.system)"]);
    assert_fault(file(b"\x80\x02}."), &["holds no tensors"]);
    assert_fault(file(b"\x80\x02S'a'\n."), &["pickle, byte 2: opcode 0x53"]);
    assert_fault(file(b""), &["pickle, byte 0: ends too early"]);
    assert_fault(file(&vec![b'N'; 5 << 20]), &["5242880 bytes, expected at most 4194304"]);
    // A dictionary within itself, and names with line ends.
    assert_fault(file(b"\x80\x02}q\x00X\x01\x00\x00\x00ah\x00s."), &["holds no tensors"]);
    let bytes = pt(&[view("a\nb\u{7}", "0", 4, 4, &[1], &[1])], &[], stored());
    assert_fault(bytes, &["tensor `a b `"]);
}

#[test]
fn a_zip_entry_that_claims_more_than_the_file_can_hold_is_refused() {
    let claim = 3_u32 << 30;
    let tensor = view("conv0_fluid.kernel", "0", 1025, 0, &[1025], &[1]);
    let mut bytes = pt(&[tensor], &[("0", vec![0; 4100])], deflated());
    // The uncompressed size stands in the local header and in the central directory.
    let size = 4100_u32.to_le_bytes();
    let places: Vec<_> = (0..bytes.len() - 4).filter(|&place| bytes[place..place + 4] == size).collect();
    assert_eq!(places.len(), 2, "the size stands where it is expected");
    for place in places {
        bytes[place..place + 4].copy_from_slice(&claim.to_le_bytes());
    }
    assert_fault(bytes, &["claims 3221225472 bytes", "more than a file of"]);
}

#[test]
fn a_summary_takes_other_networks_and_counts_what_is_not_finite() {
    let values = [1.0, f32::NAN, 3.0, f32::INFINITY];
    let bytes = pt(&[view("fc.weight", "0", 4, 0, &[2, 2], &[2, 1])], &[("0", list(&values))], stored());
    let summary = weights::summarize_bytes("x", bytes.clone()).unwrap();
    let statistics = summary.tensors[0].statistics.unwrap();
    assert_eq!((statistics.min, statistics.max), (1.0, 3.0));
    assert_eq!((statistics.mean, statistics.non_finite), (2.0, 2));
    assert_fault(bytes, &["`conv0_fluid.kernel` is missing", "another network", "`fc.weight`"]);
}

#[test]
fn the_copy_under_the_usual_key_is_taken_and_others_are_refused() {
    let names = |prefixes: &[&str]| {
        let views: Vec<View> = prefixes
            .iter()
            .map(|prefix| view(&format!("{prefix}conv0_fluid.kernel"), "0", 1, 0, &[1], &[1]))
            .collect();
        pt(&views, &[("0", list(&[0.0]))], stored())
    };
    // One network was chosen: what is found missing is its next tensor.
    assert_fault(names(&["average.", "state_dict.module."]), &["tensor `conv1.kernel` is missing"]);
    assert_fault(names(&["net.fluid."]), &["tensor `conv1.kernel` is missing"]);
    assert_fault(names(&["b.", "a."]), &["several networks, under `a.`, `b.`"]);
}
