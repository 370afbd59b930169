//! Links: the byte stream (serial, TCP, pty, in-process), Modbus registers and shared files; their capture and
//! replay; the clock trait. This package contains no device-specific code.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::io;

mod address;
pub mod can;
mod capture;
pub mod clock;
mod flow;
mod folder;
#[cfg(test)]
mod fuzz;
mod lines;
pub mod modbus;
mod named;
mod owner;
mod replay;
mod shared_ports;
mod speed;
mod stream;
mod talk;
#[cfg(test)]
mod tests;
mod wiring;

pub use address::{Address, BY_ID, Pty, by_id, listen, open, pty};
pub use capture::Capture;
pub use clock::Clock;
pub use flow::{ByteStreamHandle, RequestTurn, StreamRead};
pub use folder::Folder;
pub use lines::Received;
pub use named::{HostPort, Named, timeout};
pub use replay::{CaptureError, Replay};
pub use shared_ports::SharedPorts;
pub use speed::{heard, pty_at};
pub use stream::{Link, Urgent};
pub use talk::Talk;
pub use wiring::Wiring;

/// Errors of a link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error("{address} does not exist")]
    Missing { address: String },
    /// The computer at `address` refuses the connection.
    #[error("nothing listens at {address}")]
    NotListening { address: String },
    #[error("no one serial port is named `{id}`; there are: {}", list(there))]
    NoneNamed { id: String, there: Vec<String> },
    #[error("{address} is in use by another program")]
    Busy { address: String },
    #[error("{address} may not be opened: permission denied")]
    Denied { address: String },
    #[error("{address} could not be opened: {source}")]
    Open { address: String, source: io::Error },
    #[error("the link to {address} is lost: {why}")]
    Lost { address: String, why: String },
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl LinkError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::Missing { .. } => {
                "check the cable, and the address in the machine file".to_owned()
            }
            Self::NotListening { .. } => {
                "start the control's server, and check the address in the machine file".to_owned()
            }
            Self::Busy { .. } => {
                "close the other program (a sender, a terminal), then start again".to_owned()
            }
            Self::Denied { .. } => "give this user the device's group (often dialout)".to_owned(),
            Self::Open { .. } => "check the address in the machine file".to_owned(),
            Self::NoneNamed { .. } => {
                "plug the device in and switch it on; serial_id takes a name as `ls \
                 /dev/serial/by-id` shows it, or a part of it that no other name has"
                    .to_owned()
            }
            Self::Lost { .. } => {
                "the state of the machine is unknown: look at it, then mend the link (a server \
                 that has ended: start it again; a serial port that comes back under another name is found \
                 by serial_id)"
                    .to_owned()
            }
        }
    }
}
