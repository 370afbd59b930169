//! Encoding of a number in registers: its type, the order of its words and bytes, its scale.

use serde::Deserialize;

/// Type of a number in registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NumberType {
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

/// Byte order of a number; `abcd` means the most significant byte first. The letters describe 32 bits; other
/// lengths use the same two choices (word order, byte order).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ByteOrder {
    #[default]
    Abcd,
    /// Least significant word first.
    Cdab,
    /// Least significant byte of each word first.
    Badc,
    /// Least significant word first, and least significant byte of each word first.
    Dcba,
}

/// Encoding of one number, e.g. `type = "i32"`, `order = "cdab"`, `scale = 0.001`. The number is `scale` times the
/// value in the registers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NumberFormat {
    pub number_type: NumberType,
    pub order: ByteOrder,
    pub scale: f64,
}

#[derive(Debug, PartialEq, thiserror::Error)]
pub enum RegisterValueError {
    #[error("{received} registers received, but the number has {expected}: compare `type` with the device's manual")]
    WrongRegisterCount { received: usize, expected: u16 },
    #[error(
        "the registers hold {0}, which is not a finite number: compare `type` and `order` with the device's manual"
    )]
    NotFinite(f64),
    #[error(
        "the registers hold {0}, which exceeds the exact range of 53 bits: compare `type` and `order` with the device's manual"
    )]
    NotExactInF64(i128),
    #[error(
        "{value} is out of range for the type {kind:?} with scale {scale}: compare `type` and `scale` with the device's manual"
    )]
    OutOfRange { value: f64, kind: NumberType, scale: f64 },
}

/// Largest integer up to which all integers are exact in an f64 (2^53).
const MAX_EXACT_INTEGER: f64 = 9_007_199_254_740_992.0;

impl NumberType {
    /// Number of registers that a number of this type occupies.
    pub fn register_count(self) -> u16 {
        match self {
            Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 | Self::F32 => 2,
            Self::U64 | Self::I64 | Self::F64 => 4,
        }
    }

    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Types other than this one with the same number of registers, the more common first.
    pub fn same_size_types(self) -> Vec<Self> {
        let all = [Self::I16, Self::U16, Self::I32, Self::U32, Self::F32, Self::I64, Self::U64, Self::F64];
        let is_same_size = |kind: &Self| *kind != self && kind.register_count() == self.register_count();
        all.into_iter().filter(is_same_size).collect()
    }

    fn is_signed(self) -> bool {
        matches!(self, Self::I16 | Self::I32 | Self::I64)
    }
}

impl NumberFormat {
    /// Number of registers that the number occupies.
    pub fn register_count(&self) -> u16 {
        self.number_type.register_count()
    }

    /// Decodes the number in `words`, in the order of the registers.
    ///
    /// # Errors
    /// Wrong number of words, or the number is not finite or not exact.
    pub fn decode(&self, words: &[u16]) -> Result<f64, RegisterValueError> {
        let expected = self.register_count();
        if words.len() != usize::from(expected) {
            return Err(RegisterValueError::WrongRegisterCount { received: words.len(), expected });
        }
        let bits = self.reorder_bytes(words).iter().fold(0_u64, |bits, word| bits << 16 | u64::from(*word));
        let raw = match self.number_type {
            // The value is in the low 32 bits.
            NumberType::F32 => f64::from(f32::from_bits(bits as u32)),
            NumberType::F64 => f64::from_bits(bits),
            _ => self.decode_integer(bits)?,
        };
        // 0.001 has no exact binary value, but 1000 has: the division gives the decimal value that the device
        // means.
        let parts = (1.0 / self.scale).round();
        let value = if parts * self.scale == 1.0 { raw / parts } else { raw * self.scale };
        if value.is_finite() { Ok(value) } else { Err(RegisterValueError::NotFinite(value)) }
    }

    /// Encodes `value` in words; for an integer type, the value is rounded.
    ///
    /// # Errors
    /// The value does not fit.
    pub fn encode(&self, value: f64) -> Result<Vec<u16>, RegisterValueError> {
        let refused = RegisterValueError::OutOfRange { value, kind: self.number_type, scale: self.scale };
        let raw = value / self.scale;
        if !raw.is_finite() {
            return Err(refused);
        }
        let bits = match self.number_type {
            NumberType::F32 if (raw as f32).is_finite() => u64::from((raw as f32).to_bits()),
            NumberType::F32 => return Err(refused),
            NumberType::F64 => raw.to_bits(),
            _ => self.encode_integer(raw.round()).ok_or(refused)?,
        };
        let count = u32::from(self.register_count());
        let words: Vec<u16> = (0..count).rev().map(|index| (bits >> (16 * index)) as u16).collect();
        Ok(self.reorder_bytes(&words))
    }

    /// Decodes the integer in the low bits.
    fn decode_integer(&self, bits: u64) -> Result<f64, RegisterValueError> {
        let unused = 64 - 16 * u32::from(self.register_count());
        let whole = if self.number_type.is_signed() {
            // Shifting up and back extends the sign.
            i128::from((bits << unused) as i64 >> unused)
        } else {
            i128::from(bits)
        };
        let number = whole as f64;
        if number.abs() <= MAX_EXACT_INTEGER { Ok(number) } else { Err(RegisterValueError::NotExactInF64(whole)) }
    }

