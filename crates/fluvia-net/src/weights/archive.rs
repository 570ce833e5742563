//! What the three file formats have in common: named arrays whose values are read one at a time.

use super::FileKind;

/// A weight file, opened: what it holds is known and has been checked against its length.
pub(super) trait Archive {
    /// The format.
    fn kind(&self) -> FileKind;
    /// Notes that the file carries beside the tensors, sorted by key.
    fn metadata(&self) -> &[(String, String)];
    /// The tensors, in the order of the file.
    fn entries(&self) -> &[Entry];
    /// The values of tensor `index`, row-major.
    fn values(&mut self, index: usize) -> Result<Vec<f64>, String>;
}

/// One tensor of a file.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// The name in the file.
    pub name: String,
    /// Extents, outermost first; the element count does not overflow.
    pub shape: Vec<usize>,
    /// The type of the elements.
    pub element: Element,
}

impl Entry {
    /// The number of elements.
    pub fn count(&self) -> usize {
        self.shape.iter().product()
    }
}

/// The type of the elements of a tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Element {
    F64,
    F32,
    F16,
    BF16,
    I64,
    I32,
    I16,
    I8,
    U64,
    U32,
    U16,
    U8,
    Bool,
    /// A type that is listed but not read.
    Other(String),
}

impl Element {
    /// The name in messages.
    pub fn name(&self) -> &str {
        match self {
            Element::F64 => "f64",
            Element::F32 => "f32",
            Element::F16 => "f16",
            Element::BF16 => "bf16",
            Element::I64 => "i64",
            Element::I32 => "i32",
            Element::I16 => "i16",
            Element::I8 => "i8",
            Element::U64 => "u64",
            Element::U32 => "u32",
            Element::U16 => "u16",
            Element::U8 => "u8",
            Element::Bool => "bool",
            Element::Other(name) => name,
        }
    }

    /// Bytes of one element; `None` for a type that is not read.
    pub fn size(&self) -> Option<usize> {
        match self {
            Element::F64 | Element::I64 | Element::U64 => Some(8),
            Element::F32 | Element::I32 | Element::U32 => Some(4),
            Element::F16 | Element::BF16 | Element::I16 | Element::U16 => Some(2),
            Element::I8 | Element::U8 | Element::Bool => Some(1),
            Element::Other(_) => None,
        }
    }

    /// Whether these are numbers that weights can be made of.
    pub fn is_float(&self) -> bool {
        matches!(self, Element::F64 | Element::F32 | Element::F16 | Element::BF16)
    }

    /// The value of one little-endian element of [`Element::size`] bytes.
    pub fn decode(&self, bytes: &[u8]) -> f64 {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        let word = u64::from_le_bytes(word);
        match self {
            Element::F64 => f64::from_bits(word),
            Element::F32 => f64::from(f32::from_bits(word as u32)),
            Element::F16 => half(word as u16),
            Element::BF16 => f64::from(f32::from_bits((word as u32) << 16)),
            Element::I64 => word as i64 as f64,
            Element::I32 => f64::from(word as i32),
            Element::I16 => f64::from(word as i16),
            Element::I8 => f64::from(word as i8),
            Element::Bool => f64::from(u8::from(word != 0)),
            Element::U64 | Element::U32 | Element::U16 | Element::U8 | Element::Other(_) => word as f64,
        }
    }

    /// All values of a little-endian array.
    pub fn decode_all(&self, bytes: &[u8]) -> Result<Vec<f64>, String> {
        let size = self.size().ok_or_else(|| self.not_read())?;
        Ok(bytes.chunks_exact(size).map(|element| self.decode(element)).collect())
    }

    /// The message for a type that is listed but not read.
    pub fn not_read(&self) -> String {
        format!("elements of type {}, expected f64, f32, f16 or bf16", self.name())
    }
}

/// The value of an IEEE 754 half-precision number.
fn half(bits: u16) -> f64 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let exponent = i32::from(bits >> 10 & 0x1f);
    let fraction = f64::from(bits & 0x3ff) / 1024.0;
    let magnitude = match exponent {
        0 => fraction * f64::powi(2.0, -14),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        _ => (1.0 + fraction) * f64::powi(2.0, exponent - 15),
    };
    sign * magnitude
}

