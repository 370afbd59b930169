//! Keys of `[sensor.serial]`.

use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::format::DataFormat;
use super::{frame, line};
use link::{HostPort, LinkConfig, LinkKeys};

const DEFAULT_BAUD: u32 = 115_200;

/// Keys of `[sensor.serial]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SerialKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
    /// Maximum time without data, s; a longer silence is flagged.
    timeout_s: Option<f64>,
    /// Request for one sample, sent as written; if absent, the sensor sends by itself.
    request: Option<String>,
    /// Maximum rate of the requests, Hz; if absent, as fast as the sensor answers.
    rate_hz: Option<f64>,
    line: Option<line::LineKeys>,
    frame: Option<frame::FrameKeys>,
}

/// Address of a sensor on a serial line, and format of its data.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "SerialKeys")]
pub struct SerialConfig {
    pub(super) link: LinkConfig,
    /// Maximum time without data.
    pub(super) silence_timeout: Duration,
    /// Request for one sample; `None`: the sensor sends by itself.
    pub(super) sample_request: Option<Vec<u8>>,
    /// Minimum time between two requests.
    pub(super) min_request_interval: Duration,
    pub(super) format: DataFormat,
}

impl TryFrom<SerialKeys> for SerialConfig {
    type Error = String;

    fn try_from(keys: SerialKeys) -> Result<Self, String> {
        let SerialKeys { serial, serial_id, tcp, baud, .. } = keys;
        let link = LinkConfig::from_keys(LinkKeys { serial, serial_id, tcp, baud }, DEFAULT_BAUD)?;
        let silence_timeout = link::parse_timeout_s(keys.timeout_s)?;
        if keys.request.as_ref().is_some_and(String::is_empty) {
            return Err("`request` is empty; remove it for a sensor that sends without a request".to_owned());
        }
        if keys.rate_hz.is_some() && keys.request.is_none() {
            let message =
                "`rate_hz` is only for sensors with `request`; remove it for a sensor that sends without a request";
            return Err(message.to_owned());
        }
        let min_request_interval = match keys.rate_hz {
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
        let sample_request = keys.request.map(String::into_bytes);
        Ok(Self { link, silence_timeout, sample_request, min_request_interval, format })
    }
}
