//! A simulated sensor behind Modbus registers. It fills them by its own code, independent of the driver's
//! register map.
//!
//! Input registers: 0 status (1 no echo, 2 out of range, 4 saturated), 1 counter, 2 and 3 the distance in 10
//! nm, low word first.

use std::future::{Ready, ready};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::time::{MissedTickBehavior, interval};
use tokio_modbus::server::{Service, rtu, tcp};
use tokio_modbus::{ExceptionCode, Request, Response, SlaveRequest};

use super::distance_mm_and_status_bits;
use super::serve::{SampleSource, ServedSensor, serve_pty, serve_tcp};
use link::LinkError;

/// Counts per mm: one count is 10 nm.
const COUNTS_PER_MM: f64 = 1e5;

/// The data sheet, as keys of `[sensor.modbus]`.
pub const DATA_SHEET_TOML: &str = r#"
counter = { register = 1, type = "u16" }
value = { register = 2, type = "i32", order = "cdab", scale_mm = 0.00001 }
status = [
    { register = 0, bit = 0, means = "no-echo" },
    { register = 0, bit = 1, means = "range" },
    { register = 0, bit = 2, means = "saturated" },
]
"#;

/// When the sensor measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleTiming {
    /// At each read of its registers; simulated time does not advance between two reads.
    WhenRead,
    /// At the given rate, in wall time, whether or not a client reads.
    AtFixedRate,
}

/// Serves a sensor on a pseudo-terminal (RTU, any unit). `rate_hz`: samples per second for `AtFixedRate`, else
/// unused.
///
/// # Errors
/// The pseudo-terminal cannot be created.
pub fn serve_on_pty(timing: SampleTiming, next_sample: SampleSource, rate_hz: f64) -> Result<ServedSensor, LinkError> {
    let sensor = SimulatedModbusSensor::new(timing, next_sample);
    let measuring = sensor.clone().update_registers_at_rate(rate_hz);
    serve_pty(move |device| async move {
        let serve = rtu::Server::new(device).serve_forever(sensor);
        tokio::select! { _ = serve => {}, () = measuring => {} }
    })
}

/// Serves a sensor on a TCP port. `rate_hz`: samples per second for `AtFixedRate`, else unused.
///
/// # Errors
/// The port cannot be opened.
pub fn serve_on_tcp(timing: SampleTiming, next_sample: SampleSource, rate_hz: f64) -> Result<ServedSensor, LinkError> {
    let sensor = SimulatedModbusSensor::new(timing, next_sample);
    let measuring = sensor.clone().update_registers_at_rate(rate_hz);
    serve_tcp(move |listener| async move {
        let connected = move |stream: TcpStream, _| {
            let sensor = sensor.clone();
            async move { stream.set_nodelay(true).map(|()| Some((sensor, stream))) }
        };
        let server = tcp::Server::new(listener);
        tokio::select! { _ = server.serve(&connected, |_| {}) => {}, () = measuring => {} }
    })
}

/// The registers of the sensor, and the source of its samples.
struct SampleRegisters {
    /// Input registers 0 to 3: status, counter, distance in 10 nm with its low word first.
    register_values: [u16; 4],
    next_sample: SampleSource,
}

/// A sensor behind Modbus registers; clones share its registers.
#[derive(Clone)]
struct SimulatedModbusSensor {
    registers: Arc<Mutex<SampleRegisters>>,
    timing: SampleTiming,
}

impl SimulatedModbusSensor {
    /// Creates the sensor and takes its first sample.
    fn new(timing: SampleTiming, next_sample: SampleSource) -> Self {
        let sensor =
            Self { registers: Arc::new(Mutex::new(SampleRegisters { register_values: [0; 4], next_sample })), timing };
        sensor.update_registers();
        sensor
    }

    /// Takes samples at the rate; with `WhenRead` it takes none and never completes.
    async fn update_registers_at_rate(self, rate_hz: f64) {
        if self.timing == SampleTiming::WhenRead {
            std::future::pending::<()>().await;
        }
        let mut ticks = interval(Duration::from_secs_f64(1.0 / rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            ticks.tick().await;
            self.update_registers();
        }
    }

    /// Takes one sample and updates all four registers at once.
    fn update_registers(&self) {
        let mut registers = self.registers.lock().unwrap_or_else(PoisonError::into_inner);
        let (mm, status) = distance_mm_and_status_bits((registers.next_sample)());
        let number = (mm * COUNTS_PER_MM).round() as i32 as u32;
        let [_, count, ..] = registers.register_values;
        registers.register_values = [status.into(), count.wrapping_add(1), number as u16, (number >> 16) as u16];
    }
}

impl Service for SimulatedModbusSensor {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, SlaveRequest { request, .. }: Self::Request) -> Self::Future {
        let Request::ReadInputRegisters(first, count) = request else {
            return ready(Err(ExceptionCode::IllegalFunction));
        };
        let (first, count) = (usize::from(first), usize::from(count));
        if first + count > 4 {
            return ready(Err(ExceptionCode::IllegalDataAddress));
        }
        if self.timing == SampleTiming::WhenRead {
            self.update_registers();
        }
        let registers = self.registers.lock().unwrap_or_else(PoisonError::into_inner);
        let words = registers.register_values.get(first..first + count).unwrap_or_default();
        ready(Ok(Response::ReadInputRegisters(words.to_vec())))
    }
}
