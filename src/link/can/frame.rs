//! A classic CAN frame: an identifier and up to 8 bytes.

use std::fmt;

/// An identifier of 11 bits (standard) or 29 (extended).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Id {
    raw: u32,
    extended: bool,
}

const MOST_STANDARD: u32 = 0x7FF;
const MOST_EXTENDED: u32 = 0x1FFF_FFFF;

impl Id {
    /// # Errors
    /// The identifier is too large; as a message.
    pub fn new(raw: u32, extended: bool) -> Result<Self, String> {
        if extended && raw > MOST_EXTENDED {
            return Err(format!("{raw:#x} is too large; 29 bits go to {MOST_EXTENDED:#x}"));
        }
        if !extended && raw > MOST_STANDARD {
            return Err(format!(
                "{raw:#x} is too large for 11 bits, which go to {MOST_STANDARD:#x}; one of 29 bits \
                 needs `extended = true`"
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
impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = if self.extended { 8 } else { 3 };
        write!(f, "{:0digits$X}", self.raw)
    }
}

pub(super) const MOST_BYTES: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Time of reception, s.
    pub t_s: f64,
    pub id: Id,
    bytes: [u8; MOST_BYTES],
    length: usize,
}

impl Frame {
    /// Keeps the first 8 bytes if `data` is longer than a frame.
    pub fn new(t_s: f64, id: Id, data: &[u8]) -> Self {
        let length = data.len().min(MOST_BYTES);
        let mut bytes = [0; MOST_BYTES];
        bytes.iter_mut().zip(data).for_each(|(byte, given)| *byte = *given);
        Self { t_s, id, bytes, length }
    }

    pub fn data(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }
}
