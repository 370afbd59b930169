//! CAN frames of one identifier, either from an interface of the kernel (SocketCAN) or generated in memory on
//! demand.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::time::{Instant, timeout_at};

use crate::Clock;

mod error;
mod frame;
mod interfaces;
mod others;
mod outlet;
mod owner;
mod socket;
mod stamp;
#[cfg(test)]
mod tests;
mod trouble;

pub use error::CanError;
pub use frame::{Frame, Id};
pub use outlet::CanSender;

/// Maximum number of frames in the queue to the reader: some seconds of the fastest sensor.
const WAITING_FRAMES: usize = 4096;

/// One event from the bus.
#[derive(Debug, Clone, PartialEq)]
pub enum CanEvent {
    Frame(Frame),
    /// The interface is down or gone, with the reason. The driver opens the interface again once it is up.
    Down(String),
    /// The interface is up again; frames sent meanwhile are lost.
    Up,
    /// The bus has errors, with the description.
    ErrorFrameClass(String),
    /// The controller is bus-off, with the description: it receives no frame until it is restarted.
    Off(String),
    /// At least this many frames were lost, because the queue was full or the controller could not receive them.
    Lost(u32),
    /// No frame of the own identifier has arrived for some time, but frames of this identifier do.
    Other(Id),
}

type OnDemand = Box<dyn FnMut() -> Option<Frame> + Send>;

enum Source {
    Listening(mpsc::Receiver<CanEvent>),
    OnDemand(OnDemand),
}

/// Handle of one CAN source: delivers the events in order.
pub struct Can {
    name: String,
    source: Source,
}

impl Can {
    /// Opens `interface` and receives frames of `id`. The time of a frame is the time of `clock` at which the
    /// kernel received it.
    ///
    /// # Errors
    /// The kernel has no CAN, or the interface does not exist.
    pub fn open(interface: &str, id: Id, clock: Arc<dyn Clock>) -> Result<Self, CanError> {
        Ok(Self::over(interface, owner::start(interface, id, clock)?))
    }

    /// Wraps the events that another task receives from a bus.
    pub fn over(name: impl Into<String>, heard: mpsc::Receiver<CanEvent>) -> Self {
        Self { name: name.into(), source: Source::Listening(heard) }
    }

    /// Source whose frames are generated when the caller reads; `None` means that no frame is available.
    pub fn on_demand(
        name: impl Into<String>,
        source: impl FnMut() -> Option<Frame> + Send + 'static,
    ) -> Self {
        Self { name: name.into(), source: Source::OnDemand(Box::new(source)) }
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether frames are generated only when the caller reads.
    pub fn is_on_demand(&self) -> bool {
        matches!(self.source, Source::OnDemand(_))
    }

    /// Next event, or `None` after `wait` without an event.
    ///
    /// # Errors
    /// The receiving thread has ended.
    pub async fn next(&mut self, wait: Duration) -> Result<Option<CanEvent>, CanError> {
        match &mut self.source {
            Source::OnDemand(source) => Ok(source().map(CanEvent::Frame)),
            // The dropped future waits on a channel, not on the device.
            Source::Listening(heard) => match timeout_at(Instant::now() + wait, heard.recv()).await
            {
                Err(_) => Ok(None),
                Ok(Some(heard)) => Ok(Some(heard)),
                Ok(None) => Err(CanError::Gone { interface: self.name.clone() }),
            },
        }
    }

    /// Next event that is already in the queue, without waiting.
    ///
    /// # Errors
    /// The receiving thread has ended.
    pub fn waiting(&mut self) -> Result<Option<CanEvent>, CanError> {
        let Source::Listening(heard) = &mut self.source else { return Ok(None) };
        match heard.try_recv() {
            Ok(heard) => Ok(Some(heard)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(CanError::Gone { interface: self.name.clone() }),
        }
    }
}
