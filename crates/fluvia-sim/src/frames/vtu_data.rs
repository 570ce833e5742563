//! The binary forms of the arrays in VTK XML files: plain or zlib-compressed, in base64 or as raw bytes.
//!
//! ```text
//! plain:       bytes, data                                              (counts are of header_type: UInt32 or UInt64)
//! compressed:  blocks, block size, last block size (0: a whole one), compressed size of each block; the blocks
//! ```
//!
//! base64 encodes the plain form in one piece, and of the compressed form the counts and the blocks in one piece each.

use std::borrow::Cow;
use std::io::Read;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;

use super::numbers::{ByteOrder, Parsed, Scalar, shown};

/// How the arrays of a file are encoded.
pub(super) struct Encoding {
    pub(super) order: ByteOrder,
    /// The type of the counts before the data.
    pub(super) counts: Scalar,
    pub(super) compressed: bool,
}

impl Default for Encoding {
    fn default() -> Encoding {
        Encoding { order: ByteOrder::Little, counts: Scalar::U32, compressed: false }
    }
}

/// The data of all arrays, at the end of a file.
pub(super) struct Appended {
    base64: bool,
    bytes: Vec<u8>,
}

impl Appended {
    /// Reads `bytes`, which begin with the tag AppendedData.
    pub(super) fn read(bytes: &[u8]) -> Parsed<Appended> {
        let truncated = || "truncated: the file ends within <AppendedData>".to_owned();
        let tag_end = bytes.iter().position(|&byte| byte == b'>').ok_or_else(truncated)?;
        let (tag, data) = bytes.split_at(tag_end);
        let start = data.iter().position(|&byte| byte == b'_').ok_or_else(truncated)?;
        let data = &data[start + 1..];
        let base64 = !tag.windows(RAW.len()).any(|window| window == RAW);
        let bytes = match base64 {
            true => {
                let end = data.iter().position(|&byte| byte == b'<').unwrap_or(data.len());
                data[..end].iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect()
            }
            false => data.to_vec(),
        };
        Ok(Appended { base64, bytes })
    }

    /// Bytes of the data, as they are encoded.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// The data from `offset` on.
    pub(super) fn source(&self, offset: usize) -> Parsed<Source<'_>> {
        match self.bytes.get(offset..) {
            Some(bytes) => Ok(Source { base64: self.base64, bytes: bytes.into() }),
            None => Err(format!("offset {offset}, but only {} bytes are appended", self.bytes.len())),
        }
    }
}

/// What in the tag says that the data is not base64.
const RAW: &[u8] = b"raw";

/// The encoded data of an array, which may go on with that of others.
pub(super) struct Source<'a> {
    base64: bool,
    bytes: Cow<'a, [u8]>,
}

impl Source<'_> {
    /// The text of an element, in base64.
    pub(super) fn inline(text: &str) -> Source<'static> {
        let bytes = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
        Source { base64: true, bytes: Cow::Owned(bytes) }
    }

    /// The data of the array, which must be of `expected` bytes, and how many bytes encode it.
    pub(super) fn decode(&self, encoding: &Encoding, expected: usize) -> Parsed<(Vec<u8>, usize)> {
        let mut pieces = Pieces { source: self, position: 0 };
        let bytes = match encoding.compressed {
            true => compressed(&mut pieces, encoding, expected)?,
            false => plain(&mut pieces, encoding, expected)?,
        };
        match bytes.len() == expected {
            true => Ok((bytes, pieces.position)),
            false => Err(format!("{} bytes, expected {expected}", bytes.len())),
        }
    }
}

/// Takes one piece after the other.
struct Pieces<'a> {
    source: &'a Source<'a>,
    position: usize,
}

impl<'a> Pieces<'a> {
    /// The next piece, of `count` bytes once decoded.
    fn take(&mut self, count: usize) -> Parsed<Cow<'a, [u8]>> {
        let encoded = if self.source.base64 { count.div_ceil(3).saturating_mul(4) } else { count };
        let rest = &self.source.bytes[self.position..];
        let Some(piece) = rest.get(..encoded) else {
            return Err(format!("truncated: {encoded} bytes needed, {} are left", rest.len()));
        };
        self.position += encoded;
        if !self.source.base64 {
            return Ok(piece.into());
        }
        let mut bytes =
            STANDARD.decode(piece).map_err(|error| format!("base64: {}", shown(&error.to_string())))?;
        if bytes.len() < count {
            return Err(format!("base64: {} bytes, expected {count}", bytes.len()));
        }
        bytes.truncate(count);
        Ok(bytes.into())
    }
}

fn count(encoding: &Encoding, bytes: &[u8]) -> usize {
    // Casts saturate; a count that f64 rounds is beyond any file.
    encoding.counts.decode(encoding.order, bytes) as usize
}

fn plain(pieces: &mut Pieces<'_>, encoding: &Encoding, expected: usize) -> Parsed<Vec<u8>> {
    let size = encoding.counts.size();
    let length = count(encoding, &pieces.take(size)?);
    if length != expected {
        return Err(format!("{length} bytes, expected {expected}"));
    }
    let is_one_piece = pieces.source.base64 && pieces.source.bytes[pieces.position - 1] != PADDING;
    // Some writers encode the count by itself, which leaves padding; in one piece with data it has none, unless the
    // data is so short that the padding is its own.
    let is_short = pieces.source.base64 && size + length <= size.next_multiple_of(3) && length > 0;
    if is_one_piece || is_short {
        pieces.position = 0;
        return Ok(pieces.take(size.saturating_add(length))?[size..].to_vec());
    }
    Ok(pieces.take(length)?.into_owned())
}

const PADDING: u8 = b'=';

fn compressed(pieces: &mut Pieces<'_>, encoding: &Encoding, expected: usize) -> Parsed<Vec<u8>> {
    let size = encoding.counts.size();
    // Three counts are a multiple of three bytes, so in base64 they end where a group of four letters does.
    let start = pieces.take(3 * size)?;
    let counts: Vec<usize> = start.chunks_exact(size).map(|bytes| count(encoding, bytes)).collect();
    let table = pieces.take(counts[0].saturating_mul(size))?;
    let sizes: Vec<usize> = table.chunks_exact(size).map(|bytes| count(encoding, bytes)).collect();
    let total = sizes.iter().fold(0usize, |sum, &size| sum.saturating_add(size));
    let blocks = pieces.take(total)?;
    let mut bytes = Vec::new();
    let mut rest = &blocks[..];
    for size in sizes {
        let (block, after) = rest.split_at(size);
        rest = after;
        // One byte more than fits is enough to see that there is too much.
        let room = (expected - bytes.len()) as u64 + 1;
        let read = ZlibDecoder::new(block).take(room).read_to_end(&mut bytes);
        read.map_err(|error| format!("zlib data: {}", shown(&error.to_string())))?;
        if bytes.len() > expected {
            return Err(format!("more than the {expected} bytes expected"));
        }
    }
    Ok(bytes)
}
