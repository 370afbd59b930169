//! Wires to simulated sensors that measure in wall time: each is served on a thread of its own.

use std::future::Future;
use std::io;
use std::sync::mpsc;

use tokio::net::TcpListener;
use tokio_serial::SerialStream;

use super::SensorError;
use crate::link::{self, HostPort, LinkError, Named, Pty};

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
    pub fn of(name: &str) -> Result<Self, SensorError> {
        match name {
            "memory" => Ok(Self::Memory),
            "pty" => Ok(Self::Pty),
            "tcp" => Ok(Self::Tcp),
            _ => Err(no_wire(name)),
        }
    }
}

pub fn no_wire(name: &str) -> SensorError {
    SensorError::Strange {
        text: format!("this simulated sensor has no wire `{name}`"),
        remedy:
            "set `wire` of [sensor.simulated]: `pty` or `tcp`; `memory` where it speaks `serial`"
                .to_owned(),
    }
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
