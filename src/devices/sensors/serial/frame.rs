//! A frame of bytes: `sync`, then `length` bytes that hold the numbers, then the checksum, then `tail`. So
//! numbers cannot overlap with the framing.

use serde::Deserialize;

use super::checksum::{Checksum, Keys as ChecksumKeys};
use crate::sensors::field::Order;
use crate::sensors::layout::{self, CounterKeys, Decoded, EncoderCountKeys, StatusKeys, ValueKeys};

/// Keys of `[sensor.serial.frame]`; bytes count from 0 after `sync`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Keys {
    sync: Vec<u8>,
    length: usize,
    #[serde(default)]
    tail: Vec<u8>,
    order: Option<Order>,
    value: ValueKeys,
    counter: Option<CounterKeys>,
    encoder_count: Option<EncoderCountKeys>,
    #[serde(default)]
    status: Vec<StatusKeys>,
    checksum: Option<ChecksumKeys>,
}

/// A frame layout that has passed the checks.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub sync: Vec<u8>,
    length: usize,
    tail: Vec<u8>,
    checksum: Option<Checksum>,
    numbers: layout::Layout,
}

const LONGEST: usize = 256;

impl Layout {
    pub fn round(&self) -> Option<u64> {
        self.numbers.counter_width().map(|width| 1 << width)
    }

    pub fn encoder_round(&self) -> Option<u64> {
        self.numbers.encoder_round()
    }

    /// Keys that must be equal for all sensors of one port.
    pub fn framing(&self) -> [(&'static str, String); 5] {
        let checksum = self.checksum.as_ref();
        [
            ("its table", "[sensor.serial.frame]".to_owned()),
            ("`sync`", format!("{:02X?}", self.sync)),
            ("`length`", self.length.to_string()),
            ("`tail`", format!("{:02X?}", self.tail)),
            ("`checksum`", checksum.map_or("not set".to_owned(), Checksum::in_full)),
        ]
    }

    /// Length of a whole frame, bytes.
    pub fn whole(&self) -> usize {
        let check = self.checksum.as_ref().map_or(0, Checksum::width);
        self.sync.len() + self.length + check + self.tail.len()
    }

    /// Decodes a whole frame; `None` if it is invalid.
    pub fn read(&self, frame: &[u8]) -> Option<Decoded> {
        let rest = frame.strip_prefix(self.sync.as_slice())?.strip_suffix(self.tail.as_slice())?;
        let (body, check) = rest.split_at_checked(self.length)?;
        let sound = self.checksum.as_ref().is_none_or(|sum| sum.fits(&self.sync, body, check));
        if sound { self.numbers.decode(body).ok() } else { None }
    }
}

impl TryFrom<Keys> for Layout {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys { sync, length, tail, order, value, counter, encoder_count, status, checksum } =
            keys;
        if sync.is_empty() {
            return Err(
                "`sync` must be the bytes that each frame begins with, e.g. [0xAA, 0x55]; \
                        without them nobody knows where a frame begins"
                    .to_owned(),
            );
        }
        if length == 0 || length > LONGEST {
            return Err(format!(
                "`length` is {length}; it is the bytes between `sync` and the checksum, 1 to {LONGEST}"
            ));
        }
        let numbers = layout::Layout::new(value, counter, encoder_count, status, order, length)?;
        let checksum = checksum.map(Checksum::try_from).transpose()?;
        Ok(Self { sync, length, tail, checksum, numbers })
    }
}
