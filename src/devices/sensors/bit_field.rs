//! Position of an integer within the bytes of a frame, for all sensors that send frames.

use serde::Deserialize;

/// Order in which the bytes of a number are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Endianness {
    /// The least significant byte first (Intel).
    Little,
    /// The most significant byte first (Motorola).
    Big,
}

/// An integer of `bit_width` bits. Its bytes begin at `first_byte`, in the given order; `bit_offset` is the number of
/// bits below the integer, in the first byte (little-endian) or in the last (big-endian).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BitField {
    pub first_byte: u16,
    pub bit_offset: u16,
    pub bit_width: u16,
    pub byte_order: Endianness,
    /// Whether the number is in two's complement.
    pub is_signed: bool,
}

pub const MAX_FIELD_BITS: u16 = 64;

impl BitField {
    /// # Errors
    /// The field is invalid; the message names the key in the table `name`.
    pub fn new(
        name: &str,
        byte: u16,
        bit: u16,
        bit_width: u16,
        signed: bool,
        order: Option<Endianness>,
    ) -> Result<Self, String> {
        let least = if signed { 2 } else { 1 };
        if !(least..=MAX_FIELD_BITS).contains(&bit_width) {
            let kind = if signed { "a signed number has" } else { "a number has" };
            return Err(format!("`{name}.width` is {bit_width}; {kind} {least} to {MAX_FIELD_BITS} bits"));
        }
        if bit > 7 {
            return Err(format!("`{name}.bit` is {bit}; permitted: 0 to 7 (bit within a byte)"));
        }
        // Within one byte both orders are the same.
        let order = order.or((bit + bit_width <= 8).then_some(Endianness::Little));
        let order = order.ok_or_else(|| format!("`{name}` needs an `order`: `little` or `big`"))?;
        Ok(Self { first_byte: byte, bit_offset: bit, bit_width, byte_order: order, is_signed: signed })
    }

    /// Index of the first byte after the field.
    pub fn exclusive_end_byte(&self) -> usize {
        usize::from(self.first_byte) + usize::from((self.bit_offset + self.bit_width).div_ceil(8))
    }

    /// Returns each bit of the field, as (index of the byte, bit within the byte).
    pub fn bit_positions(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let Self { first_byte: byte, bit_offset: bit, bit_width: width, byte_order: order, .. } = *self;
        let (first, last) = (usize::from(byte), self.exclusive_end_byte().saturating_sub(1));
        (usize::from(bit)..usize::from(bit) + usize::from(width)).map(move |at| match order {
            Endianness::Little => (first + at / 8, at % 8),
            Endianness::Big => (last - at / 8, at % 8),
        })
    }

    /// Returns the smallest and the largest number that the field can hold.
    pub fn number_range(&self) -> (i128, i128) {
        let size = 1_i128 << self.bit_width.min(MAX_FIELD_BITS);
        if self.is_signed { (-(size / 2), size / 2 - 1) } else { (0, size - 1) }
    }

    /// Reads the number; `None` if `frame` is too short.
    pub fn extract(&self, frame: &[u8]) -> Option<i128> {
        let bytes = frame.get(usize::from(self.first_byte)..self.exclusive_end_byte())?;
        let join = |number: u128, byte: &u8| number << 8 | u128::from(*byte);
        let joined = match self.byte_order {
            Endianness::Little => bytes.iter().rev().fold(0, join),
            Endianness::Big => bytes.iter().fold(0, join),
        };
        let size = 1_i128 << self.bit_width.min(MAX_FIELD_BITS);
        // The conversion is exact: the mask leaves at most 64 bits.
        let number = (joined >> self.bit_offset) as i128 & (size - 1);
        Some(if self.is_signed && number >= size / 2 { number - size } else { number })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(byte: u16, bit: u16, width: u16, order: Endianness, is_signed: bool) -> BitField {
        BitField { first_byte: byte, bit_offset: bit, bit_width: width, byte_order: order, is_signed }
    }

    #[test]
    fn signed_24_bit_numbers_are_extracted_in_both_byte_orders() {
        let little = field(0, 0, 24, Endianness::Little, true);
        let big = field(1, 0, 24, Endianness::Big, true);
        let cases: [([u8; 3], [u8; 4], i128); 6] = [
            ([0xFF, 0xFF, 0x7F], [0xAA, 0x7F, 0xFF, 0xFF], 8_388_607),
            ([0x00, 0x00, 0x80], [0xAA, 0x80, 0x00, 0x00], -8_388_608),
            ([0xFF, 0xFF, 0xFF], [0xAA, 0xFF, 0xFF, 0xFF], -1),
            ([0x00, 0x00, 0x00], [0xAA, 0x00, 0x00, 0x00], 0),
            ([0x01, 0x00, 0x00], [0xAA, 0x00, 0x00, 0x01], 1),
            ([0x56, 0x34, 0x12], [0xAA, 0x12, 0x34, 0x56], 0x12_3456),
        ];
        for (low_first, high_first, number) in cases {
            assert_eq!(little.extract(&low_first), Some(number));
            assert_eq!(big.extract(&high_first), Some(number));
        }
        assert_eq!(little.number_range(), (-8_388_608, 8_388_607));
    }

    #[test]
    fn twelve_bits_that_begin_within_a_byte_are_extracted() {
        // Little: the upper half of byte 0 is the lowest digit A, followed by CB.
        assert_eq!(field(0, 4, 12, Endianness::Little, false).extract(&[0xA5, 0xCB]), Some(0xCBA));
        // Big: byte 0 has the highest digits, the upper half of byte 1 the lowest.
        assert_eq!(field(0, 4, 12, Endianness::Big, false).extract(&[0xA5, 0xCB]), Some(0xA5C));
        assert_eq!(field(0, 4, 12, Endianness::Big, true).extract(&[0xA5, 0xCB]), Some(0xA5C - 0x1000));
    }

    #[test]
    fn extreme_64_bit_numbers_are_extracted() {
        let signed = field(0, 0, 64, Endianness::Big, true);
        let least = [0x80, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(signed.extract(&least), Some(i128::from(i64::MIN)));
        let unsigned = field(0, 0, 64, Endianness::Little, false);
        assert_eq!(unsigned.extract(&[0xFF; 8]), Some(i128::from(u64::MAX)));
        assert_eq!(field(0, 3, 64, Endianness::Little, false).extract(&[0xFF; 9]), Some(i128::from(u64::MAX)));
        assert_eq!(unsigned.extract(&[0xFF; 7]), None);
    }

    #[test]
    fn bit_positions_are_the_bits_that_change_the_number() {
        let fields = [
            field(0, 0, 24, Endianness::Big, false),
            field(1, 3, 7, Endianness::Big, false),
            field(1, 3, 7, Endianness::Little, false),
            field(2, 6, 1, Endianness::Little, false),
        ];
        for field in fields {
            let own: Vec<_> = field.bit_positions().collect();
            for at in 0..32 {
                let mut frame = [0_u8; 4];
                frame[at / 8] = 1 << (at % 8);
                let seen = field.extract(&frame) != Some(0);
                assert_eq!(seen, own.contains(&(at / 8, at % 8)), "{field:?}: {at}");
            }
        }
    }
}
