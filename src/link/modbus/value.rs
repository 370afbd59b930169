//! Encoding of a number in registers: its type, the order of its words and bytes, its scale.

use serde::Deserialize;

/// Type of a number in registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
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
pub enum Order {
    #[default]
    Abcd,
    /// Least significant word first.
    Cdab,
    /// Least significant byte of each word first.
    Badc,
    /// Both: least significant byte first.
    Dcba,
}

/// Encoding of one number, e.g. `type = "i32"`, `order = "cdab"`, `scale = 0.001`. The number is `scale` times the
/// value in the registers.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Number {
    #[serde(rename = "type")]
    pub kind: Kind,
    #[serde(default)]
    pub order: Order,
    #[serde(default = "one")]
    pub scale: f64,
}

fn one() -> f64 {
    1.0
}

#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ValueError {
    #[error(
        "{came} registers came for a number of {wanted}: compare `type` with the device's manual"
    )]
    Count { came: usize, wanted: u16 },
    #[error(
        "the registers hold {0}, which is no number: compare `type` and `order` with the device's manual"
    )]
    NotFinite(f64),
    #[error(
        "the registers hold {0}, too large to be told exactly: compare `type` and `order` with the device's manual"
    )]
    Inexact(i128),
    #[error(
        "{value} does not fit its registers ({kind:?}, scale {scale}): compare `type` and `scale` with the device's manual"
    )]
    Range { value: f64, kind: Kind, scale: f64 },
}

/// Largest integer up to which all integers are exact in an f64 (2^53).
const EXACT: f64 = 9_007_199_254_740_992.0;

impl Kind {
    fn registers(self) -> u16 {
        match self {
            Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 | Self::F32 => 2,
            Self::U64 | Self::I64 | Self::F64 => 4,
        }
    }

    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Other types with the same number of registers, the more common first.
    pub fn others(self) -> Vec<Self> {
        let all = [
            Self::I16,
            Self::U16,
            Self::I32,
            Self::U32,
            Self::F32,
            Self::I64,
            Self::U64,
            Self::F64,
        ];
        let alike = |kind: &Self| *kind != self && kind.registers() == self.registers();
        all.into_iter().filter(alike).collect()
    }

    fn is_signed(self) -> bool {
        matches!(self, Self::I16 | Self::I32 | Self::I64)
    }
}

impl Number {
    /// Number of registers that the number occupies.
    pub fn registers(&self) -> u16 {
        self.kind.registers()
    }

    /// Decodes the number in `words`, in the order of the registers.
    ///
    /// # Errors
    /// Wrong number of words, or the number is not finite or not exact.
    pub fn read(&self, words: &[u16]) -> Result<f64, ValueError> {
        let wanted = self.registers();
        if words.len() != usize::from(wanted) {
            return Err(ValueError::Count { came: words.len(), wanted });
        }
        let bits =
            self.ordered(words).iter().fold(0_u64, |bits, word| bits << 16 | u64::from(*word));
        let raw = match self.kind {
            // The value is in the low 32 bits.
            Kind::F32 => f64::from(f32::from_bits(bits as u32)),
            Kind::F64 => f64::from_bits(bits),
            _ => self.whole(bits)?,
        };
        // 0.001 has no exact binary value, but 1000 has: the division gives the decimal value that the device
        // means.
        let parts = (1.0 / self.scale).round();
        let value = if parts * self.scale == 1.0 { raw / parts } else { raw * self.scale };
        if value.is_finite() { Ok(value) } else { Err(ValueError::NotFinite(value)) }
    }

    /// Encodes `value` in words; integer types are rounded.
    ///
    /// # Errors
    /// The value does not fit.
    pub fn write(&self, value: f64) -> Result<Vec<u16>, ValueError> {
        let refused = ValueError::Range { value, kind: self.kind, scale: self.scale };
        let raw = value / self.scale;
        if !raw.is_finite() {
            return Err(refused);
        }
        let bits = match self.kind {
            Kind::F32 if (raw as f32).is_finite() => u64::from((raw as f32).to_bits()),
            Kind::F32 => return Err(refused),
            Kind::F64 => raw.to_bits(),
            _ => self.whole_bits(raw.round()).ok_or(refused)?,
        };
        let count = u32::from(self.registers());
        let words: Vec<u16> = (0..count).rev().map(|place| (bits >> (16 * place)) as u16).collect();
        Ok(self.ordered(&words))
    }

    /// Decodes the integer in the low bits.
    fn whole(&self, bits: u64) -> Result<f64, ValueError> {
        let unused = 64 - 16 * u32::from(self.registers());
        let whole = if self.kind.is_signed() {
            // Shifting up and back extends the sign.
            i128::from((bits << unused) as i64 >> unused)
        } else {
            i128::from(bits)
        };
        let number = whole as f64;
        if number.abs() <= EXACT { Ok(number) } else { Err(ValueError::Inexact(whole)) }
    }

