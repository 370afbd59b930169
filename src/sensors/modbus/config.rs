//! `[sensor.modbus]`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;

use super::Registers;
use super::map::{CounterKeys, Map, StatusKeys, ValueKeys};
use crate::base::Clock;
use crate::link::modbus::{Allowed, Device, DeviceKeys, Framing, Parity, Settings, Space};
use crate::link::{self, HostPort};
use crate::record::sensor;
use crate::sensors::{Named, Opening, Sensor, SensorError};

/// What the data sheet of the simulated sensor says.
const SHEET: &str = r#"
counter = { register = 1, type = "u16" }
value = { register = 2, type = "i32", order = "cdab", scale_mm = 0.00001 }
status = [
    { register = 0, bit = 0, means = "no-echo" },
    { register = 0, bit = 1, means = "range" },
    { register = 0, bit = 2, means = "saturated" },
]
"#;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    #[serde(default = "timeout_s")]
    timeout_s: f64,
    /// At most so often it is read.
    #[serde(default = "rate_hz")]
    rate_hz: f64,
    #[serde(default = "input")]
    space: Space,
    value: ValueKeys,
    counter: Option<CounterKeys>,
    #[serde(default)]
    status: Vec<StatusKeys>,
}

fn timeout_s() -> f64 {
    0.5
}

fn rate_hz() -> f64 {
    50.0
}

fn input() -> Space {
    Space::Input
}

/// How a sensor behind registers is reached and understood.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) device: Device,
    /// Between two reads.
    pub(super) pace: Duration,
    pub(super) map: Map,
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s, .. } = keys;
        let device = DeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s };
        let device = Device::try_from(device)?;
        if !(0.001..=1e4).contains(&keys.rate_hz) {
            return Err(format!("`rate_hz` is {}; it lies between 0.001 and 10000", keys.rate_hz));
        }
        if !matches!(keys.space, Space::Input | Space::Holding) {
            return Err("`space` is `input` or `holding`: a bit holds no distance".to_owned());
        }
        let pace = Duration::from_secs_f64(1.0 / keys.rate_hz);
        let map = Map::new(keys.space, keys.value, keys.counter, keys.status)?;
        Ok(Self { device, pace, map })
    }
}

impl Config {
    /// The simulated sensor, which is served at `at`.
    ///
    /// # Errors
    /// Never: tests open it.
    pub(in crate::sensors) fn of_simulated(
        at: link::Named,
        rate_hz: f64,
    ) -> Result<Self, SensorError> {
        let served = match &at {
            link::Named::Tcp(_) => format!("tcp = \"{at}\""),
            link::Named::Serial { baud, .. } | link::Named::SerialId { baud, .. } => {
                format!("serial = \"{at}\"\nbaud = {baud}\nparity = \"none\"")
            }
        };
        let told = |error: toml::de::Error| SensorError::Strange {
            text: error.to_string(),
            remedy: "report it".to_owned(),
        };
        toml::from_str(&format!("{served}\nrate_hz = {rate_hz}\n{SHEET}")).map_err(told)
    }

    /// What the link is held to: these registers, and no writing.
    pub(super) fn settings(&self) -> Settings {
        let allowed = Allowed { read: vec![self.map.span], write: Vec::new() };
        Settings { unit: self.device.unit, timeout: self.device.timeout, allowed }
    }
}

impl Named for Config {
    fn at(&self) -> String {
        self.device.in_full()
    }

    fn open<'a>(&'a self, sensor: &'a sensor::Sensor, clock: Arc<dyn Clock>) -> Opening<'a> {
        Box::pin(async move {
            let driver = Registers::open(self.clone(), sensor, clock, None).await?;
            Ok(Sensor::spawn(sensor.name.as_str(), driver))
        })
    }
}
