//! Keys of `[sensor.can]`: the bus, the frames and their content.

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;

use crate::sensors::bit_field::Endianness;
use crate::sensors::frame_layout::{FrameCounterKeys, FrameEncoderKeys, FrameLayout, FrameStatusKeys, FrameValueKeys};
use link::Clock;
use link::can::{CanError, CanId, CanReceiver};

/// Keys of `[sensor.can]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CanKeys {
    interface: String,
    id: u32,
    /// Whether the identifier has 29 bits.
    #[serde(default)]
    extended: bool,
    /// Length of a frame, bytes: no field may extend beyond it. A received frame need only contain all fields.
    #[serde(rename = "length", default = "default_length")]
    frame_bytes: u16,
    /// Maximum time between two frames, s; a longer silence is flagged.
    #[serde(default = "default_timeout_s")]
    timeout_s: f64,
    /// Byte order of the numbers without an order of their own.
    order: Option<Endianness>,
    value: FrameValueKeys,
    counter: Option<FrameCounterKeys>,
    encoder_count: Option<FrameEncoderKeys>,
    #[serde(default)]
    status: Vec<FrameStatusKeys>,
}

const MAX_CAN_DATA_BYTES: u16 = 8;
const MAX_TIMEOUT_S: f64 = 60.0;
/// Maximum length of an interface's name in the kernel (IFNAMSIZ), characters.
const MAX_INTERFACE_NAME_LENGTH: usize = 15;

fn default_length() -> u16 {
    MAX_CAN_DATA_BYTES
}

fn default_timeout_s() -> f64 {
    0.1
}

/// Configuration of a sensor on a CAN bus that has passed the checks.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "CanKeys")]
pub struct CanConfig {
    pub(super) interface: String,
    pub(super) id: CanId,
    /// Maximum time between two frames; a longer silence is flagged.
    pub(super) silence_timeout: Duration,
    pub(super) layout: FrameLayout,
}

impl TryFrom<CanKeys> for CanConfig {
    type Error = String;

    fn try_from(keys: CanKeys) -> Result<Self, String> {
        let CanKeys { interface, frame_bytes, timeout_s, .. } = keys;
        if interface.is_empty() || interface.len() > MAX_INTERFACE_NAME_LENGTH || interface.contains('/') {
            return Err(format!("`interface` is `{interface}`; set a name from `ip link`, e.g. `can0`"));
        }
        let id = CanId::new(keys.id, keys.extended).map_err(|why| format!("`id` {why}"))?;
        if !(1..=MAX_CAN_DATA_BYTES).contains(&frame_bytes) {
            return Err(format!("`length` is {frame_bytes}; a frame has 1 to {MAX_CAN_DATA_BYTES} bytes"));
        }
        if timeout_s <= 0.0 || timeout_s > MAX_TIMEOUT_S {
            return Err(format!("`timeout_s` is {timeout_s}; permitted: above 0 to {MAX_TIMEOUT_S} s"));
        }
        let CanKeys { value, counter, encoder_count, status, order, .. } = keys;
        let layout = FrameLayout::new(value, counter, encoder_count, status, order, frame_bytes.into())?;
        Ok(Self { interface, id, silence_timeout: Duration::from_secs_f64(timeout_s), layout })
    }
}

impl CanConfig {
    /// Opens the CAN interface.
    ///
    /// # Errors
    /// The kernel has no CAN, or the interface does not exist.
    pub fn open_bus(&self, clock: Arc<dyn Clock>) -> Result<CanReceiver, CanError> {
        CanReceiver::open(&self.interface, self.id, clock)
    }
}
