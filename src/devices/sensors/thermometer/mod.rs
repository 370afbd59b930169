//! Thermometers whose temperatures are stored with each reading. They are polled in parallel with the run, which never
//! waits for them. If a thermometer is disconnected or reports an implausible value, its last value expires.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Deserialize;

mod error;
mod modbus;
mod poller;
#[cfg(test)]
mod tests;

pub use error::ThermometerError;
pub use poller::ThermometerPoller;

use modbus::ThermometerReader;

/// A thermometer, from `[[thermometer]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ThermometerKeys")]
pub struct ThermometerConfig {
    pub name: String,
    /// Age up to which the last value is valid.
    max_age: Duration,
    source: ThermometerSource,
}

#[derive(Debug, Clone)]
enum ThermometerSource {
    /// The thermometer measures the simulated machine, which `[simulated]` describes.
    Simulated,
    Modbus(modbus::ModbusThermometerConfig),
}

/// Function that returns the present temperature of a simulated thermometer, °C; `None`: there is no such thermometer.
pub type SimulatedTemperatureSource = Box<dyn Fn() -> Option<f64> + Send + Sync>;

/// Keys of a thermometer: a new kind of connection is a table here and a line in [`ThermometerConfig::try_from`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ThermometerKeys {
    name: String,
    /// Age, s, above which the last value is no longer valid.
    #[serde(default = "default_stale_s")]
    stale_s: f64,
    modbus: Option<modbus::ModbusThermometerConfig>,
    simulated: Option<SimulatedThermometerKeys>,
}

/// Keys of `[thermometer.simulated]`: `[[simulated.thermometer]]` describes what it measures.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SimulatedThermometerKeys {}

fn default_stale_s() -> f64 {
    30.0
}

/// Plausible temperatures in a machine shop, °C. Broken sensors show the ends of their range: -200, 850,
/// 3276.7.
const PLAUSIBLE_RANGE_C: std::ops::RangeInclusive<f64> = -40.0..=80.0;
/// Maximum length of a name, which appears in table headings and beside curves.
const MAX_NAME_LENGTH: usize = 24;

impl TryFrom<ThermometerKeys> for ThermometerConfig {
    type Error = String;

    fn try_from(keys: ThermometerKeys) -> Result<Self, String> {
        let is_permitted = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
        let is_short = (1..=MAX_NAME_LENGTH).contains(&keys.name.len());
        if !is_short || !keys.name.chars().all(is_permitted) {
            return Err(format!(
                "`name` is `{}`; permitted: 1 to {MAX_NAME_LENGTH} letters, digits and hyphens, e.g. \"spindle\"",
                keys.name
            ));
        }
        if !(0.5..=3600.0).contains(&keys.stale_s) {
            return Err(format!("`stale_s` is {}; permitted: 0.5 to 3600 s", keys.stale_s));
        }
        let source = match (keys.modbus, keys.simulated) {
            (Some(config), None) => ThermometerSource::Modbus(config),
            (None, Some(SimulatedThermometerKeys {})) => ThermometerSource::Simulated,
            _ => {
                let name = keys.name;
                return Err(format!("`{name}` needs exactly one of [thermometer.modbus] and [thermometer.simulated]"));
            }
        };
        Ok(Self { name: keys.name, max_age: Duration::from_secs_f64(keys.stale_s), source })
    }
}

impl ThermometerConfig {
    /// Describes the address of the thermometer for the operator.
    pub fn describe_address(&self) -> String {
        match &self.source {
            ThermometerSource::Simulated => "simulated".to_owned(),
            ThermometerSource::Modbus(config) => config.device.describe(),
        }
    }
}

/// Reads each of `entries` once, °C: first the simulated ones, then device by device, so that the order differs from
/// that of `entries`. `simulated` returns the source of a simulated thermometer by its name. Call inside a tokio
/// runtime.
pub async fn read_thermometers_once(
    entries: &[ThermometerConfig],
    simulated: impl Fn(&str) -> Option<SimulatedTemperatureSource>,
) -> Vec<(&ThermometerConfig, Result<f64, ThermometerError>)> {
    let entries_simulated = entries.iter().filter(|entry| matches!(entry.source, ThermometerSource::Simulated));
    let mut results: Vec<_> =
        entries_simulated.map(|entry| (entry, read_simulated(simulated(&entry.name).as_ref()))).collect();
    for channels in group_by_device(entries).into_values() {
        let reader = ThermometerReader::for_device(channels.iter().map(|(_, config)| *config));
        let Some(mut reader) = reader else { continue };
        for (entry, config) in channels {
            results.push((entry, reader.read_temperature_c(config).await));
        }
    }
    results
}

/// Groups thermometers, except simulated ones, by the description of their Modbus device (address and unit). Those of
/// one device share its link: a serial port is opened once.
fn group_by_device(
    entries: &[ThermometerConfig],
) -> BTreeMap<String, Vec<(&ThermometerConfig, &modbus::ModbusThermometerConfig)>> {
    let mut devices: BTreeMap<String, Vec<_>> = BTreeMap::new();
    for entry in entries {
        if let ThermometerSource::Modbus(config) = &entry.source {
            devices.entry(config.device.describe()).or_default().push((entry, config));
        }
    }
    devices
}

fn read_simulated(simulated: Option<&SimulatedTemperatureSource>) -> Result<f64, ThermometerError> {
    require_plausible_temperature(
        simulated.and_then(|temperature_c| temperature_c()).ok_or(ThermometerError::NoSimulatedMachine)?,
    )
}

fn require_plausible_temperature(celsius: f64) -> Result<f64, ThermometerError> {
    match PLAUSIBLE_RANGE_C.contains(&celsius) {
        true => Ok(celsius),
        false => Err(ThermometerError::ImplausibleValue { celsius }),
    }
}
