//! A classic CAN frame: an identifier and up to 8 bytes.

use std::fmt;

/// An identifier of 11 bits (standard) or 29 (extended).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanId {
    raw: u32,
    extended: bool,
}

const MAX_STANDARD_ID: u32 = 0x7FF;
const MAX_EXTENDED_ID: u32 = 0x1FFF_FFFF;

impl CanId {
    /// # Errors
    /// The identifier is too large; as a message.
    pub fn new(raw: u32, extended: bool) -> Result<Self, String> {
        if extended && raw > MAX_EXTENDED_ID {
            return Err(format!("{raw:#x} is too large for 29 bits; the maximum is {MAX_EXTENDED_ID:#x}"));
        }
        if !extended && raw > MAX_STANDARD_ID {
            return Err(format!(
                "{raw:#x} is too large for 11 bits (maximum {MAX_STANDARD_ID:#x}); set `extended = true` for an \
                 identifier of 29 bits"
            ));
        }
        Ok(Self { raw, extended })
    }

    pub(super) fn raw(self) -> u32 {
        self.raw
    }

    pub(super) fn is_extended(self) -> bool {
        self.extended
    }
}

/// Same format as can-utils: three or eight hexadecimal digits.
impl fmt::Display for CanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = if self.extended { 8 } else { 3 };
        write!(f, "{:0digits$X}", self.raw)
    }
}

pub(super) const MAX_DATA_BYTES: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CanFrame {
    /// Time of reception, s.
    pub t_s: f64,
    pub id: CanId,
    bytes: [u8; MAX_DATA_BYTES],
    length: usize,
}

impl CanFrame {
    /// Keeps the first 8 bytes if `data` is longer than a frame.
    pub fn new(t_s: f64, id: CanId, data: &[u8]) -> Self {
        let length = data.len().min(MAX_DATA_BYTES);
        let mut bytes = [0; MAX_DATA_BYTES];
        bytes.iter_mut().zip(data).for_each(|(byte, source)| *byte = *source);
        Self { t_s, id, bytes, length }
    }

    pub fn data(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }
}