/// The largest factor by which deflate can shrink data.
const DEFLATE_RATIO: u64 = 1032;

/// What a compressed file may grow to if that is more than its own length, bytes: some hundred times the
/// largest network of this kind.
const EXPANSION_LIMIT: u64 = 1 << 30;

/// How many bytes a file of `length` bytes may ask to be held in memory, for each of: its storage, its
/// tensors. Compressed and broadcast tensors can be larger than their file, but not without bound.
pub(super) fn memory_limit(length: usize) -> u64 {
    let length = length as u64;
    length.saturating_mul(DEFLATE_RATIO).min(EXPANSION_LIMIT).max(length)
}

/// The number of elements of a shape, if it can be counted.
pub(super) fn element_count(shape: &[usize]) -> Result<usize, String> {
    shape
        .iter()
        .try_fold(1_usize, |count, &extent| count.checked_mul(extent))
        .filter(|&count| count <= isize::MAX as usize / size_of::<f64>())
        .ok_or_else(|| format!("shape {shape:?} has more elements than memory can hold"))
}

/// Checks that the tensors together stay within the limit of a file of `length` bytes, and so does each of them
/// while it is held as f64.
pub(super) fn check_total(entries: &[Entry], length: usize) -> Result<(), String> {
    let limit = memory_limit(length);
    // What an uncompressed tensor of one-byte elements can need.
    let held_limit = limit.max((length as u64).saturating_mul(size_of::<f64>() as u64));
    let mut total = 0_u64;
    for entry in entries {
        let count =
            element_count(&entry.shape).map_err(|fault| format!("tensor `{}`: {fault}", entry.name))?;
        total = total.saturating_add(count as u64 * entry.element.size().unwrap_or(1) as u64);
        if total > limit || (count * size_of::<f64>()) as u64 > held_limit {
            return Err(format!(
                "tensor `{}` has shape {:?}: more data than a file of {length} bytes can hold",
                entry.name, entry.shape
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_type_decodes() {
        let cases: [(Element, &[u8], f64); 14] = [
            (Element::F64, &(-0.1_f64).to_le_bytes(), -0.1),
            (Element::F32, &0.1_f32.to_le_bytes(), f64::from(0.1_f32)),
            (Element::F16, &0x3c01_u16.to_le_bytes(), 1.0 + 1.0 / 1024.0),
            (Element::F16, &0x8001_u16.to_le_bytes(), -f64::powi(2.0, -24)),
            (Element::F16, &0x7bff_u16.to_le_bytes(), 65504.0),
            (Element::BF16, &0xc040_u16.to_le_bytes(), -3.0),
            (Element::I64, &(-5_i64).to_le_bytes(), -5.0),
            (Element::I32, &(-5_i32).to_le_bytes(), -5.0),
            (Element::I16, &(-5_i16).to_le_bytes(), -5.0),
            (Element::I8, &(-5_i8).to_le_bytes(), -5.0),
            (Element::U32, &u32::MAX.to_le_bytes(), 4_294_967_295.0),
            (Element::U16, &u16::MAX.to_le_bytes(), 65535.0),
            (Element::U8, &[255], 255.0),
            (Element::Bool, &[2], 1.0),
        ];
        for (element, bytes, value) in cases {
            assert_eq!(element.size(), Some(bytes.len()), "{}", element.name());
            assert_eq!(element.decode(bytes), value, "{}", element.name());
        }
        assert!(Element::F16.decode(&0x7e00_u16.to_le_bytes()).is_nan());
        assert_eq!(Element::F16.decode(&0xfc00_u16.to_le_bytes()), f64::NEG_INFINITY);
    }

    #[test]
    fn a_small_file_may_grow_by_deflate_only_and_a_large_one_by_nothing() {
        assert_eq!(memory_limit(100), 103_200);
        assert_eq!(memory_limit(10 << 20), 1 << 30);
        assert_eq!(memory_limit(2 << 30), 2 << 30);
        assert!(element_count(&[usize::MAX, 2]).is_err());
        assert_eq!(element_count(&[]), Ok(1));
    }
}
