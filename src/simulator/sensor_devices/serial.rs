//! A simulated sensor on a serial line. It builds its output by its own code, independent of the driver's
//! layouts.
//!
//! Text: `D+1.23450,17;` and a line end, or a word instead of the number. Frames: AA 55, the distance in 10 nm
//! (32 bit, two's complement), the counter (16 bit), a status byte, all most significant byte first; then
//! CRC-16/MODBUS of the bytes after AA 55, low byte first.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::{MissedTickBehavior, interval};

use super::distance_mm_and_status_bits;
use super::serve::{SampleSource, ServedSensor, serve_pty, serve_tcp};
use crate::SensorOutput;
use crate::crc16::crc16_modbus;
use link::{ByteStreamHandle, LinkError};

/// Buffer of the in-process wire.
const WIRE_BUFFER_BYTES: usize = 4096;
/// Counts per mm: one count is 10 nm.
const COUNTS_PER_MM: f64 = 1e5;

/// Data sheet of the text lines, as keys of `[sensor.serial]`.
const TEXT_DATA_SHEET_TOML: &str = r#"
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

/// Data sheet of the binary frames, as keys of `[sensor.serial]`.
const FRAME_DATA_SHEET_TOML: &str = r#"
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

/// Output format of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputFormat {
    TextLines,
    BinaryFrames,
}

/// The data sheet of `format`, as keys of `[sensor.serial]`.
pub fn data_sheet_toml(format: OutputFormat) -> &'static str {
    match format {
        OutputFormat::TextLines => TEXT_DATA_SHEET_TOML,
        OutputFormat::BinaryFrames => FRAME_DATA_SHEET_TOML,
    }
}

/// Request that makes [`serve_on_demand`] send a sample, as a key of `[sensor.serial]`.
pub const REQUEST_KEY_TOML: &str = "request = \"M\\n\"\n";

/// A sensor inside this process that sends one sample for each line end it receives. Call inside a tokio
/// runtime.
pub fn serve_on_demand(format: OutputFormat, next_sample: SampleSource) -> ByteStreamHandle {
    let (near, far) = tokio::io::duplex(WIRE_BUFFER_BYTES);
    tokio::spawn(SimulatedSerialSensor { format, sample_counter: 0, next_sample }.serve_requests(far));
    ByteStreamHandle::from_stream("the simulated sensor", near)
}

/// Serves a sensor on a pseudo-terminal; it sends `rate_hz` samples per second until its client disconnects.
///
/// # Errors
/// The pseudo-terminal cannot be created.
pub fn send_on_pty(format: OutputFormat, next_sample: SampleSource, rate_hz: f64) -> Result<ServedSensor, LinkError> {
    let mut sensor = SimulatedSerialSensor { format, sample_counter: 0, next_sample };
    serve_pty(move |device| async move { drop(sensor.send_samples_at_rate(device, rate_hz).await) })
}

/// Serves a sensor on a TCP port; it sends `rate_hz` samples per second to one client after the other.
///
/// # Errors
/// The port cannot be opened.
pub fn send_on_tcp(format: OutputFormat, next_sample: SampleSource, rate_hz: f64) -> Result<ServedSensor, LinkError> {
    let mut sensor = SimulatedSerialSensor { format, sample_counter: 0, next_sample };
    serve_tcp(move |listener| async move {
        while let Ok((stream, _)) = listener.accept().await {
            drop(sensor.send_samples_at_rate(stream, rate_hz).await);
        }
    })
}

/// A sensor that sends text lines or binary frames.
struct SimulatedSerialSensor {
    format: OutputFormat,
    /// Number of the last sample; wraps.
    sample_counter: u16,
    next_sample: SampleSource,
}

impl SimulatedSerialSensor {
    /// One sample in the output format.
    fn next_sample_bytes(&mut self) -> Vec<u8> {
        let output = (self.next_sample)();
        self.sample_counter = self.sample_counter.wrapping_add(1);
        match self.format {
            OutputFormat::TextLines => text_line(output, self.sample_counter),
            OutputFormat::BinaryFrames => binary_frame(output, self.sample_counter),
        }
    }

    /// Sends a sample for each line end received.
    async fn serve_requests(mut self, mut stream: impl AsyncRead + AsyncWrite + Unpin) -> io::Result<()> {
        let mut buffer = [0; 64];
        loop {
            let count = stream.read(&mut buffer).await?;
            let request = buffer.get(..count).unwrap_or_default();
            for _ in request.iter().filter(|byte| **byte == b'\n') {
                stream.write_all(&self.next_sample_bytes()).await?;
            }
            if count == 0 {
                return Ok(());
            }
        }
    }

    /// Sends a sample each period, whether or not a client reads. Samples that the host delayed follow at once.
    async fn send_samples_at_rate(&mut self, mut stream: impl AsyncWrite + Unpin, rate_hz: f64) -> io::Result<()> {
        let mut ticks = interval(Duration::from_secs_f64(1.0 / rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
        loop {
            ticks.tick().await;
            stream.write_all(&self.next_sample_bytes()).await?;
        }
    }
}

fn text_line(output: SensorOutput, count: u16) -> Vec<u8> {
    let value = match output {
        SensorOutput::Distance(mm) => format!("{mm:+.5}"),
        SensorOutput::NoEcho => "NOECHO".to_owned(),
        SensorOutput::OutOfRange(_) => "RANGE".to_owned(),
        SensorOutput::TooMuchLight => "SATURATED".to_owned(),
    };
    format!("D{value},{count};\r\n").into_bytes()
}

fn binary_frame(output: SensorOutput, count: u16) -> Vec<u8> {
    let (mm, status) = distance_mm_and_status_bits(output);
    let mut body = ((mm * COUNTS_PER_MM).round() as i32).to_be_bytes().to_vec();
    body.extend(count.to_be_bytes());
    body.push(status);
    [&[0xAA, 0x55], body.as_slice(), &crc16_modbus(&body).to_le_bytes()].concat()
}
