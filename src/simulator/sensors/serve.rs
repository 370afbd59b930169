//! Serves a simulated sensor that measures in wall time, on its own wire and thread.

use std::future::Future;
use std::io;
use std::sync::mpsc;

use link::{HostPort, LinkError, Named, Pty};
use tokio::net::TcpListener;
use tokio_serial::SerialStream;

use crate::Sensed;

/// Nominal baud rate; a pseudo-terminal ignores it.
const BAUD: u32 = 115_200;

/// Returns the next sample.
pub type Sense = Box<dyn FnMut() -> Sensed + Send>;

/// Address of the sensor, and for a pseudo-terminal the side that keeps it open until its client has opened it.
pub type Served = (Named, Option<SerialStream>);

/// Serves a new pseudo-terminal until its client disconnects.
///
/// # Errors
/// The pseudo-terminal cannot be created.
pub fn on_pty<F: Future>(
    serve: impl FnOnce(SerialStream) -> F + Send + 'static,
) -> Result<Served, LinkError> {
    on_a_thread(move || {
        let Pty { device, path, client_side } = link::pty()?;
        let at = Named::Serial { path: path.into(), baud: BAUD };
        Ok(((at, client_side), serve(device)))
    })
}

/// Serves a local TCP port.
///
/// # Errors
/// The port cannot be opened.
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
    std::thread::Builder::new().name("simulated sensor".to_owned()).spawn(run).map_err(fault)?;
    told.recv().map_err(|_| fault(io::Error::other("its thread has ended")))?
}
