//! What the data sheet of the simulated sensor says, as a machine file would have it.

use super::Config;
use crate::link;
use crate::sensors::SensorError;
use crate::sensors::wires::Tongue;

const TEXT: &str = r#"
[line]
end = "\r\n"
prefix = "D"
suffix = ";"
separator = ","
columns = 2
counter = { column = 2, round = 65536 }
[line.value]
column = 1
scale_mm = 1.0
codes = [
    { is = "NOECHO", means = "no-echo" },
    { is = "RANGE", means = "range" },
    { is = "SATURATED", means = "saturated" },
]
"#;

const FRAMES: &str = r#"
[frame]
sync = [0xAA, 0x55]
length = 7
order = "big"
value = { byte = 0, width = 32, signed = true, scale_mm = 0.00001 }
counter = { byte = 4, width = 16 }
status = [
    { byte = 6, bit = 0, means = "no-echo" },
    { byte = 6, bit = 1, means = "range" },
    { byte = 6, bit = 2, means = "saturated" },
]
checksum = { kind = "crc16-modbus", order = "little" }
"#;

const REQUEST: &str = "request = \"M\\n\"\n";

impl Config {
    /// The simulated sensor; `at`: on a wire where it sends by itself, otherwise inside this process,
    /// where it answers.
    ///
    /// # Errors
    /// Never: tests open each of them.
    pub(in crate::sensors) fn of_simulated(
        tongue: Tongue,
        at: Option<link::Named>,
    ) -> Result<Self, SensorError> {
        let layout = if tongue == Tongue::Text { TEXT } else { FRAMES };
        let request = if at.is_none() { REQUEST } else { "" };
        let config: Self = toml::from_str(&format!("serial = \"memory\"\n{request}{layout}"))
            .map_err(|error: toml::de::Error| SensorError::Strange {
                text: error.to_string(),
                remedy: "report it".to_owned(),
            })?;
        let memory = config.at.clone();
        Ok(Self { at: at.unwrap_or(memory), ..config })
    }
}
