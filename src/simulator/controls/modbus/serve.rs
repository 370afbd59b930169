//! The simulated control as a Modbus server: TCP, and RTU on a serial stream.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::io::{DuplexStream, copy_bidirectional, duplex};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::time::{Instant, sleep};
use tokio_modbus::server::{Service, rtu, tcp};
use tokio_modbus::{ExceptionCode, Response, SlaveRequest};
use tokio_serial::SerialStream;

use super::Firmware;

/// Modbus unit address on a serial line, which several devices may share.
const RTU_UNIT_ADDRESS: u8 = 1;
const WIRE_BUFFER_BYTES: usize = 4096;

/// Modbus service of a control; clones serve the same control.
#[derive(Clone)]
struct FirmwareServer {
    firmware: Arc<Mutex<Firmware>>,
    /// Host time at which the control is powered up.
    start_instant: Instant,
    /// Unit address that is answered; requests to others are ignored. `None`: all are answered.
    answered_unit: Option<u8>,
}

impl Service for FirmwareServer {
    type Request = SlaveRequest<'static>;
    type Response = Option<Response>;
    type Exception = ExceptionCode;
    type Future = Pin<Box<dyn Future<Output = Result<Option<Response>, ExceptionCode>> + Send + 'static>>;

    fn call(&self, SlaveRequest { slave, request }: Self::Request) -> Self::Future {
        if self.answered_unit.is_some_and(|unit| unit != slave) {
            return Box::pin(std::future::ready(Ok(None)));
        }
        let reply = {
            let mut firmware = self.firmware.lock().unwrap_or_else(PoisonError::into_inner);
            firmware.handle_request(&request, self.start_instant.elapsed())
        };
        Box::pin(async move {
            if !reply.delay.is_zero() {
                sleep(reply.delay).await;
            }
            reply.answer.transpose()
        })
    }
}

fn firmware_server(firmware: Firmware, answered_unit: Option<u8>) -> FirmwareServer {
    FirmwareServer { firmware: Arc::new(Mutex::new(firmware)), start_instant: Instant::now(), answered_unit }
}

/// Serves every client that connects, until dropped.
///
/// # Errors
/// The listener fails.
pub async fn serve_tcp(firmware: Firmware, listener: TcpListener) -> io::Result<()> {
    let cut = firmware.cut_signal.clone();
    let server = firmware_server(firmware, None);
    let connected = |stream: TcpStream, _| {
        let (server, cut) = (server.clone(), cut.clone());
        async move {
            stream.set_nodelay(true)?;
            Ok(Some((server, cuttable_stream(stream, cut))))
        }
    };
    tcp::Server::new(listener).serve(&connected, |_| {}).await
}

/// A stream that forwards `stream` until `cut_signal` is notified.
fn cuttable_stream(mut stream: TcpStream, cut_signal: Arc<Notify>) -> DuplexStream {
    let (mut near, far) = duplex(WIRE_BUFFER_BYTES);
    tokio::spawn(async move {
        let cut = cut_signal.notified();
        // After a cut, or when one of the streams ends, both are closed.
        tokio::select! {
            () = cut => {}
            _ = copy_bidirectional(&mut stream, &mut near) => {}
        }
    });
    far
}

/// Serves the serial line as unit 1, until dropped.
///
/// # Errors
/// The serial line fails.
pub async fn serve_rtu(firmware: Firmware, line: SerialStream) -> io::Result<()> {
    rtu::Server::new(line).serve_forever(firmware_server(firmware, Some(RTU_UNIT_ADDRESS))).await
}