    fn whole_bits(&self, whole: f64) -> Option<u64> {
        let bits = 16 * u32::from(self.registers());
        let (least, most) = if self.kind.is_signed() {
            (-(1_i128 << (bits - 1)), (1_i128 << (bits - 1)) - 1)
        } else {
            (0, (1_i128 << bits) - 1)
        };
        // Exact below 2^53; the check comes before the conversion.
        let number = (whole.abs() <= EXACT).then_some(whole as i128)?;
        (least <= number && number <= most).then_some(number as u64)
    }

    /// Reorders words from the device's order to most significant first, or back.
    fn ordered(&self, words: &[u16]) -> Vec<u16> {
        let mut words = words.to_vec();
        if matches!(self.order, Order::Cdab | Order::Dcba) {
            words.reverse();
        }
        if matches!(self.order, Order::Badc | Order::Dcba) {
            words.iter_mut().for_each(|word| *word = word.swap_bytes());
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(kind: Kind, order: Order, scale: f64) -> Number {
        Number { kind, order, scale }
    }

    #[test]
    fn known_bit_patterns_in_every_order() {
        // IEEE 754: 1.5 is 0x3FC00000, -2 in 64 bits is 0xC000000000000000.
        let of = |order| number(Kind::F32, order, 1.0).read(&[0x3FC0, 0x0000]).unwrap();
        assert_eq!(of(Order::Abcd), 1.5);
        assert_eq!(number(Kind::F32, Order::Cdab, 1.0).write(1.5).unwrap(), [0x0000, 0x3FC0]);
        assert_eq!(number(Kind::F32, Order::Badc, 1.0).write(1.5).unwrap(), [0xC03F, 0x0000]);
        assert_eq!(number(Kind::F32, Order::Dcba, 1.0).write(1.5).unwrap(), [0x0000, 0xC03F]);
        let wide = number(Kind::F64, Order::Cdab, 1.0);
        assert_eq!(wide.write(-2.0).unwrap(), [0, 0, 0, 0xC000]);
        // -2 in two's complement.
        assert_eq!(number(Kind::I16, Order::Badc, 1.0).read(&[0xFEFF]).unwrap(), -2.0);
        assert_eq!(number(Kind::I32, Order::Abcd, 0.001).read(&[0xFFFF, 0xFFFE]).unwrap(), -0.002);
        // 12345 times 0.001 would give 12.345000000000001.
        assert_eq!(number(Kind::I32, Order::Abcd, 0.001).read(&[0, 12345]).unwrap(), 12.345);
        assert_eq!(
            number(Kind::U32, Order::Abcd, 1.0).read(&[0xFFFF, 0xFFFE]).unwrap(),
            4294967294.0
        );
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let short = number(Kind::I16, Order::Abcd, 0.001);
        assert_eq!(short.write(32.767).unwrap(), [0x7FFF]);
        assert!(matches!(short.write(32.768), Err(ValueError::Range { .. })));
        assert_eq!(short.write(-32.768).unwrap(), [0x8000]);
        assert!(short.write(f64::NAN).is_err());
        assert!(number(Kind::U16, Order::Abcd, 1.0).write(-1.0).is_err());
        assert!(number(Kind::U16, Order::Abcd, 0.0).write(1.0).is_err());
        assert!(number(Kind::F32, Order::Abcd, 1.0).write(1e39).is_err());
        let nan = number(Kind::F32, Order::Abcd, 1.0).read(&[0x7FC0, 0]).unwrap_err();
        assert!(matches!(nan, ValueError::NotFinite(_)));
        let large = number(Kind::U64, Order::Abcd, 1.0).read(&[0xFFFF; 4]).unwrap_err();
        assert_eq!(large, ValueError::Inexact(i128::from(u64::MAX)));
        let count = number(Kind::I32, Order::Abcd, 1.0).read(&[1]).unwrap_err();
        assert_eq!(count, ValueError::Count { came: 1, wanted: 2 });
    }

    #[test]
    fn it_is_read_from_toml() {
        let parsed: Number =
            toml::from_str("type = \"i32\"\norder = \"cdab\"\nscale = 0.001").unwrap();
        assert_eq!(parsed, number(Kind::I32, Order::Cdab, 0.001));
        let parsed: Number = toml::from_str("type = \"f32\"").unwrap();
        assert_eq!(parsed, number(Kind::F32, Order::Abcd, 1.0));
        assert!(toml::from_str::<Number>("type = \"i33\"").is_err());
        assert!(toml::from_str::<Number>("type = \"i32\"\nword = 1").is_err());
    }
}
