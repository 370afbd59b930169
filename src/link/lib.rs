//! Links: the byte stream (serial, TCP, pty, in-process), Modbus registers and shared files; their capture and
//! replay; the clock trait. This package contains no device-specific code.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::io;

mod address;
mod baud_mismatch;
mod boxed_stream;
mod byte_stream;
pub mod can;
mod capture;
pub mod clock;
#[cfg(test)]
mod fuzz;
mod line_assembler;
mod line_link;
mod link_config;
mod link_mode;
pub mod modbus;
mod replay;
mod sensor_request_capture;
mod shared_folder;
mod shared_ports;
mod stream_owner;
#[cfg(test)]
mod tests;

pub use address::{
    LinkAddress, Pty, SERIAL_PORTS_BY_ID_DIR, create_pty, find_serial_port_by_id, open_byte_stream, open_line_link,
};
pub use baud_mismatch::{create_pty_at_baud, decode_at_baud};
pub use byte_stream::{ByteStreamHandle, RequestTurn, StreamRead};
pub use capture::CaptureWriter;
pub use clock::Clock;
pub use line_assembler::LineEvent;
pub use line_link::{LineLink, UrgentSender};
pub use link_config::{HostPort, LinkConfig, LinkKeys, parse_timeout_s};
pub use link_mode::LinkMode;
pub use replay::{CaptureError, CaptureReplay};
pub use sensor_request_capture::SensorRequestCapture;
pub use shared_folder::SharedFolder;
pub use shared_ports::SharedPorts;

/// Reasons why a link cannot be opened, or is lost.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error("{address} does not exist")]
    NoSuchPort { address: String },
    /// The computer at `address` refuses the connection.
    #[error("no server listens at {address}")]
    NotListening { address: String },
    /// No name in `/dev/serial/by-id` matches `id`, and `available` lists all; or several match, and `available`
    /// lists these.
    #[error("no unique serial port matches `{id}`; available: {}", join_or_none(available))]
    NoUniquePort { id: String, available: Vec<String> },
    #[error("{address} is in use by another program")]
    Busy { address: String },
    #[error("no permission to open {address}")]
    PermissionDenied { address: String },
    #[error("{address} could not be opened: {source}")]
    OpenFailed { address: String, source: io::Error },
    #[error("the link to {address} is lost: {why}")]
    Lost { address: String, why: String },
}

fn join_or_none(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl LinkError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            LinkError::NoSuchPort { .. } => "check the cable and the address in the machine file".to_owned(),
            Self::NotListening { .. } => {
                "start the control's server and check the address in the machine file".to_owned()
            }
            Self::Busy { .. } => "close the other program (a G-code sender, a terminal), then start again".to_owned(),
            LinkError::PermissionDenied { .. } => "add this user to the device's group (often dialout)".to_owned(),
            Self::OpenFailed { .. } => "check the address in the machine file".to_owned(),
            Self::NoUniquePort { .. } => "plug the device in and switch it on; set serial_id to a name from `ls \
                 /dev/serial/by-id`, or to a part that only one of the names contains"
                .to_owned(),
            Self::Lost { .. } => {
                "the state of the machine is unknown: check the machine, then restore the link (restart a \
                 server that has ended; use serial_id for a serial port whose device name changes)"
                    .to_owned()
            }
        }
    }
}
