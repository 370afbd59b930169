//! Keys of `[sensor.can]`: the bus, the frames and their content.

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;

use crate::sensors::field::Order;
use crate::sensors::layout::{CounterKeys, EncoderCountKeys, Layout, StatusKeys, ValueKeys};
use link::Clock;
use link::can::{Can, CanError, Id};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    interface: String,
    id: u32,
    /// Whether the identifier has 29 bits.
    #[serde(default)]
    extended: bool,
    /// Length of a frame, bytes.
    #[serde(default = "most_bytes")]
    length: u16,
    /// Maximum time between two frames, s; a longer silence is flagged.
    #[serde(default = "usual_timeout")]
    timeout_s: f64,
    order: Option<Order>,
    value: ValueKeys,
    counter: Option<CounterKeys>,
    encoder_count: Option<EncoderCountKeys>,
    #[serde(default)]
    status: Vec<StatusKeys>,
}

const MOST_BYTES: u16 = 8;
const LONGEST_TIMEOUT_S: f64 = 60.0;
/// Maximum length of an interface's name in the kernel (IFNAMSIZ), characters.
const LONGEST_NAME: usize = 15;

fn most_bytes() -> u16 {
    MOST_BYTES
}

fn usual_timeout() -> f64 {
    0.1
}

#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) interface: String,
    pub(super) id: Id,
    pub(super) timeout: Duration,
    pub(super) layout: Layout,
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys { interface, length, timeout_s, .. } = keys;
        if interface.is_empty() || interface.len() > LONGEST_NAME || interface.contains('/') {
            return Err(format!(
                "`interface` is `{interface}`; it is a name as `ip link` shows it, e.g. `can0`"
            ));
        }
        let id = Id::new(keys.id, keys.extended).map_err(|why| format!("`id` {why}"))?;
        if !(1..=MOST_BYTES).contains(&length) {
            return Err(format!("`length` is {length}; a frame has 1 to {MOST_BYTES} bytes"));
        }
        if timeout_s <= 0.0 || timeout_s > LONGEST_TIMEOUT_S {
            return Err(format!("`timeout_s` must lie between 0 and {LONGEST_TIMEOUT_S}"));
        }
        let timeout = Duration::from_secs_f64(timeout_s);
        let length = usize::from(length);
        let Keys { value, counter, encoder_count, status, order, .. } = keys;
        let layout = Layout::new(value, counter, encoder_count, status, order, length)?;
        Ok(Self { interface, id, timeout, layout })
    }
}

impl Config {
    /// Opens the CAN interface.
    ///
    /// # Errors
    /// The kernel has no CAN, or the interface does not exist.
    pub fn listen(&self, clock: Arc<dyn Clock>) -> Result<Can, CanError> {
        Can::open(&self.interface, self.id, clock)
    }
}
