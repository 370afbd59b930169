//! Keys of `[thermometer.modbus]`: a temperature in an input or holding register. Only the registers of the
//! declared thermometers are read, and none is written.

use std::path::PathBuf;

use serde::Deserialize;

use super::{ThermometerError, sensible};
use link::HostPort;
use link::modbus::value::{Kind, Number, Order};
use link::modbus::{
    Allowed, Device, DeviceKeys, Framing, Modbus, ModbusError, Parity, Range, Settings, Space,
};

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
    #[serde(default = "input")]
    space: Space,
    value: ValueKeys,
}

/// Keys of the value: °C = `offset_c` + `scale_c` × the number; registers count from 0.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ValueKeys {
    register: u16,
    #[serde(rename = "type")]
    kind: Kind,
    #[serde(default)]
    order: Order,
    scale_c: f64,
    #[serde(default)]
    offset_c: f64,
}

fn timeout_s() -> f64 {
    0.5
}

fn input() -> Space {
    Space::Input
}

/// Address of a thermometer behind Modbus registers, and content of the registers.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub(super) struct Config {
    device: Device,
    span: Range,
    /// Format of the number, with its scale.
    number: Number,
    offset_c: f64,
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s, .. } = keys;
        let device = DeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s };
        let device = Device::try_from(device)?;
        if !matches!(keys.space, Space::Input | Space::Holding) {
            return Err("`space` is `input` or `holding`: a bit holds no temperature".to_owned());
        }
        let ValueKeys { register, kind, order, scale_c, offset_c } = keys.value;
        if scale_c == 0.0 || !scale_c.is_finite() || !offset_c.is_finite() {
            return Err(format!(
                "`value.scale_c` is {scale_c}, `value.offset_c` {offset_c}: the first is the °C of one \
                 count, e.g. 0.1, the second what zero counts are"
            ));
        }
        let number = Number { kind, order, scale: scale_c };
        let last = register.checked_add(number.registers() - 1).ok_or_else(|| {
            format!("`value.register` at {register} reaches beyond register 65535")
        })?;
        let span = Range { space: keys.space, first: register, last };
        Ok(Self { device, span, number, offset_c })
    }
}

impl Config {
    pub fn at(&self) -> String {
        self.device.in_full()
    }
}

/// Link to a device. The first read opens it, and reopens it after it has ended.
pub(super) struct Bus {
    device: Option<Device>,
    allowed: Allowed,
    link: Option<Modbus>,
}

impl Bus {
    /// Creates the link to the device that all `configs` share.
    pub fn of<'c>(mut configs: impl Iterator<Item = &'c Config> + Clone) -> Self {
        let read = configs.clone().map(|config| config.span).collect();
        let device = configs.next().map(|config| config.device.clone());
        Self { device, allowed: Allowed { read, write: Vec::new() }, link: None }
    }

    /// Reads the temperature, °C.
    ///
    /// # Errors
    /// There is no answer, no number, or an impossible temperature.
    pub async fn read(&mut self, config: &Config) -> Result<f64, ThermometerError> {
        let Range { space, first, last } = config.span;
        let said = self.link().await?.read(space, first, last - first + 1).await;
        if matches!(said, Err(ModbusError::Ended { .. })) {
            self.link = None;
        }
        sensible(config.offset_c + config.number.read(&said?)?)
    }

    async fn link(&mut self) -> Result<&Modbus, ThermometerError> {
        if self.link.is_none()
            && let Some(Device { line, unit, timeout }) = self.device.clone()
        {
            let settings = Settings { unit, timeout, allowed: self.allowed.clone() };
            self.link = Some(Modbus::open(line, settings).await?);
        }
        let ended = || ModbusError::Ended { link: "no device".to_owned() };
        Ok(self.link.as_ref().ok_or_else(ended)?)
    }
}
