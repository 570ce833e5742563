//! TensorBoard's event files: a scalar a record.
//!
//! ```text
//! record  length (u64), masked CRC of it (u32), Event, masked CRC of that (u32); little endian
//! Event   1: wall time (double), 2: step (int64), 3: file version, or 5: Summary { 1: Value { 1: tag, 2: float } }
//! ```
//!
//! Event and what is in it are protocol buffers; the CRC is CRC-32C.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};

/// What their names begin with.
const NAME: &str = "events.out.tfevents.";

/// The event files in a directory.
///
/// # Errors
/// If it cannot be read.
pub fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).and_then(|entries| entries.collect::<std::io::Result<Vec<_>>>());
    let entries = entries.with_context(|| folder.display().to_string())?;
    let named = entries.iter().filter(|entry| entry.file_name().to_string_lossy().starts_with(NAME));
    Ok(named.map(|entry| entry.path()).collect())
}

/// An event file that is written.
pub struct Events {
    file: File,
}

impl Events {
    /// Begins a file of its own in a directory: TensorBoard reads all of them together.
    pub fn create(folder: &Path) -> Result<Events> {
        let (seconds, process) = (now() as u64, std::process::id());
        let path = folder.join(format!("{NAME}{seconds}.{process}"));
        let file = File::create(&path).with_context(|| path.display().to_string())?;
        let mut events = Events { file };
        let mut event = Message::default();
        event.double(1, now());
        event.bytes(3, b"brain.Event:2");
        events.write(&event.0)?;
        Ok(events)
    }

    /// Adds values of one step, by their tags; those that there are.
    pub fn add(&mut self, step: u64, values: &[(&str, Option<f64>)]) -> Result<()> {
        let mut summary = Message::default();
        for (tag, value) in values.iter().filter_map(|(tag, value)| Some((tag, (*value)?))) {
            let mut entry = Message::default();
            entry.bytes(1, tag.as_bytes());
            entry.float(2, value as f32);
            summary.bytes(1, &entry.0);
        }
        let mut event = Message::default();
        event.double(1, now());
        event.whole(2, step);
        event.bytes(5, &summary.0);
        self.write(&event.0)
    }

    fn write(&mut self, event: &[u8]) -> Result<()> {
        let length = (event.len() as u64).to_le_bytes();
        let mut record = length.to_vec();
        record.extend(masked_crc(&length).to_le_bytes());
        record.extend(event);
        record.extend(masked_crc(event).to_le_bytes());
        // In one piece: a reader sees whole records.
        self.file.write_all(&record).context("the event file")
    }
}

/// Seconds since 1970.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

/// A protocol buffer.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    /// The number of a field and how it is coded.
    fn key(&mut self, field: u64, wire: u64) {
        self.varint(field << 3 | wire);
    }

    fn whole(&mut self, field: u64, value: u64) {
        self.key(field, 0);
        self.varint(value);
    }

    fn double(&mut self, field: u64, value: f64) {
        self.key(field, 1);
        self.0.extend(value.to_le_bytes());
    }

    fn bytes(&mut self, field: u64, value: &[u8]) {
        self.key(field, 2);
        self.varint(value.len() as u64);
        self.0.extend(value);
    }

    fn float(&mut self, field: u64, value: f32) {
        self.key(field, 5);
        self.0.extend(value.to_le_bytes());
    }
}

/// The CRC as TFRecord stores it: turned by 15 bits and moved, so that a CRC of data with CRCs is no weaker.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// CRC-32C (Castagnoli), bit by bit: records are short.
fn crc32c(bytes: &[u8]) -> u32 {
    const POLYNOMIAL: u32 = 0x82f6_3b78;
    let crc = bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (POLYNOMIAL & (crc & 1).wrapping_neg()))
    });
    !crc
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_of_the_standard() {
        // The check value of CRC-32C, and 32 zeros of RFC 3720.
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
    }

    #[test]
    fn a_message_is_the_protocol_buffer() {
        let mut message = Message::default();
        message.whole(2, 300);
        message.bytes(1, b"ab");
        message.float(2, 1.0);
        assert_eq!(message.0, [0x10, 0xac, 0x02, 0x0a, 2, b'a', b'b', 0x15, 0, 0, 0x80, 0x3f]);
    }
}
