//! Checksum of a frame, selected by its usual name.

use crc::{CRC_8_SMBUS, CRC_16_IBM_3740, CRC_16_KERMIT, CRC_16_MODBUS, CRC_16_XMODEM, CRC_32_ISO_HDLC, Crc};
use serde::Deserialize;

use crate::sensors::bit_field::Endianness;

/// Keys of the checksum: `checksum = { kind = "crc16-modbus", order = "little" }`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ChecksumKeys {
    kind: ChecksumKind,
    /// Order of the bytes of the checksum; required if it has more than one byte.
    order: Option<Endianness>,
    /// Whether the checksum includes `sync`.
    #[serde(default)]
    with_sync: bool,
}

/// Kinds of checksum; the CRCs are those of the catalogue of parametrised CRC algorithms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ChecksumKind {
    /// The low byte of the sum of all bytes.
    Sum,
    /// Exclusive or of all bytes.
    Xor,
    /// CRC-8/SMBUS.
    Crc8,
    Crc16Modbus,
    /// IBM-3740, also called CCITT-FALSE.
    Crc16Ccitt,
    Crc16Xmodem,
    Crc16Kermit,
    /// ISO-HDLC, as in zip files.
    Crc32,
}

/// Format of a checksum.
#[derive(Debug, Clone)]
pub(super) struct ChecksumFormat {
    kind: ChecksumKind,
    byte_order: Endianness,
    includes_sync: bool,
}

impl ChecksumFormat {
    /// Describes the checksum with its keys.
    pub fn describe(&self) -> String {
        let Self { kind, byte_order: order, includes_sync } = self;
        format!("{kind:?}, order {order:?}, with_sync {includes_sync}").to_lowercase()
    }

    /// Width of the checksum, bytes.
    pub fn byte_count(&self) -> usize {
        match self.kind {
            ChecksumKind::Sum | ChecksumKind::Xor | ChecksumKind::Crc8 => 1,
            ChecksumKind::Crc16Modbus
            | ChecksumKind::Crc16Ccitt
            | ChecksumKind::Crc16Xmodem
            | ChecksumKind::Crc16Kermit => 2,
            ChecksumKind::Crc32 => 4,
        }
    }

    /// Whether `received` is the checksum of `body`, preceded by `sync` if the checksum includes it.
    pub fn matches(&self, sync: &[u8], body: &[u8], received: &[u8]) -> bool {
        let begin = if self.includes_sync { sync } else { &[] };
        let sum = self.compute(&[begin, body].concat()).to_be_bytes();
        let Some(big) = sum.get(sum.len() - self.byte_count()..) else { return false };
        match self.byte_order {
            Endianness::Big => big == received,
            Endianness::Little => big.iter().rev().eq(received),
        }
    }

    fn compute(&self, bytes: &[u8]) -> u32 {
        let sixteen = |algorithm| u32::from(Crc::<u16>::new(algorithm).checksum(bytes));
        match self.kind {
            ChecksumKind::Sum => bytes.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)).into(),
            ChecksumKind::Xor => bytes.iter().fold(0, |sum, byte| sum ^ byte).into(),
            ChecksumKind::Crc8 => Crc::<u8>::new(&CRC_8_SMBUS).checksum(bytes).into(),
            ChecksumKind::Crc16Modbus => sixteen(&CRC_16_MODBUS),
            ChecksumKind::Crc16Ccitt => sixteen(&CRC_16_IBM_3740),
            ChecksumKind::Crc16Xmodem => sixteen(&CRC_16_XMODEM),
            ChecksumKind::Crc16Kermit => sixteen(&CRC_16_KERMIT),
            ChecksumKind::Crc32 => Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(bytes),
        }
    }
}

impl TryFrom<ChecksumKeys> for ChecksumFormat {
    type Error = String;

    fn try_from(ChecksumKeys { kind, order, with_sync }: ChecksumKeys) -> Result<Self, String> {
        let sum = Self { kind, byte_order: order.unwrap_or(Endianness::Little), includes_sync: with_sync };
        if sum.byte_count() > 1 && order.is_none() {
            return Err("`checksum` needs an `order`: `little` or `big`".to_owned());
        }
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_agree_with_the_catalogue() {
        // Values for the text 123456789, from the catalogue of parametrised CRC algorithms.
        let of =
            |kind| ChecksumFormat { kind, byte_order: Endianness::Big, includes_sync: false }.compute(b"123456789");
        assert_eq!(of(ChecksumKind::Crc8), 0xF4);
        assert_eq!(of(ChecksumKind::Crc16Modbus), 0x4B37);
        assert_eq!(of(ChecksumKind::Crc16Ccitt), 0x29B1);
        assert_eq!(of(ChecksumKind::Crc16Xmodem), 0x31C3);
        assert_eq!(of(ChecksumKind::Crc16Kermit), 0x2189);
        assert_eq!(of(ChecksumKind::Crc32), 0xCBF4_3926);
        // The sum is 477 = 0x1DD; the exclusive or of the digits 1 to 9, with 0x30 nine times, is 0x31.
        assert_eq!(of(ChecksumKind::Sum), 0xDD);
        assert_eq!(of(ChecksumKind::Xor), 0x31);
    }

    #[test]
    fn checksum_follows_byte_order_and_inclusion_of_sync() {
        let sum = |order, with_sync| ChecksumFormat {
            kind: ChecksumKind::Crc16Modbus,
            byte_order: order,
            includes_sync: with_sync,
        };
        assert!(sum(Endianness::Big, false).matches(b"x", b"123456789", &[0x4B, 0x37]));
        assert!(sum(Endianness::Little, false).matches(b"x", b"123456789", &[0x37, 0x4B]));
        assert!(sum(Endianness::Little, true).matches(b"123", b"456789", &[0x37, 0x4B]));
        assert!(!sum(Endianness::Little, false).matches(b"123", b"456789", &[0x37, 0x4B]));
        assert!(!sum(Endianness::Big, false).matches(b"x", b"123456789", &[0x4B, 0x37, 0]));
    }
}
