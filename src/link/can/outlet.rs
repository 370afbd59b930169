//! Sender of frames, for code that simulates a device.

use socketcan::{CanDataFrame, CanSocket, EmbeddedFrame, Socket};

use super::socket::{in_kernels_words, socket};
use super::{CanError, Frame};

/// Sends frames on an interface.
pub struct CanSender {
    interface: String,
    socket: CanSocket,
}

impl CanSender {
    /// # Errors
    /// The kernel has no CAN, or the interface does not exist.
    pub fn open(interface: &str) -> Result<Self, CanError> {
        Ok(Self { interface: interface.to_owned(), socket: socket(interface)? })
    }

    /// Sends one frame; waits while the interface's queue is full.
    ///
    /// # Errors
    /// The interface is down or gone.
    pub fn send(&self, frame: &Frame) -> Result<(), CanError> {
        let open = |source| CanError::Open { interface: self.interface.clone(), source };
        let built = CanDataFrame::new(in_kernels_words(frame.id), frame.data());
        let built = built.ok_or_else(|| open(std::io::ErrorKind::InvalidInput.into()))?;
        self.socket.write_frame(&built).map_err(open)
    }
}
