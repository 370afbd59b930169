//! `[sensor.can]`: which frames on which bus, and what they hold.

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
    /// The identifier has 29 bits.
    #[serde(default)]
    extended: bool,
    /// Bytes of a frame.
    #[serde(default = "most_bytes")]
    length: u16,
    /// Silence beyond it is flagged.
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
/// A name that the kernel takes (IFNAMSIZ).
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
    /// Open its interface.
    ///
    /// # Errors
    /// A kernel without CAN, no such interface.
    pub fn listen(&self, clock: Arc<dyn Clock>) -> Result<Can, CanError> {
        Can::open(&self.interface, self.id, clock)
    }
}
