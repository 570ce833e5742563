//! msgpack as a stream, and in it the arrays of msgpack-numpy.
//!
//! An array is a map of `nd` true, `type` '<f4', `kind` empty, `shape` [N, 3] and `data`, its bytes in C order; a NumPy
//! number one of `nd` false, `type` and `data`. These keys and bytes are of the msgpack type bin, or, in the older form,
//! of the type str.

use std::io::{self, Read};

use rmp::Marker;
use zrip::FrameDecoder;

use super::super::numbers::{Parsed, numpy_type, shown};
use super::zst;

/// What a value begins with; of texts, bytes and extensions the content follows, of lists and maps the items.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Head {
    Nil,
    Bool(bool),
    Integer(i128),
    Float,
    /// Text or bytes, and how many bytes.
    Bytes(u64),
    List(u64),
    /// Pairs of a key and a value.
    Map(u64),
    /// How many bytes, with that of the type.
    Extension(u64),
}

/// A msgpack value after the other from a packed stream.
pub(super) struct Values<R: Read> {
    unpacked: FrameDecoder<R>,
    /// The length of the packed file.
    length: u64,
}

/// An array or number of NumPy as it is stored.
#[derive(Debug, Default)]
pub(super) struct Array {
    /// Its type, '<f4'.
    kind: String,
    /// Empty for a number.
    pub shape: Vec<u64>,
    data: Vec<u8>,
}

impl<R: Read> Values<R> {
    /// The values that are packed in `source`, which has `length` bytes.
    pub(super) fn new(source: R, length: u64) -> Values<R> {
        Values { unpacked: zst::unpack(source, length), length }
    }

    /// The head of the next value, which is `what`.
    pub(super) fn head(&mut self, what: &str) -> Parsed<Head> {
        let [first] = self.take::<1>(what)?;
        let unsigned = |bytes: &[u8]| bytes.iter().fold(0, |sum, &byte| sum << 8 | u64::from(byte));
        Ok(match Marker::from_u8(first) {
            Marker::Null => Head::Nil,
            Marker::False => Head::Bool(false),
            Marker::True => Head::Bool(true),
            Marker::FixPos(value) => Head::Integer(value.into()),
            Marker::FixNeg(value) => Head::Integer(value.into()),
            Marker::U8 => Head::Integer(u8::from_be_bytes(self.take(what)?).into()),
            Marker::U16 => Head::Integer(u16::from_be_bytes(self.take(what)?).into()),
            Marker::U32 => Head::Integer(u32::from_be_bytes(self.take(what)?).into()),
            Marker::U64 => Head::Integer(u64::from_be_bytes(self.take(what)?).into()),
            Marker::I8 => Head::Integer(i8::from_be_bytes(self.take(what)?).into()),
            Marker::I16 => Head::Integer(i16::from_be_bytes(self.take(what)?).into()),
            Marker::I32 => Head::Integer(i32::from_be_bytes(self.take(what)?).into()),
            Marker::I64 => Head::Integer(i64::from_be_bytes(self.take(what)?).into()),
            Marker::F32 => self.take::<4>(what).map(|_| Head::Float)?,
            Marker::F64 => self.take::<8>(what).map(|_| Head::Float)?,
            Marker::FixStr(length) => Head::Bytes(length.into()),
            Marker::Str8 | Marker::Bin8 => Head::Bytes(unsigned(&self.take::<1>(what)?)),
            Marker::Str16 | Marker::Bin16 => Head::Bytes(unsigned(&self.take::<2>(what)?)),
            Marker::Str32 | Marker::Bin32 => Head::Bytes(unsigned(&self.take::<4>(what)?)),
            Marker::FixArray(length) => Head::List(length.into()),
            Marker::Array16 => Head::List(unsigned(&self.take::<2>(what)?)),
            Marker::Array32 => Head::List(unsigned(&self.take::<4>(what)?)),
            Marker::FixMap(length) => Head::Map(length.into()),
            Marker::Map16 => Head::Map(unsigned(&self.take::<2>(what)?)),
            Marker::Map32 => Head::Map(unsigned(&self.take::<4>(what)?)),
            Marker::FixExt1 => Head::Extension(1 + 1),
            Marker::FixExt2 => Head::Extension(1 + 2),
            Marker::FixExt4 => Head::Extension(1 + 4),
            Marker::FixExt8 => Head::Extension(1 + 8),
            Marker::FixExt16 => Head::Extension(1 + 16),
            Marker::Ext8 => Head::Extension(1 + unsigned(&self.take::<1>(what)?)),
            Marker::Ext16 => Head::Extension(1 + unsigned(&self.take::<2>(what)?)),
            Marker::Ext32 => Head::Extension(1 + unsigned(&self.take::<4>(what)?)),
            Marker::Reserved => return Err(format!("byte 0xc1 in {what}, which is not msgpack")),
        })
    }

