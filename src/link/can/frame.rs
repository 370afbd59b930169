//! A classic CAN frame: an identifier and up to 8 bytes.

use std::fmt;

use socketcan::{ExtendedId, Id, StandardId};

/// An identifier of 11 bits (standard) or 29 (extended).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanId(pub(super) Id);

impl CanId {
    /// # Errors
    /// A message, if the identifier is too large.
    pub fn new(raw: u32, is_extended: bool) -> Result<Self, String> {
        if is_extended {
            let max_id = ExtendedId::MAX.as_raw();
            let id = ExtendedId::new(raw).map(|id| Self(id.into()));
            return id.ok_or_else(|| format!("{raw:#x} is too large for 29 bits; the maximum is {max_id:#x}"));
        }
        let id = u16::try_from(raw).ok().and_then(StandardId::new).map(|id| Self(id.into()));
        id.ok_or_else(|| {
            let max_id = StandardId::MAX.as_raw();
            format!(
                "{raw:#x} is too large for 11 bits (maximum {max_id:#x}); set `extended = true` for an identifier of \
                 29 bits"
            )
        })
    }
}

/// Same format as can-utils: three or eight hexadecimal digits.
impl fmt::Display for CanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Id::Standard(id) => write!(f, "{:03X}", id.as_raw()),
            Id::Extended(id) => write!(f, "{:08X}", id.as_raw()),
        }
    }
}

pub(super) const MAX_DATA_BYTES: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CanFrame {
    /// Time of reception, s, on the clock of the receiver: monotonic, not the real-time clock of the kernel's stamp.
    pub received_s: f64,
    pub id: CanId,
    bytes: [u8; MAX_DATA_BYTES],
    data_byte_count: usize,
}

impl CanFrame {
    /// Keeps the first 8 bytes if `data` is longer than a frame.
    pub fn new(t_s: f64, id: CanId, data: &[u8]) -> Self {
        let length = data.len().min(MAX_DATA_BYTES);
        let mut bytes = [0; MAX_DATA_BYTES];
        bytes.iter_mut().zip(data).for_each(|(byte, source)| *byte = *source);
        Self { received_s: t_s, id, bytes, data_byte_count: length }
    }

    pub fn data(&self) -> &[u8] {
        self.bytes.get(..self.data_byte_count).unwrap_or_default()
    }
}
