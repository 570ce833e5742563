//! Numbers as files hold them: ten scalar types in two byte orders, and a cursor over bytes that never runs out
//! of them silently.
//!
//! Readers decode everything to f64, which holds every f32 and every 32-bit integer exactly.

/// The result of parsing; the error is the message without the path.
pub(super) type Parsed<T> = Result<T, String>;

/// The order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ByteOrder {
    Little,
    Big,
}

/// The type of a number in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Bytes a number.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    /// Whether it is a floating-point type.
    pub(super) fn is_float(self) -> bool {
        matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// The number in the first [`size`](Scalar::size) bytes; 64-bit integers are rounded.
    ///
    /// # Panics
    /// If there are fewer bytes.
    pub(super) fn decode(self, order: ByteOrder, bytes: &[u8]) -> f64 {
        let mut raw = [0; 8];
        let size = self.size();
        raw[..size].copy_from_slice(&bytes[..size]);
        if order == ByteOrder::Big {
            raw[..size].reverse();
        }
        let bits = u64::from_le_bytes(raw);
        // The casts take the low bytes, which are all that was filled in, and read them as the signed type.
        match self {
            Scalar::I8 => f64::from(bits as i8),
            Scalar::U8 | Scalar::U16 | Scalar::U32 => f64::from(bits as u32),
            Scalar::I16 => f64::from(bits as i16),
            Scalar::I32 => f64::from(bits as i32),
            Scalar::I64 => bits as i64 as f64,
            Scalar::U64 => bits as f64,
            Scalar::F32 => f64::from(f32::from_bits(bits as u32)),
            Scalar::F64 => f64::from_bits(bits),
        }
    }

    /// All numbers in `bytes`; an incomplete last one is left out.
    pub(super) fn decode_all(self, order: ByteOrder, bytes: &[u8]) -> Vec<f64> {
        bytes.chunks_exact(self.size()).map(|chunk| self.decode(order, chunk)).collect()
    }
}

/// What NumPy calls a type: '<f4', '>i8', '|u1'. No scalar for what is no number of a known size.
pub(super) fn numpy_type(kind: &str) -> (ByteOrder, Option<Scalar>) {
    let (order, code) = match kind.split_at_checked(1) {
        Some(("<" | "|" | "=", code)) => (ByteOrder::Little, code),
        Some((">", code)) => (ByteOrder::Big, code),
        _ => (ByteOrder::Little, ""),
    };
    let scalar = match code {
        "i1" => Some(Scalar::I8),
        "u1" | "b1" => Some(Scalar::U8),
        "i2" => Some(Scalar::I16),
        "u2" => Some(Scalar::U16),
        "i4" => Some(Scalar::I32),
        "u4" => Some(Scalar::U32),
        "i8" => Some(Scalar::I64),
        "u8" => Some(Scalar::U64),
        "f4" => Some(Scalar::F32),
        "f8" => Some(Scalar::F64),
        _ => None,
    };
    (order, scalar)
}

