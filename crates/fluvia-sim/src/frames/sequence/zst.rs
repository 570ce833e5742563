//! zstd streams: unpacking as a stream that stops at a limit, and packing in one piece.

use std::io::{self, Read};

use zrip::{DecompressError, FrameDecoder};

/// A part may unpack to this many bytes, or to [`EXPANSION`] times its length if that is more.
const LEAST_LIMIT: u64 = 64 << 20;

/// Published parts unpack to 1.7 times their length; frames that are all the same, to some hundred times.
const EXPANSION: u64 = 1000;

/// zstd's own default. The published files are of level 22, which packs 2 % smaller, a hundred times slower.
const LEVEL: i32 = 3;

/// The bytes that are packed in `source`, which has `length` bytes.
pub(super) fn unpack<R: Read>(source: R, length: u64) -> FrameDecoder<R> {
    FrameDecoder::with_limit(source, usize::try_from(limit(length)).unwrap_or(usize::MAX))
}

/// The most bytes that a file of `length` bytes may unpack to.
pub(super) fn limit(length: u64) -> u64 {
    length.saturating_mul(EXPANSION).max(LEAST_LIMIT)
}

/// What an error of reading from [`unpack`] means; `what` was being read.
pub(super) fn fault(error: &io::Error, length: u64, what: &str) -> String {
    let unpacking = error.get_ref().and_then(|inner| inner.downcast_ref::<DecompressError>());
    match unpacking {
        Some(DecompressError::OutputTooSmall) => {
            format!("unpacks to more than {} bytes, refused for a file of {length}", limit(length))
        }
        Some(DecompressError::BadMagic) => "no zstd stream (its first bytes are others)".into(),
        _ if error.kind() == io::ErrorKind::UnexpectedEof => {
            format!("truncated: the file ends after {length} bytes, within {what}")
        }
        _ if error.raw_os_error().is_some() => format!("cannot be read: {error}"),
        _ => format!("damaged zstd stream: {error}, within {what}"),
    }
}

/// Packs bytes as one frame that names their number, as the published reader needs it, and a checksum.
pub(super) fn pack(bytes: &[u8]) -> io::Result<Vec<u8>> {
    zrip::compress(bytes, LEVEL).map_err(io::Error::other)
}