    /// The next value, a short text.
    pub(super) fn text(&mut self, what: &str) -> Parsed<String> {
        let head = self.head(what)?;
        self.text_of(head, what)
    }

    /// The next value, an array or number of NumPy called `name`.
    pub(super) fn array(&mut self, name: &str) -> Parsed<Array> {
        match self.head(name)? {
            Head::Map(entries) => self.array_of(entries, name),
            head => Err(format!("'{name}' is {}, expected an array of NumPy", described(head))),
        }
    }

    /// The next value, a whole number called `name`, of msgpack or NumPy.
    pub(super) fn whole(&mut self, name: &str) -> Parsed<u64> {
        let value = match self.head(name)? {
            Head::Integer(value) => value,
            Head::Map(entries) => self.array_of(entries, name)?.integer(name)?,
            head => return Err(format!("'{name}' is {}, expected a whole number", described(head))),
        };
        match u64::try_from(value) {
            // What int64, the published type, can hold; sums with a number of frames do not overflow.
            Ok(value) if value <= i64::MAX as u64 => Ok(value),
            _ => Err(format!("'{name}' is {value}, expected a number from 0 to {}", i64::MAX)),
        }
    }

    /// Passes over the next value, which is `what`.
    pub(super) fn skip(&mut self, what: &str) -> Parsed<()> {
        // A counter in place of recursion: values may be nested as deep as there are bytes.
        let mut left: u64 = 1;
        while left > 0 {
            left -= 1;
            match self.head(what)? {
                Head::Nil | Head::Bool(_) | Head::Integer(_) | Head::Float => {}
                Head::List(items) => left = left.saturating_add(items),
                Head::Map(pairs) => left = left.saturating_add(2 * pairs),
                Head::Bytes(length) | Head::Extension(length) => {
                    let passed = io::copy(&mut (&mut self.unpacked).take(length), &mut io::sink());
                    self.complete(passed, length, what)?;
                }
            }
        }
        Ok(())
    }

    /// Makes sure that nothing follows the value, `what`, that was read; its checksum is compared here.
    pub(super) fn end(&mut self, what: &str) -> Parsed<()> {
        let mut next = [0];
        match self.unpacked.read(&mut next) {
            Ok(0) => Ok(()),
            Ok(_) => Err(format!("more bytes follow {what}")),
            Err(error) => Err(zst::fault(&error, self.length, &format!("the end of {what}"))),
        }
    }

    fn array_of(&mut self, entries: u64, name: &str) -> Parsed<Array> {
        let what = format!("array '{name}'");
        let (mut array, mut has_data) = (Array::default(), false);
        for _ in 0..entries {
            match self.text(&what)?.as_str() {
                "type" => array.kind = self.kind(name)?,
                "shape" => array.shape = self.shape(name)?,
                "data" => {
                    let Head::Bytes(length) = self.head(&what)? else {
                        return Err(format!("{what} has no bytes as its data"));
                    };
                    array.data = self.bytes(length, &what)?;
                    has_data = true;
                }
                _ => self.skip(&what)?,
            }
        }
        match has_data {
            true => Ok(array),
            false => Err(format!("{what} has no data, expected the keys type, shape and data")),
        }
    }

    fn kind(&mut self, name: &str) -> Parsed<String> {
        match self.head(name)? {
            head @ Head::Bytes(_) => self.text_of(head, name),
            // A structured type.
            head => Err(format!("array '{name}' has {} as its type, expected '<f4'", described(head))),
        }
    }

