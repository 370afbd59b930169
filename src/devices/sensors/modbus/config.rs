//! Keys of `[sensor.modbus]`.

use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::map::{CounterKeys, EncoderCountKeys, Map, StatusKeys, ValueKeys};
use crate::sensors::Port;
use link::HostPort;
use link::modbus::{Allowed, Device, DeviceKeys, Framing, Parity, Settings, Space};

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
    /// Maximum rate of the reads, Hz.
    #[serde(default = "rate_hz")]
    rate_hz: f64,
    #[serde(default = "input")]
    space: Space,
    value: ValueKeys,
    counter: Option<CounterKeys>,
    encoder_count: Option<EncoderCountKeys>,
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

/// Address of a sensor behind Modbus registers, and content of the registers.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) device: Device,
    /// Time between two reads.
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
        let Keys { space, value, counter, encoder_count, status, .. } = keys;
        let map = Map::new(space, value, counter, encoder_count, status)?;
        Ok(Self { device, pace, map })
    }
}

impl Config {
    /// Limits of the link: it may read these registers only, and write none.
    pub(super) fn settings(&self) -> Settings {
        let allowed = Allowed { read: vec![self.map.span], write: Vec::new() };
        Settings { unit: self.device.unit, timeout: self.device.timeout, allowed }
    }

    /// Returns an RTU line, which units may share; over Modbus TCP each sensor has its own connection.
    pub(super) fn shared_port(&self) -> Option<Port> {
        let Device { line, .. } = &self.device;
        let parity = format!("{:?}", line.parity).to_lowercase();
        let keys = vec![
            ("its table", "[sensor.modbus]".to_owned()),
            ("`baud`", line.at.baud().map_or("none".to_owned(), |baud| baud.to_string())),
            ("`parity`", parity),
        ];
        (line.framing == Framing::Rtu).then(|| Port { name: line.to_string(), keys })
    }
}
