//! Keys of `[sensor.serial]`.

use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::form::Form;
use super::{frame, line};
use crate::sensors::Port;
use link::HostPort;

const USUAL_BAUD: u32 = 115_200;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
    #[serde(default = "timeout_s")]
    timeout_s: f64,
    /// Request for one sample; if absent, the sensor sends by itself.
    request: Option<String>,
    /// Maximum rate of the requests, Hz; if absent, as fast as the sensor answers.
    rate_hz: Option<f64>,
    line: Option<line::Keys>,
    frame: Option<frame::Keys>,
}

fn timeout_s() -> f64 {
    0.5
}

/// Address of a sensor on a serial line, and format of its data.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) at: link::Named,
    /// Maximum time without data.
    pub(super) timeout: Duration,
    pub(super) request: Option<Vec<u8>>,
    /// Time between two requests.
    pub(super) pace: Duration,
    pub(super) form: Form,
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let at = link::Named::of((keys.serial, keys.serial_id, keys.tcp), keys.baud, USUAL_BAUD)?;
        let timeout = link::timeout(keys.timeout_s)?;
        if keys.request.as_ref().is_some_and(String::is_empty) {
            return Err(
                "`request` is empty; leave it out where the sensor sends by itself".to_owned()
            );
        }
        if keys.rate_hz.is_some() && keys.request.is_none() {
            return Err(
                "`rate_hz` belongs to `request`: a sensor that sends by itself has its own rate"
                    .to_owned(),
            );
        }
        let pace = match keys.rate_hz {
            Some(hz) if (0.001..=1e5).contains(&hz) => Duration::from_secs_f64(1.0 / hz),
            Some(hz) => return Err(format!("`rate_hz` is {hz}; it lies between 0.001 and 100000")),
            None => Duration::ZERO,
        };
        let form = match (keys.line, keys.frame) {
            (Some(line), None) => Form::Line(line.try_into()?),
            (None, Some(frame)) => Form::Frame(frame.try_into()?),
            _ => {
                return Err("needs exactly one of [sensor.serial.line] (text) and \
                            [sensor.serial.frame] (bytes): what the sensor says"
                    .to_owned());
            }
        };
        let request = keys.request.map(String::into_bytes);
        Ok(Self { at, timeout, request, pace, form })
    }
}

impl Config {
    /// Returns the port with the keys that must be equal for all sensors on it. A sensor that answers
    /// requests reads only its own replies, so its format may differ.
    pub(super) fn shared_port(&self) -> Port {
        let seconds = self.timeout.as_secs_f64();
        let request = if self.request.is_some() { "set" } else { "not set" };
        let mut keys = vec![
            ("its table", "[sensor.serial]".to_owned()),
            ("`baud`", self.at.baud().map_or("none".to_owned(), |baud| baud.to_string())),
            ("`timeout_s`", seconds.to_string()),
            ("`request`", request.to_owned()),
        ];
        if self.request.is_none() {
            keys.extend(self.form.framing());
        }
        Port { name: self.at.to_string(), keys }
    }
}