    fn shape(&mut self, name: &str) -> Parsed<Vec<u64>> {
        /// More axes than NumPy itself allows.
        const MOST_AXES: u64 = 64;
        let axes = match self.head(name)? {
            Head::List(axes) if axes <= MOST_AXES => axes,
            head => return Err(format!("array '{name}' has {} as its shape", described(head))),
        };
        let axis = |_| match self.head(name)? {
            Head::Integer(length) => {
                u64::try_from(length).map_err(|_| format!("array '{name}': axis of {length}"))
            }
            head => Err(format!("array '{name}' has {} in its shape", described(head))),
        };
        (0..axes).map(axis).collect()
    }

    fn text_of(&mut self, head: Head, what: &str) -> Parsed<String> {
        /// Keys, types and names of scenes are shorter.
        const LONGEST: u64 = 1 << 12;
        let length = match head {
            Head::Bytes(length) if length <= LONGEST => length,
            head => return Err(format!("{} in {what}, expected a short text", described(head))),
        };
        let bytes = self.bytes(length, what)?;
        String::from_utf8(bytes).map_err(|_| format!("a text in {what} is not UTF-8"))
    }

    /// As many bytes as there are of `length`, so that a claim costs nothing.
    fn bytes(&mut self, length: u64, what: &str) -> Parsed<Vec<u8>> {
        let mut bytes = Vec::new();
        let read = (&mut self.unpacked).take(length).read_to_end(&mut bytes);
        self.complete(read.map(|count| count as u64), length, what)?;
        Ok(bytes)
    }

    fn take<const N: usize>(&mut self, what: &str) -> Parsed<[u8; N]> {
        let mut bytes = [0; N];
        match self.unpacked.read_exact(&mut bytes) {
            Ok(()) => Ok(bytes),
            Err(error) => Err(zst::fault(&error, self.length, what)),
        }
    }

    fn complete(&self, read: io::Result<u64>, length: u64, what: &str) -> Parsed<()> {
        let error = match read {
            Ok(count) if count == length => return Ok(()),
            Ok(_) => io::ErrorKind::UnexpectedEof.into(),
            Err(error) => error,
        };
        Err(zst::fault(&error, self.length, what))
    }
}

impl Array {
    /// The numbers of an array, called `name`, of float32.
    pub(super) fn floats(&self, name: &str) -> Parsed<Vec<f32>> {
        if self.kind != "<f4" {
            let kind = shown(&self.kind);
            return Err(format!("array '{name}' has type '{kind}', expected '<f4' (float32, little endian)"));
        }
        let count = self.shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
        let expected = count.and_then(|count| count.checked_mul(4));
        let (values, found) = (self.data.as_chunks::<4>().0, self.data.len());
        match expected {
            Some(bytes) if bytes == found as u64 => {
                Ok(values.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
            }
            _ => Err(format!("array '{name}' of shape {:?} has {found} bytes of data", self.shape)),
        }
    }

    /// The integer in an array of one, called `name`.
    fn integer(&self, name: &str) -> Parsed<i128> {
        let (order, scalar) = numpy_type(&self.kind);
        let is_integer = self.kind.trim_start_matches(['<', '>', '|']).starts_with(['i', 'u']);
        match scalar.filter(|_| is_integer) {
            // Frame numbers are far below 2^53, up to which an f64 is exact.
            Some(scalar) if scalar.size() == self.data.len() => Ok(scalar.decode(order, &self.data) as i128),
            Some(_) => {
                Err(format!("'{name}' has {} bytes of data for type '{}'", self.data.len(), self.kind))
            }
            None => Err(format!("'{name}' has type '{}', expected an integer ('<i8')", shown(&self.kind))),
        }
    }
}

/// A value in an error message.
fn described(head: Head) -> String {
    match head {
        Head::Nil => "nothing".into(),
        Head::Bool(_) => "true or false".into(),
        Head::Integer(value) => format!("the number {value}"),
        Head::Float => "a floating-point number".into(),
        Head::Bytes(length) => format!("a text of {length} bytes"),
        Head::List(length) => format!("a list of {length}"),
        Head::Map(length) => format!("a map of {length}"),
        Head::Extension(_) => "an extension type".into(),
    }
}
