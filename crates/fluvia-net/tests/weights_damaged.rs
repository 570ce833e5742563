//! Damaged weight files: real files, cut and changed at random places, are read without a panic and in bounded
//! memory. One test only, for it counts the memory of the whole process.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use common::{fixture, network};
use fluvia_net::weights;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;

/// Counts what is allocated.
struct Counted;

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: both functions hand their arguments to the system's allocator unchanged; counting touches no memory of it.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(now, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counted = Counted;

/// Cases for each file; `FLUVIA_DAMAGED_CASES` sets another number, for a longer search.
const CASES: u32 = 400;

/// Cases for the published files, which are large.
const PUBLISHED_CASES: u32 = 40;

/// What reading a file of `length` bytes may hold at once, bytes. A file may ask for 1032 times its length
/// (deflate), at most 1 GiB, for its storages and as much for its values, twice over while they are converted: far
/// less than what the 4-byte and 8-byte lengths in the files can claim. The rest is for names and the library.
fn memory(length: usize) -> usize {
    4 * (length * 1032).min(1 << 30) + (16 << 20)
}

/// A change of a file.
#[derive(Clone, Debug)]
enum Damage {
    Cut(prop::sample::Index),
    Byte(prop::sample::Index, u8),
    Bit(prop::sample::Index, u8),
    /// Eight bytes that read as a large number.
    Large(prop::sample::Index, u64),
    Copy(prop::sample::Index, prop::sample::Index, usize),
}

fn damage() -> impl Strategy<Value = Damage> {
    let place = any::<prop::sample::Index>;
    prop_oneof![
        1 => place().prop_map(Damage::Cut),
        4 => (place(), any::<u8>()).prop_map(|(place, byte)| Damage::Byte(place, byte)),
        4 => (place(), 0..8_u8).prop_map(|(place, bit)| Damage::Bit(place, bit)),
        2 => (place(), prop_oneof![Just(u64::MAX), Just(1 << 31), Just(1 << 40), any::<u64>()])
            .prop_map(|(place, number)| Damage::Large(place, number)),
        2 => (place(), place(), 1..200_usize).prop_map(|(from, to, length)| Damage::Copy(from, to, length)),
    ]
}

fn apply(bytes: &mut Vec<u8>, damage: &Damage) {
    if bytes.is_empty() {
        return;
    }
    let size = bytes.len();
    match *damage {
        Damage::Cut(place) => bytes.truncate(place.index(size)),
        Damage::Byte(place, byte) => bytes[place.index(size)] = byte,
        Damage::Bit(place, bit) => bytes[place.index(size)] ^= 1 << bit,
        Damage::Large(place, number) => {
            let place = place.index(size);
            let end = size.min(place + 8);
            bytes[place..end].copy_from_slice(&number.to_le_bytes()[..end - place]);
        }
        Damage::Copy(from, to, length) => {
            let (from, to) = (from.index(size), to.index(size));
            let length = length.min(size - from.max(to));
            bytes.copy_within(from..from + length, to);
        }
    }
}

#[test]
fn damaged_files_are_refused_or_read_in_bounded_memory() {
    let mut files = vec![("ours.safetensors", weights::to_safetensors(&network(3)).unwrap())];
    for name in [
        "plain.pt",
        "protocol4.pt",
        "checkpoint.pt",
        "views.pt",
        "old.pt",
        "plain.h5",
        "model.h5",
        "types.h5",
    ] {
        files.push((name, std::fs::read(fixture(name)).unwrap()));
    }
    // Compressed members, as other writers make them.
    let tensor = common::view("conv0_fluid.kernel", "0", 1025, 0, &[1025], &[1]);
    files.push(("deflated.pt", common::pt(&[tensor], &[("0", vec![0; 4100])], common::deflated())));

    for name in ["pretrained_model_weights.pt", "pretrained_model_weights.h5"] {
        if let Some(path) = common::reference(&format!("official/{name}")) {
            files.push((name, std::fs::read(path).unwrap()));
        }
    }

    let cases = std::env::var("FLUVIA_DAMAGED_CASES").ok().and_then(|number| number.parse().ok());
    for (name, bytes) in files {
        // Headers lie at the beginning and the end: damage there is tried as often as anywhere else.
        let near = prop_oneof![Just(bytes.len()), Just(600.min(bytes.len()))];
        let strategy = (near, prop::collection::vec(damage(), 1..6));
        let run = |(reach, damages): (usize, Vec<Damage>)| {
            let (head, tail) = bytes.split_at(reach);
            let mut changed = head.to_vec();
            damages.iter().for_each(|damage| apply(&mut changed, damage));
            changed.extend(tail);
            let before = NOW.load(Ordering::Relaxed);
            PEAK.store(before, Ordering::Relaxed);
            for outcome in [
                weights::from_bytes(name, changed.clone()).err(),
                weights::summarize_bytes(name, changed).err(),
            ] {
                let message = outcome.map(|fault| fault.to_string()).unwrap_or_default();
                prop_assert!(!message.contains('\n'), "{message}");
            }
            let used = PEAK.load(Ordering::Relaxed) - before;
            prop_assert!(used < memory(bytes.len()), "{used} bytes were held");
            Ok(())
        };
        let usual = if name.starts_with("pretrained") { PUBLISHED_CASES } else { CASES };
        let config =
            ProptestConfig { cases: cases.unwrap_or(usual), failure_persistence: None, ..Default::default() };
        if let Err(failure) = TestRunner::new(config).run(&strategy, run) {
            panic!("{name}: {failure}");
        }
    }
}