/// A position in the bytes of a file.
#[derive(Clone)]
pub(super) struct Cursor<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Cursor<'a> {
        Cursor { bytes, position: 0 }
    }

    /// The bytes that are left.
    pub(super) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.position..]
    }

    /// The number of the line, counted from 1.
    pub(super) fn line_number(&self) -> usize {
        1 + self.bytes[..self.position].iter().filter(|&&byte| byte == b'\n').count()
    }

    /// The next `count` bytes, which are `what`.
    pub(super) fn take(&mut self, count: usize, what: &str) -> Parsed<&'a [u8]> {
        let rest = self.rest();
        if count > rest.len() {
            return Err(format!("truncated: {what} needs {count} bytes, {} are left", rest.len()));
        }
        self.position += count;
        Ok(&rest[..count])
    }

    /// The bytes of `count` numbers of `size` bytes, which are `what`.
    pub(super) fn take_numbers(&mut self, count: usize, size: usize, what: &str) -> Parsed<&'a [u8]> {
        match count.checked_mul(size) {
            Some(bytes) => self.take(bytes, what),
            None => {
                Err(format!("truncated: {what} claims {count} values, {} bytes are left", self.rest().len()))
            }
        }
    }

    /// The next line without its end; `None` at the end of the file.
    pub(super) fn line(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest();
        if rest.is_empty() {
            return None;
        }
        let (line, used) = match rest.iter().position(|&byte| byte == b'\n') {
            Some(end) => (&rest[..end], end + 1),
            None => (rest, rest.len()),
        };
        self.position += used;
        Some(line.strip_suffix(b"\r").unwrap_or(line))
    }

    /// The next word between blanks; `None` at the end of the file. It is empty where the bytes are not UTF-8.
    pub(super) fn word(&mut self) -> Option<&'a str> {
        let rest = self.rest();
        let start = rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let length = rest[start..].iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len() - start);
        self.position += start + length;
        Some(std::str::from_utf8(&rest[start..start + length]).unwrap_or(""))
    }

    /// The next word as a number of `what`.
    pub(super) fn number(&mut self, what: &str) -> Parsed<f64> {
        let Some(word) = self.word() else {
            return Err(format!("truncated: the file ends within {what}"));
        };
        let line = || self.line_number();
        word.parse().map_err(|_| format!("line {}: '{}' in {what}, expected a number", line(), shown(word)))
    }

    /// The next word as a count of `what`.
    pub(super) fn count(&mut self, what: &str) -> Parsed<usize> {
        let Some(word) = self.word() else {
            return Err(format!("truncated: the file ends before the number of {what}"));
        };
        let line = || self.line_number();
        word.parse().map_err(|_| format!("line {}: '{}', expected the number of {what}", line(), shown(word)))
    }
}

/// Text of a file as an error message shows it: one line, not too long.
pub(super) fn shown(text: &str) -> String {
    /// Enough to recognise the place.
    const LONGEST: usize = 40;
    text.chars().take(LONGEST).flat_map(char::escape_debug).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_decodes_in_both_orders() {
        let cases: [(Scalar, &[u8], f64); 10] = [
            (Scalar::I8, &(-5i8).to_be_bytes(), -5.0),
            (Scalar::U8, &[250], 250.0),
            (Scalar::I16, &(-300i16).to_be_bytes(), -300.0),
            (Scalar::U16, &65000u16.to_be_bytes(), 65000.0),
            (Scalar::I32, &(-70000i32).to_be_bytes(), -70000.0),
            (Scalar::U32, &4_000_000_000u32.to_be_bytes(), 4e9),
            (Scalar::I64, &(-(1i64 << 40)).to_be_bytes(), -1_099_511_627_776.0),
            (Scalar::U64, &(1u64 << 63).to_be_bytes(), 9_223_372_036_854_775_808.0),
            (Scalar::F32, &0.1f32.to_be_bytes(), f64::from(0.1f32)),
            (Scalar::F64, &(-0.1f64).to_be_bytes(), -0.1),
        ];
        for (scalar, bytes, value) in cases {
            assert_eq!(scalar.decode(ByteOrder::Big, bytes), value, "{scalar:?} big");
            let reversed: Vec<u8> = bytes.iter().rev().copied().collect();
            assert_eq!(scalar.decode(ByteOrder::Little, &reversed), value, "{scalar:?} little");
        }
    }

    #[test]
    fn a_cursor_says_what_is_missing() {
        let mut cursor = Cursor::new(b"ab\r\n 7 x");
        assert_eq!(cursor.line(), Some(&b"ab"[..]));
        assert_eq!(cursor.count("rows"), Ok(7));
        assert_eq!(cursor.number("rows"), Err("line 2: 'x' in rows, expected a number".into()));
        assert_eq!(cursor.number("rows"), Err("truncated: the file ends within rows".into()));
        assert_eq!(
            Cursor::new(b"abc").take(4, "pos"),
            Err("truncated: pos needs 4 bytes, 3 are left".into())
        );
        assert!(Cursor::new(b"abc").take_numbers(usize::MAX, 8, "pos").is_err());
    }
}
