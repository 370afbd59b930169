//! Sender of frames, for code that simulates a device.

use socketcan::{CanDataFrame, CanSocket, EmbeddedFrame, Socket};

use super::socket::open_socket;
use super::{CanError, CanFrame};

/// Sends frames on an interface.
pub struct CanSender {
    interface: String,
    socket: CanSocket,
}

impl CanSender {
    /// # Errors
    /// The kernel has no CAN, or the interface does not exist.
    pub fn open(interface: &str) -> Result<Self, CanError> {
        Ok(Self { interface: interface.to_owned(), socket: open_socket(interface)? })
    }

    /// Sends one frame; waits while the interface's queue is full.
    ///
    /// # Errors
    /// The interface is down or gone.
    pub fn send(&self, frame: &CanFrame) -> Result<(), CanError> {
        let open_error = |source| CanError::OpenFailed { interface: self.interface.clone(), source };
        let frame_to_send = CanDataFrame::new(frame.id.0, frame.data());
        let frame_to_send = frame_to_send.ok_or_else(|| open_error(std::io::ErrorKind::InvalidInput.into()))?;
        self.socket.write_frame(&frame_to_send).map_err(open_error)
    }
}
