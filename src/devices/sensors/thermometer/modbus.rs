//! Keys of `[thermometer.modbus]`: a temperature in an input or holding register. Only the registers of the
//! declared thermometers are read, and none is written.

use std::path::PathBuf;

use serde::Deserialize;

use super::{ThermometerError, require_plausible_temperature};
use link::HostPort;
use link::modbus::number_format::{ByteOrder, NumberFormat, NumberType};
use link::modbus::{
    AccessList, Framing, ModbusClient, ModbusDeviceConfig, ModbusDeviceKeys, ModbusError, Parity, RegisterRange,
    RegisterSpace,
};

/// Keys of `[thermometer.modbus]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModbusThermometerKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    timeout_s: Option<f64>,
    #[serde(default)]
    space: RegisterSpace,
    value: ModbusThermometerValueKeys,
}

/// Keys of the value: °C = `offset_c` + `scale_c` × the number; registers count from 0.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModbusThermometerValueKeys {
    register: u16,
    #[serde(rename = "type")]
    number_type: NumberType,
    #[serde(default)]
    order: ByteOrder,
    scale_c: f64,
    #[serde(default)]
    offset_c: f64,
}

/// Address of a thermometer behind Modbus registers, and content of the registers.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ModbusThermometerKeys")]
pub(super) struct ModbusThermometerConfig {
    pub device: ModbusDeviceConfig,
    /// Registers of the number.
    span: RegisterRange,
    /// Format of the number; its scale is in °C per count.
    number_format: NumberFormat,
    offset_c: f64,
}

impl TryFrom<ModbusThermometerKeys> for ModbusThermometerConfig {
    type Error = String;

    fn try_from(keys: ModbusThermometerKeys) -> Result<Self, String> {
        let ModbusThermometerKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s, .. } = keys;
        let device = ModbusDeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s }.try_into()?;
        if !matches!(keys.space, RegisterSpace::Input | RegisterSpace::Holding) {
            return Err("`space` must be `input` or `holding`: a bit cannot hold a temperature".to_owned());
        }
        let ModbusThermometerValueKeys { register, number_type, order, scale_c, offset_c } = keys.value;
        if scale_c == 0.0 || !scale_c.is_finite() || !offset_c.is_finite() {
            return Err(format!(
                "`value.scale_c` is {scale_c}, `value.offset_c` is {offset_c}; set `scale_c` to the °C of one \
                 count, e.g. 0.1, and `offset_c` to the °C at zero counts"
            ));
        }
        let number_format = NumberFormat { number_type, order, scale: scale_c };
        let last = register
            .checked_add(number_format.register_count() - 1)
            .ok_or_else(|| format!("`value.register` at {register} extends beyond register 65535"))?;
        let span = RegisterRange { space: keys.space, first: register, last };
        Ok(Self { device, span, number_format, offset_c })
    }
}

/// Reads the thermometers of one Modbus device. The first read opens the link, and a read reopens a link that has
/// ended.
pub(super) struct ThermometerReader {
    device: ModbusDeviceConfig,
    /// Registers of all thermometers of the device, read only.
    allowed: AccessList,
    /// Open link; `None` before the first read and after the link has ended.
    client: Option<ModbusClient>,
}

impl ThermometerReader {
    /// Creates the reader for the device that all `configs` share, without opening the link; `None` if `configs` is
    /// empty.
    pub fn for_device<'c>(mut configs: impl Iterator<Item = &'c ModbusThermometerConfig> + Clone) -> Option<Self> {
        let allowed = AccessList::read_only(configs.clone().map(|config| config.span).collect());
        let device = configs.next()?.device.clone();
        Some(Self { device, allowed, client: None })
    }

    /// Reads the temperature, °C.
    ///
    /// # Errors
    /// There is no answer, the registers hold no number, or the temperature is not plausible.
    pub async fn read_temperature_c(&mut self, config: &ModbusThermometerConfig) -> Result<f64, ThermometerError> {
        let RegisterRange { space, first, last } = config.span;
        let link = match self.client.take() {
            Some(link) => link,
            None => ModbusClient::open(self.device.line.clone(), self.device.settings(self.allowed.clone())).await?,
        };
        let words = link.read(space, first, last - first + 1).await;
        self.client = Some(link).filter(|_| !matches!(words, Err(ModbusError::LinkThreadEnded { .. })));
        require_plausible_temperature(config.offset_c + config.number_format.decode(&words?)?)
    }
}
