//! Serves a simulated sensor that measures in wall time, on its own wire and thread.

use std::future::Future;
use std::io;
use std::sync::mpsc;

use link::{HostPort, LinkConfig, LinkError, Pty};
use tokio::net::TcpListener;
use tokio_serial::SerialStream;

use crate::SensorOutput;

/// Nominal baud rate; a pseudo-terminal ignores it.
const NOMINAL_BAUD: u32 = 115_200;

/// Takes and returns the next sample; each call is a new measurement.
pub type SampleSource = Box<dyn FnMut() -> SensorOutput + Send>;

/// Address of the sensor; for a pseudo-terminal also its client side, to be kept until a client has opened it.
pub type ServedSensor = (LinkConfig, Option<SerialStream>);

/// Serves a new pseudo-terminal until its client disconnects.
///
/// # Errors
/// The pseudo-terminal cannot be created.
pub fn serve_pty<F: Future>(serve: impl FnOnce(SerialStream) -> F + Send + 'static) -> Result<ServedSensor, LinkError> {
    serve_on_thread(move || {
        let Pty { device, path, client_side } = link::create_pty()?;
        let at = LinkConfig::Serial { path: path.into(), baud: NOMINAL_BAUD };
        Ok(((at, client_side), serve(device)))
    })
}

/// Serves a local TCP port until the future of `serve` ends.
///
/// # Errors
/// The port cannot be opened.
pub fn serve_tcp<F: Future>(serve: impl FnOnce(TcpListener) -> F + Send + 'static) -> Result<ServedSensor, LinkError> {
    serve_on_thread(move || {
        let (listener, at) = listen_locally().map_err(wire_error)?;
        Ok(((at, None), serve(listener)))
    })
}

/// Listens on a free TCP port of this computer. Call inside a tokio runtime.
///
/// # Errors
/// The port cannot be opened.
pub fn listen_locally() -> io::Result<(TcpListener, LinkConfig)> {
    let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
    listener.set_nonblocking(true)?;
    let port = listener.local_addr()?.port();
    Ok((TcpListener::from_std(listener)?, LinkConfig::Tcp(HostPort::local(port))))
}

fn wire_error(source: io::Error) -> LinkError {
    LinkError::OpenFailed { address: "the wire of a simulated sensor".to_owned(), source }
}

/// Calls `open` on a new thread, which then serves; returns what `open` gives, such as the address.
fn serve_on_thread<T: Send + 'static, F: Future>(
    open: impl FnOnce() -> Result<(T, F), LinkError> + Send + 'static,
) -> Result<T, LinkError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(wire_error)?;
    let (result_sender, result_receiver) = mpsc::channel();
    let run = move || {
        let entered = runtime.enter();
        match open() {
            Ok((served, serve)) => {
                let _ = result_sender.send(Ok(served));
                drop(entered);
                runtime.block_on(serve);
            }
            Err(error) => drop(result_sender.send(Err(error))),
        }
    };
    std::thread::Builder::new().name("simulated sensor".to_owned()).spawn(run).map_err(wire_error)?;
    result_receiver.recv().map_err(|_| wire_error(io::Error::other("the thread of the simulated sensor has ended")))?
}