    /// Bits of an integer; `None`: out of range for the type, or above 2^53 in magnitude.
    fn encode_integer(&self, whole: f64) -> Option<u64> {
        let bits = 16 * u32::from(self.register_count());
        let (least, most) = if self.number_type.is_signed() {
            (-(1_i128 << (bits - 1)), (1_i128 << (bits - 1)) - 1)
        } else {
            (0, (1_i128 << bits) - 1)
        };
        // The conversion is exact up to 2^53; larger values are refused.
        let number = (whole.abs() <= MAX_EXACT_INTEGER).then_some(whole as i128)?;
        (least <= number && number <= most).then_some(number as u64)
    }

    /// Reorders words from the device's order to most significant first, or back.
    fn reorder_bytes(&self, words: &[u16]) -> Vec<u16> {
        let mut words = words.to_vec();
        if matches!(self.order, ByteOrder::Cdab | ByteOrder::Dcba) {
            words.reverse();
        }
        if matches!(self.order, ByteOrder::Badc | ByteOrder::Dcba) {
            words.iter_mut().for_each(|word| *word = word.swap_bytes());
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn test_format(number_type: NumberType, order: ByteOrder, scale: f64) -> NumberFormat {
        NumberFormat { number_type, order, scale }
    }

    #[test]
    fn known_values_match_their_bit_patterns_in_every_byte_order() {
        // IEEE 754: 1.5 is 0x3FC00000, -2 in 64 bits is 0xC000000000000000.
        let of = |order| test_format(NumberType::F32, order, 1.0).decode(&[0x3FC0, 0x0000]).unwrap();
        assert_eq!(of(ByteOrder::Abcd), 1.5);
        assert_eq!(test_format(NumberType::F32, ByteOrder::Cdab, 1.0).encode(1.5).unwrap(), [0x0000, 0x3FC0]);
        assert_eq!(test_format(NumberType::F32, ByteOrder::Badc, 1.0).encode(1.5).unwrap(), [0xC03F, 0x0000]);
        assert_eq!(test_format(NumberType::F32, ByteOrder::Dcba, 1.0).encode(1.5).unwrap(), [0x0000, 0xC03F]);
        let wide = test_format(NumberType::F64, ByteOrder::Cdab, 1.0);
        assert_eq!(wide.encode(-2.0).unwrap(), [0, 0, 0, 0xC000]);
        // -2 in two's complement.
        assert_eq!(test_format(NumberType::I16, ByteOrder::Badc, 1.0).decode(&[0xFEFF]).unwrap(), -2.0);
        assert_eq!(test_format(NumberType::I32, ByteOrder::Abcd, 0.001).decode(&[0xFFFF, 0xFFFE]).unwrap(), -0.002);
        // 12345 times 0.001 would give 12.345000000000001.
        assert_eq!(test_format(NumberType::I32, ByteOrder::Abcd, 0.001).decode(&[0, 12345]).unwrap(), 12.345);
        assert_eq!(test_format(NumberType::U32, ByteOrder::Abcd, 1.0).decode(&[0xFFFF, 0xFFFE]).unwrap(), 4294967294.0);
    }

    #[test]
    fn value_beyond_its_type_is_refused() {
        let short = test_format(NumberType::I16, ByteOrder::Abcd, 0.001);
        assert_eq!(short.encode(32.767).unwrap(), [0x7FFF]);
        assert!(matches!(short.encode(32.768), Err(RegisterValueError::OutOfRange { .. })));
        assert_eq!(short.encode(-32.768).unwrap(), [0x8000]);
        assert!(short.encode(f64::NAN).is_err());
        assert!(test_format(NumberType::U16, ByteOrder::Abcd, 1.0).encode(-1.0).is_err());
        assert!(test_format(NumberType::U16, ByteOrder::Abcd, 0.0).encode(1.0).is_err());
        assert!(test_format(NumberType::F32, ByteOrder::Abcd, 1.0).encode(1e39).is_err());
        let nan = test_format(NumberType::F32, ByteOrder::Abcd, 1.0).decode(&[0x7FC0, 0]).unwrap_err();
        assert!(matches!(nan, RegisterValueError::NotFinite(_)));
        let large = test_format(NumberType::U64, ByteOrder::Abcd, 1.0).decode(&[0xFFFF; 4]).unwrap_err();
        assert_eq!(large, RegisterValueError::NotExactInF64(i128::from(u64::MAX)));
        let count = test_format(NumberType::I32, ByteOrder::Abcd, 1.0).decode(&[1]).unwrap_err();
        assert_eq!(count, RegisterValueError::WrongRegisterCount { received: 1, expected: 2 });
    }

    #[test]
    fn type_and_byte_order_are_read_from_lowercase_words() {
        #[derive(Debug, Deserialize)]
        struct FormatKeys {
            number_type: NumberType,
            order: ByteOrder,
        }
        let keys: FormatKeys = toml::from_str("number_type = \"i32\"\norder = \"cdab\"").unwrap();
        assert_eq!((keys.number_type, keys.order), (NumberType::I32, ByteOrder::Cdab));
        assert!(toml::from_str::<FormatKeys>("number_type = \"i33\"\norder = \"cdab\"").is_err());
    }
}
