//! Keys of `[sensor.serial]`.

use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::format::DataFormat;
use super::{frame, line};
use crate::sensors::SharedPort;
use link::HostPort;

const DEFAULT_BAUD: u32 = 115_200;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SerialKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
    #[serde(default = "default_timeout_s")]
    timeout_s: f64,
    /// Request for one sample; if absent, the sensor sends by itself.
    request: Option<String>,
    /// Maximum rate of the requests, Hz; if absent, as fast as the sensor answers.
    rate_hz: Option<f64>,
    line: Option<line::LineKeys>,
    frame: Option<frame::FrameKeys>,
}

fn default_timeout_s() -> f64 {
    0.5
}

/// Address of a sensor on a serial line, and format of its data.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "SerialKeys")]
pub struct SerialConfig {
    pub(super) link: link::LinkConfig,
    /// Maximum time without data.
    pub(super) timeout: Duration,
    pub(super) request: Option<Vec<u8>>,
    /// Time between two requests.
    pub(super) request_interval: Duration,
    pub(super) format: DataFormat,
}

impl TryFrom<SerialKeys> for SerialConfig {
    type Error = String;

    fn try_from(keys: SerialKeys) -> Result<Self, String> {
        let link = link::LinkConfig::from_keys((keys.serial, keys.serial_id, keys.tcp), keys.baud, DEFAULT_BAUD)?;
        let timeout = link::parse_timeout_s(keys.timeout_s)?;
        if keys.request.as_ref().is_some_and(String::is_empty) {
            return Err("`request` is empty; remove it for a sensor that sends without a request".to_owned());
        }
        if keys.rate_hz.is_some() && keys.request.is_none() {
            return Err(
                "`rate_hz` is only for sensors with `request`; remove it for a sensor that sends without a request"
                    .to_owned(),
            );
        }
        let request_interval = match keys.rate_hz {
            Some(hz) if (0.001..=1e5).contains(&hz) => Duration::from_secs_f64(1.0 / hz),
            Some(hz) => return Err(format!("`rate_hz` is {hz}; permitted: 0.001 to 100000")),
            None => Duration::ZERO,
        };
        let format = match (keys.line, keys.frame) {
            (Some(line), None) => DataFormat::Line(line.try_into()?),
            (None, Some(frame)) => DataFormat::Frame(frame.try_into()?),
            _ => {
                return Err("needs exactly one of [sensor.serial.line] (lines of text) and \
                            [sensor.serial.frame] (frames of bytes)"
                    .to_owned());
            }
        };
        let request = keys.request.map(String::into_bytes);
        Ok(Self { link, timeout, request, request_interval, format })
    }
}

impl SerialConfig {
    /// Returns the port with the keys that must be equal for all sensors on it. A sensor that answers
    /// requests reads only its own replies, so its format may differ.
    pub(super) fn shared_port(&self) -> SharedPort {
        let seconds = self.timeout.as_secs_f64();
        let request = if self.request.is_some() { "set" } else { "not set" };
        let mut keys = vec![
            ("its table", "[sensor.serial]".to_owned()),
            ("`baud`", self.link.baud().map_or("none".to_owned(), |baud| baud.to_string())),
            ("`timeout_s`", seconds.to_string()),
            ("`request`", request.to_owned()),
        ];
        if self.request.is_none() {
            keys.extend(self.format.framing_keys());
        }
        SharedPort { name: self.link.to_string(), keys }
    }
}
