//! Wires to simulated sensors that measure in wall time: each is served on a thread of its own.

use std::future::Future;
use std::io;
use std::sync::{Arc, mpsc};

use tokio::net::TcpListener;
use tokio_serial::SerialStream;

use super::SensorError;
use super::modbus::simulated::{Measures, serve_on_pty, serve_on_tcp};
use super::modbus::{self, Registers};
use super::serial::simulated::{on_demand, send_on_pty, send_on_tcp};
use super::serial::{self, Serial};
use crate::base::Clock;
use crate::link::{self, HostPort, LinkError, Named, Pty};
use crate::record::sensor;
use crate::world::Sensed;

/// A pseudo-terminal has no speed.
const BAUD: u32 = 115_200;

/// What stands between the daemon and a simulated sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Inside this process: its time stands still while nobody asks.
    Memory,
    Pty,
    Tcp,
}

impl Wire {
    /// # Errors
    /// Another name, in words.
    pub fn of(name: &str) -> Result<Self, String> {
        match name {
            "memory" => Ok(Self::Memory),
            "pty" => Ok(Self::Pty),
            "tcp" => Ok(Self::Tcp),
            _ => Err(format!("`wire` is `{name}`; it is `memory`, `pty` or `tcp`")),
        }
    }

    /// # Errors
    /// Registers are not served in memory, in words.
    pub fn beyond_memory(self) -> Result<Self, String> {
        match self {
            Self::Memory => {
                Err("`speaks = \"modbus\"` needs `wire = \"tcp\"` or `wire = \"pty\"`".to_owned())
            }
            other => Ok(other),
        }
    }
}

/// What a simulated sensor on a serial line says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tongue {
    Text,
    Frames,
}

/// Gives the next sample.
pub type Sense = Box<dyn FnMut() -> Sensed + Send>;

/// Start a sensor on a serial line, `rate_hz` samples a second, and the driver for it. In memory it
/// says a sample when it is asked, on another wire by itself. Call inside a tokio runtime.
///
/// # Errors
/// What opening says.
pub async fn serial(
    (tongue, wire): (Tongue, Wire),
    sense: Sense,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<Serial, SensorError> {
    let (at, keep) = match wire {
        Wire::Memory => {
            let config = serial::Config::of_simulated(tongue, None)?;
            let flow = on_demand(tongue, sense);
            return Ok(Serial::over(flow, config, sensor, clock, rate_hz));
        }
        Wire::Pty => send_on_pty(tongue, sense, rate_hz)?,
        Wire::Tcp => send_on_tcp(tongue, sense, rate_hz)?,
    };
    let config = serial::Config::of_simulated(tongue, Some(at))?;
    let serial = Serial::open(config, sensor, clock).await;
    // The driver holds the pseudo-terminal open now.
    drop(keep);
    serial
}

/// Start a sensor behind registers, `rate_hz` samples a second, and the driver for it. Call inside a
/// tokio runtime.
///
/// # Errors
/// What opening says; nothing is there in memory (see [`Wire::beyond_memory`]).
pub async fn modbus(
    (measures, wire): (Measures, Wire),
    sense: Sense,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<Registers, SensorError> {
    let (at, keep) = match wire {
        Wire::Memory => {
            return Err(SensorError::Strange {
                text: "registers are not served in memory".to_owned(),
                remedy: "take `wire = \"tcp\"`".to_owned(),
            });
        }
        Wire::Pty => serve_on_pty(measures, sense, rate_hz)?,
        Wire::Tcp => serve_on_tcp(measures, sense, rate_hz)?,
    };
    let config = modbus::Config::of_simulated(at, rate_hz)?;
    let simulated_hz = (measures == Measures::WhenRead).then_some(rate_hz);
    let registers = Registers::open(config, sensor, clock, simulated_hz).await;
    drop(keep);
    registers
}

/// Where it is served, and for a pseudo-terminal the side that keeps it open until its client is there.
pub type Served = (Named, Option<SerialStream>);

/// Serve a new pseudo-terminal, until its client has gone.
///
/// # Errors
/// What making it says.
pub fn on_pty<F: Future>(
    serve: impl FnOnce(SerialStream) -> F + Send + 'static,
) -> Result<Served, LinkError> {
    on_a_thread(move || {
        let Pty { device, path, client_side } = link::pty()?;
        let at = Named::Serial { path: path.into(), baud: BAUD };
        Ok(((at, client_side), serve(device)))
    })
}

/// Serve a port of this computer.
///
/// # Errors
/// What opening it says.
pub fn on_tcp<F: Future>(
    serve: impl FnOnce(TcpListener) -> F + Send + 'static,
) -> Result<Served, LinkError> {
    on_a_thread(move || {
        let listen = || {
            let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
            listener.set_nonblocking(true)?;
            let port = listener.local_addr()?.port();
            Ok((TcpListener::from_std(listener)?, port))
        };
        let (listener, port) = listen().map_err(fault)?;
        Ok(((Named::Tcp(HostPort::local(port)), None), serve(listener)))
    })
}

fn fault(source: io::Error) -> LinkError {
    LinkError::Open { address: "a simulated sensor's wire".to_owned(), source }
}

fn on_a_thread<T: Send + 'static, F: Future>(
    open: impl FnOnce() -> Result<(T, F), LinkError> + Send + 'static,
) -> Result<T, LinkError> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(fault)?;
    let (tell, told) = mpsc::channel();
    let run = move || {
        let entered = runtime.enter();
        match open() {
            Ok((served, serve)) => {
                let _ = tell.send(Ok(served));
                drop(entered);
                runtime.block_on(serve);
            }
            Err(error) => drop(tell.send(Err(error))),
        }
    };
    std::thread::Builder::new().name("twin".to_owned()).spawn(run).map_err(fault)?;
    told.recv().map_err(|_| fault(io::Error::other("its thread has ended")))?
}
