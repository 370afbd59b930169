//! Reasons why no data can be decoded, in words.

use super::form::Form;
use crate::sensors::SensorError;

/// Data received during the first observation of the sensor.
#[derive(Debug, Default)]
pub(super) struct Heard {
    pub good_bytes: usize,
    pub spoilt_bytes: usize,
    /// The first bytes that could not be decoded.
    example: Vec<u8>,
    /// Number of all bytes, in whole pieces or not; `first` are the first of them.
    pub bytes: usize,
    first: Vec<u8>,
}

const SHOWN: usize = 60;

impl Heard {
    pub fn came(&mut self, bytes: &[u8]) {
        self.bytes += bytes.len();
        append(&mut self.first, bytes);
    }

    pub fn spoilt(&mut self, bytes: &[u8]) {
        self.spoilt_bytes += bytes.len();
        append(&mut self.example, bytes);
    }

    /// Whether more bytes are invalid than valid.
    pub fn is_noise(&self) -> bool {
        self.spoilt_bytes > self.good_bytes
    }

    pub fn suspect(&self, form: &Form, baud: Option<u32>) -> SensorError {
        let example = if self.example.is_empty() { &self.first } else { &self.example };
        let readable = |byte: &u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
        let unreadable = example.iter().filter(|byte| !readable(byte)).count();
        let noise = 8 * unreadable > example.len();
        let example = example.escape_ascii();
        let (text, remedy) = match form {
            Form::Line(_) if noise => (
                format!("mostly noise comes where lines should: `{example}`"),
                wrong_speed(baud),
            ),
            Form::Line(_) if self.spoilt_bytes == 0 => (
                format!("{} bytes came and no line's end: `{example}`", self.bytes),
                format!(
                    "compare `end` of [sensor.serial.line] with the sensor's manual; if that is nothing \
                     it would say, {}",
                    wrong_speed(baud)
                ),
            ),
            Form::Line(_) => (
                format!("lines come as `{example}`"),
                "compare [sensor.serial.line] with such a line: prefix, suffix, separator, columns, and \
                 a number where the value is"
                    .to_owned(),
            ),
            Form::Frame(_) => (
                format!("no frames in `{example}`"),
                format!(
                    "compare [sensor.serial.frame] with the sensor's manual: sync, length, checksum; \
                     and {}",
                    wrong_speed(baud)
                ),
            ),
        };
        SensorError::UnexpectedDevice { text, remedy }
    }
}

fn append(shown: &mut Vec<u8>, bytes: &[u8]) {
    let room = SHOWN.saturating_sub(shown.len());
    shown.extend(bytes.iter().take(room));
}

fn wrong_speed(baud: Option<u32>) -> String {
    match baud {
        Some(baud) => format!(
            "the sensor probably speaks at another bit rate than {baud}: set `baud` to its own"
        ),
        None => "the converter probably has another bit rate than the sensor: set it to the \
                 sensor's own"
            .to_owned(),
    }
}
