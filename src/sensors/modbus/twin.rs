//! A simulated sensor behind Modbus registers. It fills them by code of its own, and knows nothing of the
//! map that its driver reads by.
//!
//! Input registers: 0 status (1 no echo, 2 out of range, 4 saturated), 1 counter, 2 and 3 the distance in
//! 10 nm, the low word first.

use std::future::{Ready, ready};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::time::{MissedTickBehavior, interval};
use tokio_modbus::server::{Service, rtu, tcp};
use tokio_modbus::{ExceptionCode, Request, Response, SlaveRequest};

use super::{Config, Registers};
use crate::base::Clock;
use crate::record::sensor;
use crate::sensors::SensorError;
use crate::sensors::wires::{Wire, no_wire, on_pty, on_tcp};
use crate::world::Sensed;

/// Gives the next sample.
pub type Sense = Box<dyn FnMut() -> Sensed + Send>;

const MAP: &str = r#"
counter = { register = 1, type = "u16" }
value = { register = 2, type = "i32", order = "cdab", scale_mm = 0.00001 }
status = [
    { register = 0, bit = 0, means = "no-echo" },
    { register = 0, bit = 1, means = "range" },
    { register = 0, bit = 2, means = "saturated" },
]
"#;

const COUNTS_PER_MM: f64 = 1e5;

/// When it measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measures {
    /// When its registers are read: time stands still in between.
    WhenRead,
    /// At its rate, in wall time.
    AtItsRate,
}

/// Start one, `rate_hz` samples a second, and the driver for it. Call inside a tokio runtime.
///
/// # Errors
/// What opening says; the wire cannot be `memory`.
pub async fn open(
    (wire, measures): (Wire, Measures),
    sense: Sense,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<Registers, SensorError> {
    let inner = Arc::new(Mutex::new(Inner { words: [0; 4], sense }));
    let twin = Twin { inner, measures };
    twin.measure();
    let measuring = twin.clone();
    let measuring = async move { measuring.at_rate(rate_hz).await };
    let (at, keep) = match wire {
        Wire::Memory => return Err(no_wire("memory")),
        Wire::Pty => on_pty(move |device| async move {
            let serve = rtu::Server::new(device).serve_forever(twin);
            tokio::select! { _ = serve => {}, () = measuring => {} }
        })?,
        Wire::Tcp => on_tcp(move |listener| async move {
            let connected = move |stream: TcpStream, _| {
                let twin = twin.clone();
                async move { stream.set_nodelay(true).map(|()| Some((twin, stream))) }
            };
            let server = tcp::Server::new(listener);
            tokio::select! { _ = server.serve(&connected, |_| {}) => {}, () = measuring => {} }
        })?,
    };
    let parity = if wire == Wire::Pty { "parity = \"none\"" } else { "" };
    let config = Config::local(at, &format!("rate_hz = {rate_hz}\n{parity}\n{MAP}"));
    let config =
        config.map_err(|text| SensorError::Strange { text, remedy: "report it".to_owned() })?;
    let simulated_hz = (measures == Measures::WhenRead).then_some(rate_hz);
    let registers = Registers::open(config, sensor, clock, simulated_hz).await;
    // The driver holds the pseudo-terminal open now.
    drop(keep);
    registers
}

struct Inner {
    words: [u16; 4],
    sense: Sense,
}

#[derive(Clone)]
struct Twin {
    inner: Arc<Mutex<Inner>>,
    measures: Measures,
}

impl Twin {
    async fn at_rate(self, rate_hz: f64) {
        if self.measures == Measures::WhenRead {
            std::future::pending::<()>().await;
        }
        let mut ticks = interval(Duration::from_secs_f64(1.0 / rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            ticks.tick().await;
            self.measure();
        }
    }

    /// All four at once.
    fn measure(&self) {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let (mm, status) = match (inner.sense)() {
            Sensed::Distance(mm) => (mm, 0),
            Sensed::NoEcho => (0.0, 1),
            Sensed::OutOfRange(mm) => (mm, 2),
            Sensed::Saturated => (0.0, 4),
        };
        let number = (mm * COUNTS_PER_MM).round() as i32 as u32;
        let [_, count, ..] = inner.words;
        inner.words = [status, count.wrapping_add(1), number as u16, (number >> 16) as u16];
    }
}

impl Service for Twin {
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
        if self.measures == Measures::WhenRead {
            self.measure();
        }
        let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let words = inner.words.get(first..first + count).unwrap_or_default();
        ready(Ok(Response::ReadInputRegisters(words.to_vec())))
    }
}
