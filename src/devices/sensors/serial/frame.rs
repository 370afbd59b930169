//! A frame of bytes: `sync`, then the body of `length` bytes that holds the numbers, then the checksum, then `tail`.

use serde::Deserialize;

use super::checksum::{ChecksumFormat, ChecksumKeys};
use crate::sensors::bit_field::Endianness;
use crate::sensors::frame_layout::{FrameCounterKeys, FrameEncoderKeys, FrameLayout, FrameStatusKeys, FrameValueKeys};
use crate::sensors::sample_layout::DecodedSample;

/// Keys of `[sensor.serial.frame]`; bytes count from 0 after `sync`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameKeys {
    /// First bytes of each frame.
    sync: Vec<u8>,
    /// Number of bytes between `sync` and the checksum.
    #[serde(rename = "length")]
    body_bytes: usize,
    /// Last bytes of each frame, after the checksum.
    #[serde(default)]
    tail: Vec<u8>,
    order: Option<Endianness>,
    value: FrameValueKeys,
    counter: Option<FrameCounterKeys>,
    encoder_count: Option<FrameEncoderKeys>,
    #[serde(default)]
    status: Vec<FrameStatusKeys>,
    checksum: Option<ChecksumKeys>,
}

/// Format of a frame that has passed the checks.
#[derive(Debug, Clone)]
pub(super) struct FrameFormat {
    /// First bytes of each frame.
    pub sync: Vec<u8>,
    /// Number of bytes between `sync` and the checksum.
    body_length: usize,
    /// Last bytes of each frame, after the checksum.
    tail: Vec<u8>,
    checksum: Option<ChecksumFormat>,
    pub body_layout: FrameLayout,
}

/// Maximum number of bytes between `sync` and the checksum.
const MAX_BODY_BYTES: usize = 256;

impl FrameFormat {
    /// Keys that must be equal for all sensors of one port.
    pub fn framing_keys(&self) -> [(&'static str, String); 5] {
        let checksum = self.checksum.as_ref();
        [
            ("its table", "[sensor.serial.frame]".to_owned()),
            ("`sync`", format!("{:02X?}", self.sync)),
            ("`length`", self.body_length.to_string()),
            ("`tail`", format!("{:02X?}", self.tail)),
            ("`checksum`", checksum.map_or("not set".to_owned(), ChecksumFormat::describe)),
        ]
    }

    /// Length of a whole frame, bytes.
    pub fn frame_length(&self) -> usize {
        let check = self.checksum.as_ref().map_or(0, ChecksumFormat::byte_count);
        self.sync.len() + self.body_length + check + self.tail.len()
    }

    /// Decodes a whole frame; `None` if it is invalid.
    pub fn decode(&self, frame: &[u8]) -> Option<DecodedSample> {
        let rest = frame.strip_prefix(self.sync.as_slice())?.strip_suffix(self.tail.as_slice())?;
        let (body, check) = rest.split_at_checked(self.body_length)?;
        let sound = self.checksum.as_ref().is_none_or(|sum| sum.matches(&self.sync, body, check));
        if sound { self.body_layout.decode(body).ok() } else { None }
    }
}

impl TryFrom<FrameKeys> for FrameFormat {
    type Error = String;

    fn try_from(keys: FrameKeys) -> Result<Self, String> {
        let FrameKeys { sync, body_bytes: length, tail, order, value, counter, encoder_count, status, checksum } = keys;
        if sync.is_empty() {
            return Err("`sync` is empty; set the first bytes of each frame, e.g. [0xAA, 0x55]".to_owned());
        }
        if length == 0 || length > MAX_BODY_BYTES {
            return Err(format!(
                "`length` is {length}; permitted: 1 to {MAX_BODY_BYTES} (number of bytes between `sync` and checksum)"
            ));
        }
        let numbers = FrameLayout::new(value, counter, encoder_count, status, order, length)?;
        let checksum = checksum.map(ChecksumFormat::try_from).transpose()?;
        Ok(Self { sync, body_length: length, tail, checksum, body_layout: numbers })
    }
}
