//! Checksum of a frame, selected by its usual name.

use crc::{
    CRC_8_SMBUS, CRC_16_IBM_3740, CRC_16_KERMIT, CRC_16_MODBUS, CRC_16_XMODEM, CRC_32_ISO_HDLC, Crc,
};
use serde::Deserialize;

use crate::sensors::field::Order;

/// Keys of the checksum: `checksum = { kind = "crc16-modbus", order = "little" }`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Keys {
    kind: Kind,
    order: Option<Order>,
    /// Whether the checksum includes `sync`.
    #[serde(default)]
    with_sync: bool,
}

/// Kinds of checksum; the CRCs are those of the catalogue of parametrised CRC algorithms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    /// The low byte of the sum of all bytes.
    Sum,
    /// Exclusive or of all bytes.
    Xor,
    Crc8,
    Crc16Modbus,
    /// IBM-3740, also called CCITT-FALSE.
    Crc16Ccitt,
    Crc16Xmodem,
    Crc16Kermit,
    /// ISO-HDLC, as in zip files.
    Crc32,
}

#[derive(Debug, Clone)]
pub(super) struct Checksum {
    kind: Kind,
    order: Order,
    with_sync: bool,
}

impl Checksum {
    /// Describes the checksum with its keys.
    pub fn in_full(&self) -> String {
        let Self { kind, order, with_sync } = self;
        format!("{kind:?}, order {order:?}, with_sync {with_sync}").to_lowercase()
    }

    /// Width of the checksum, bytes.
    pub fn width(&self) -> usize {
        match self.kind {
            Kind::Sum | Kind::Xor | Kind::Crc8 => 1,
            Kind::Crc16Modbus | Kind::Crc16Ccitt | Kind::Crc16Xmodem | Kind::Crc16Kermit => 2,
            Kind::Crc32 => 4,
        }
    }

    pub fn fits(&self, sync: &[u8], body: &[u8], came: &[u8]) -> bool {
        let begin = if self.with_sync { sync } else { &[] };
        let sum = self.of(&[begin, body].concat()).to_be_bytes();
        let Some(big) = sum.get(sum.len() - self.width()..) else { return false };
        match self.order {
            Order::Big => big == came,
            Order::Little => big.iter().rev().eq(came),
        }
    }

    fn of(&self, bytes: &[u8]) -> u32 {
        let sixteen = |algorithm| u32::from(Crc::<u16>::new(algorithm).checksum(bytes));
        match self.kind {
            Kind::Sum => bytes.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)).into(),
            Kind::Xor => bytes.iter().fold(0, |sum, byte| sum ^ byte).into(),
            Kind::Crc8 => Crc::<u8>::new(&CRC_8_SMBUS).checksum(bytes).into(),
            Kind::Crc16Modbus => sixteen(&CRC_16_MODBUS),
            Kind::Crc16Ccitt => sixteen(&CRC_16_IBM_3740),
            Kind::Crc16Xmodem => sixteen(&CRC_16_XMODEM),
            Kind::Crc16Kermit => sixteen(&CRC_16_KERMIT),
            Kind::Crc32 => Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(bytes),
        }
    }
}

impl TryFrom<Keys> for Checksum {
    type Error = String;

    fn try_from(Keys { kind, order, with_sync }: Keys) -> Result<Self, String> {
        let sum = Self { kind, order: order.unwrap_or(Order::Little), with_sync };
        if sum.width() > 1 && order.is_none() {
            return Err("`checksum` needs an `order`: `little` or `big`".to_owned());
        }
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_values_of_the_catalogue() {
        // Values for the text 123456789, from the catalogue of parametrised CRC algorithms.
        let of = |kind| Checksum { kind, order: Order::Big, with_sync: false }.of(b"123456789");
        assert_eq!(of(Kind::Crc8), 0xF4);
        assert_eq!(of(Kind::Crc16Modbus), 0x4B37);
        assert_eq!(of(Kind::Crc16Ccitt), 0x29B1);
        assert_eq!(of(Kind::Crc16Xmodem), 0x31C3);
        assert_eq!(of(Kind::Crc16Kermit), 0x2189);
        assert_eq!(of(Kind::Crc32), 0xCBF4_3926);
        // The sum is 477 = 0x1DD; the exclusive or of the digits 1 to 9, with 0x30 nine times, is 0x31.
        assert_eq!(of(Kind::Sum), 0xDD);
        assert_eq!(of(Kind::Xor), 0x31);
    }

    #[test]
    fn it_comes_in_either_order_and_covers_what_is_said() {
        let sum = |order, with_sync| Checksum { kind: Kind::Crc16Modbus, order, with_sync };
        assert!(sum(Order::Big, false).fits(b"x", b"123456789", &[0x4B, 0x37]));
        assert!(sum(Order::Little, false).fits(b"x", b"123456789", &[0x37, 0x4B]));
        assert!(sum(Order::Little, true).fits(b"123", b"456789", &[0x37, 0x4B]));
        assert!(!sum(Order::Little, false).fits(b"123", b"456789", &[0x37, 0x4B]));
        assert!(!sum(Order::Big, false).fits(b"x", b"123456789", &[0x4B, 0x37, 0]));
    }
}
