//! Thermometers whose temperatures each reading carries. They are polled in parallel with the run, which
//! never waits for them; a thermometer that is disconnected or reports an impossible value gives no value,
//! and never its last one.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Deserialize;

mod error;
mod modbus;
#[cfg(test)]
mod tests;
mod watch;

pub use error::ThermometerError;
pub use watch::Watch;

use modbus::Bus;

/// A thermometer, from `[[thermometer]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Entry {
    pub name: String,
    /// Time for which the last value is valid.
    stale: Duration,
    reached: Reached,
}

#[derive(Debug, Clone)]
enum Reached {
    /// The thermometer measures the simulated machine, which `[simulated]` describes.
    Simulated,
    Modbus(modbus::Config),
}

/// Returns the present temperature of a simulated thermometer, °C.
pub type SimulatedTemperature = Box<dyn Fn() -> Option<f64> + Send + Sync>;

/// Keys of a thermometer: a new kind of connection is a table here and a line in [`Keys::reached`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    name: String,
    #[serde(default = "usual_stale_s")]
    stale_s: f64,
    modbus: Option<modbus::Config>,
    simulated: Option<Simulated>,
}

/// Keys of `[thermometer.simulated]`: `[[simulated.thermometer]]` describes what it measures.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Simulated {}

fn usual_stale_s() -> f64 {
    30.0
}

/// Plausible temperatures in a machine shop, °C. Broken sensors show the ends of their range: -200, 850,
/// 3276.7.
const SENSIBLE_C: std::ops::RangeInclusive<f64> = -40.0..=80.0;
/// Maximum length of a name, which appears in table headings and beside curves.
const LONGEST_NAME: usize = 24;

impl Keys {
    /// # Errors
    /// None of the tables is given, or several are.
    fn reached(&mut self) -> Result<Reached, String> {
        let modbus = self.modbus.take().map(Reached::Modbus);
        let simulated = self.simulated.take().map(|_| Reached::Simulated);
        match (modbus, simulated) {
            (Some(one), None) | (None, Some(one)) => Ok(one),
            _ => Err(format!(
                "`{}` needs exactly one of [thermometer.modbus] and [thermometer.simulated]: how it is \
                 reached",
                self.name
            )),
        }
    }
}

impl TryFrom<Keys> for Entry {
    type Error = String;

    fn try_from(mut keys: Keys) -> Result<Self, String> {
        let fits = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
        let short = (1..=LONGEST_NAME).contains(&keys.name.len());
        if !short || !keys.name.chars().all(fits) {
            return Err(format!(
                "`name` is `{}`; it has 1 to {LONGEST_NAME} letters, digits and hyphens, e.g. \"spindle\"",
                keys.name
            ));
        }
        if !(0.5..=3600.0).contains(&keys.stale_s) {
            return Err(format!("`stale_s` is {}; it lies between 0.5 and 3600", keys.stale_s));
        }
        let reached = keys.reached()?;
        Ok(Self { name: keys.name, stale: Duration::from_secs_f64(keys.stale_s), reached })
    }
}

impl Entry {
    /// Address of the thermometer, in words.
    pub fn at(&self) -> String {
        match &self.reached {
            Reached::Simulated => "simulated".to_owned(),
            Reached::Modbus(config) => config.at(),
        }
    }
}

/// Reads each of `entries` once, °C; `feel` returns the source of a simulated thermometer by its name. Call
/// inside a tokio runtime.
pub async fn once(
    entries: &[Entry],
    feel: impl Fn(&str) -> Option<SimulatedTemperature>,
) -> Vec<(&Entry, Result<f64, ThermometerError>)> {
    let simulated = entries.iter().filter(|entry| matches!(entry.reached, Reached::Simulated));
    let mut said: Vec<_> =
        simulated.map(|entry| (entry, felt(feel(&entry.name).as_ref()))).collect();
    for of_device in by_device(entries).into_values() {
        let mut bus = Bus::of(of_device.iter().map(|(_, config)| *config));
        for (entry, config) in of_device {
            said.push((entry, bus.read(config).await));
        }
    }
    said
}

/// Groups thermometers by device. Those of one device share its link: a serial port is opened once.
fn by_device(entries: &[Entry]) -> BTreeMap<String, Vec<(&Entry, &modbus::Config)>> {
    let mut devices: BTreeMap<String, Vec<_>> = BTreeMap::new();
    for entry in entries {
        if let Reached::Modbus(config) = &entry.reached {
            devices.entry(config.at()).or_default().push((entry, config));
        }
    }
    devices
}

fn felt(feel: Option<&SimulatedTemperature>) -> Result<f64, ThermometerError> {
    sensible(feel.and_then(|feel| feel()).ok_or(ThermometerError::NothingToFeel)?)
}

fn sensible(celsius: f64) -> Result<f64, ThermometerError> {
    match SENSIBLE_C.contains(&celsius) {
        true => Ok(celsius),
        false => Err(ThermometerError::Nonsense { celsius }),
    }
}
