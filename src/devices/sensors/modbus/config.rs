//! Keys of `[sensor.modbus]`.

use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::register_map::{
    RegisterCounterKeys, RegisterEncoderKeys, RegisterStatusKeys, RegisterValueKeys, SensorRegisterMap,
};
use link::HostPort;
use link::modbus::{AccessList, DeviceSettings, Framing, ModbusDeviceConfig, ModbusDeviceKeys, Parity, RegisterSpace};

/// Keys of `[sensor.modbus]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModbusSensorKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    /// Maximum time until a reply, and until a new sample, s. After this time the sample is flagged as stale.
    timeout_s: Option<f64>,
    /// Maximum rate of the reads, Hz.
    #[serde(default = "default_rate_hz")]
    rate_hz: f64,
    #[serde(default)]
    space: RegisterSpace,
    value: RegisterValueKeys,
    counter: Option<RegisterCounterKeys>,
    encoder_count: Option<RegisterEncoderKeys>,
    #[serde(default)]
    status: Vec<RegisterStatusKeys>,
}

fn default_rate_hz() -> f64 {
    50.0
}

/// Address of a sensor behind Modbus registers, and content of the registers.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ModbusSensorKeys")]
pub struct ModbusSensorConfig {
    pub(super) device: ModbusDeviceConfig,
    /// Minimum time between the starts of two reads.
    pub(super) min_read_interval: Duration,
    pub(super) register_map: SensorRegisterMap,
}

impl TryFrom<ModbusSensorKeys> for ModbusSensorConfig {
    type Error = String;

    fn try_from(keys: ModbusSensorKeys) -> Result<Self, String> {
        let ModbusSensorKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s, .. } = keys;
        let device = ModbusDeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s }.try_into()?;
        if !(0.001..=1e4).contains(&keys.rate_hz) {
            return Err(format!("`rate_hz` is {}; permitted: 0.001 to 10000", keys.rate_hz));
        }
        if !matches!(keys.space, RegisterSpace::Input | RegisterSpace::Holding) {
            return Err("`space` must be `input` or `holding`: a bit cannot hold a distance".to_owned());
        }
        let min_read_interval = Duration::from_secs_f64(1.0 / keys.rate_hz);
        let ModbusSensorKeys { space, value, counter, encoder_count, status, .. } = keys;
        let register_map = SensorRegisterMap::new(space, value, counter, encoder_count, status)?;
        Ok(Self { device, min_read_interval, register_map })
    }
}

impl ModbusSensorConfig {
    /// Settings of the device: the link may read the registers of the map only, and write none.
    pub(super) fn device_settings(&self) -> DeviceSettings {
        self.device.settings(AccessList::read_only(vec![self.register_map.span]))
    }
}
