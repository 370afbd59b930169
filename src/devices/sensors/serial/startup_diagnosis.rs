//! Diagnosis of a serial sensor whose data cannot be decoded: records the first data and describes the reason.

use super::format::DataFormat;
use crate::sensors::SensorError;

/// Data received since `prepare`, while the rate is measured.
#[derive(Debug, Default)]
pub(super) struct StartupData {
    /// Number of bytes of decoded lines or frames, line ends included.
    pub valid_byte_count: usize,
    /// Number of bytes that could not be decoded.
    pub invalid_byte_count: usize,
    /// The first bytes that could not be decoded.
    first_invalid_bytes: Vec<u8>,
    /// Number of all received bytes, in whole pieces or not.
    pub received_byte_count: usize,
    first_received_bytes: Vec<u8>,
}

/// Maximum number of bytes that are kept as an example for the message.
const MAX_EXAMPLE_BYTES: usize = 60;

impl StartupData {
    pub fn record_received(&mut self, bytes: &[u8]) {
        self.received_byte_count += bytes.len();
        append_limited(&mut self.first_received_bytes, bytes);
    }

    pub fn record_invalid(&mut self, bytes: &[u8]) {
        self.invalid_byte_count += bytes.len();
        append_limited(&mut self.first_invalid_bytes, bytes);
    }

    /// Whether more bytes are invalid than valid.
    pub fn is_mostly_invalid(&self) -> bool {
        self.invalid_byte_count > self.valid_byte_count
    }

    /// Error with an example of the data and the likely reason; `baud` is `None` behind a network converter.
    pub fn diagnose(&self, format: &DataFormat, baud: Option<u32>) -> SensorError {
        let example =
            if self.first_invalid_bytes.is_empty() { &self.first_received_bytes } else { &self.first_invalid_bytes };
        let readable = |byte: &u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
        let unreadable = example.iter().filter(|byte| !readable(byte)).count();
        let is_noisy = 8 * unreadable > example.len();
        let example = example.escape_ascii();
        let (text, remedy) = match format {
            DataFormat::Line(_) if is_noisy => {
                (format!("mostly noise instead of lines of text: `{example}`"), baud_remedy(baud))
            }
            DataFormat::Line(_) if self.invalid_byte_count == 0 => (
                format!("{} bytes without a line end: `{example}`", self.received_byte_count),
                format!(
                    "compare `end` of [sensor.serial.line] with the sensor's manual; if the bytes are not \
                     text of the sensor, {}",
                    baud_remedy(baud)
                ),
            ),
            DataFormat::Line(_) => (
                format!("the received lines do not match the layout: `{example}`"),
                "compare [sensor.serial.line] with this line: prefix, suffix, separator, columns, and \
                 a number in the column of the value"
                    .to_owned(),
            ),
            DataFormat::Frame(_) => (
                format!("no valid frame in the received bytes: `{example}`"),
                format!(
                    "compare [sensor.serial.frame] with the sensor's manual: sync, length, checksum; \
                     then {}",
                    baud_remedy(baud)
                ),
            ),
        };
        SensorError::InvalidData { text, remedy }
    }
}

fn append_limited(example: &mut Vec<u8>, bytes: &[u8]) {
    let room = MAX_EXAMPLE_BYTES.saturating_sub(example.len());
    example.extend(bytes.iter().take(room));
}

fn baud_remedy(baud: Option<u32>) -> String {
    match baud {
        Some(baud) => {
            format!("set `baud` to the sensor's baud rate (the sensor probably uses another baud rate than {baud})")
        }
        None => "set the converter to the sensor's baud rate (the converter probably uses another baud rate \
                 than the sensor)"
            .to_owned(),
    }
}
