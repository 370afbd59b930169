//! CAN frames of one identifier, either from an interface of the kernel (SocketCAN) or generated in memory on
//! demand.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::time::{Instant, timeout_at};

use crate::Clock;

mod error;
mod error_frame;
mod foreign_ids;
mod frame;
mod interfaces;
mod sender;
mod socket;
mod socket_owner;
#[cfg(test)]
mod tests;
mod timestamp_converter;

pub use error::CanError;
pub use frame::{CanFrame, CanId};
pub use sender::CanSender;

/// Maximum number of frames in the queue to the reader: some seconds of the fastest sensor.
const MAX_QUEUED_FRAMES: usize = 4096;

/// One event from the bus.
#[derive(Debug, Clone, PartialEq)]
pub enum CanEvent {
    /// A frame of the own identifier (of the receiver).
    Frame(CanFrame),
    /// The interface is down or gone, with the reason. The receiver thread reopens the interface once it is up again.
    InterfaceDown(String),
    /// The interface is up again; frames sent meanwhile are lost.
    InterfaceUp,
    /// The bus has errors, with the description.
    BusErrors(String),
    /// The controller is bus-off, with the description: it receives no frame until it is restarted.
    BusOff(String),
    /// At least this many frames were lost, because the queue was full or the controller could not receive them.
    LostFrames(u32),
    /// No frame of the own identifier has arrived for some time, but frames of this identifier do.
    ForeignId(CanId),
}

/// Called for each read; returns the next frame, or `None` if no frame is available yet.
type FrameGenerator = Box<dyn FnMut() -> Option<CanFrame> + Send>;

enum FrameSource {
    /// Events from the thread that reads the bus, or from the task given to `CanReceiver::from_events`.
    Events(mpsc::Receiver<CanEvent>),
    Generator(FrameGenerator),
}

/// Handle of one CAN source: delivers the events in order.
pub struct CanReceiver {
    name: String,
    source: FrameSource,
}

impl CanReceiver {
    /// Opens `interface` and receives frames of `id`. The time of a frame is the time of `clock` at which the
    /// kernel received it. An interface that is down can be opened: `CanEvent::InterfaceDown` reports the state.
    ///
    /// # Errors
    /// The kernel has no CAN, or the interface does not exist.
    pub fn open(interface: &str, id: CanId, clock: Arc<dyn Clock>) -> Result<Self, CanError> {
        Ok(Self::from_events(interface, socket_owner::start_receiver_thread(interface, id, clock)?))
    }

    /// Wraps the events that another task receives from a bus.
    pub fn from_events(name: impl Into<String>, events: mpsc::Receiver<CanEvent>) -> Self {
        Self { name: name.into(), source: FrameSource::Events(events) }
    }

    /// Source whose frames are generated when the caller reads; `None` means that no frame is available.
    pub fn from_generator(name: impl Into<String>, source: impl FnMut() -> Option<CanFrame> + Send + 'static) -> Self {
        Self { name: name.into(), source: FrameSource::Generator(Box::new(source)) }
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether frames are generated only when the caller reads.
    pub fn generates_frames_on_demand(&self) -> bool {
        matches!(self.source, FrameSource::Generator(_))
    }

    /// Next event, or `None` after `max_wait` without an event. A generator does not wait: `None` if it has no frame.
    ///
    /// # Errors
    /// The receiving thread has ended (not for a generator).
    pub async fn next_event(&mut self, max_wait: Duration) -> Result<Option<CanEvent>, CanError> {
        match &mut self.source {
            FrameSource::Generator(source) => Ok(source().map(CanEvent::Frame)),
            // Dropping this future after `max_wait` loses no event: it waits on a channel, not on the device.
            FrameSource::Events(events) => match timeout_at(Instant::now() + max_wait, events.recv()).await {
                Err(_) => Ok(None),
                Ok(Some(event)) => Ok(Some(event)),
                Ok(None) => Err(CanError::ThreadEnded { interface: self.name.clone() }),
            },
        }
    }

    /// Next event that is already in the queue, without waiting. Always `None` for a generator, which has no queue.
    ///
    /// # Errors
    /// The receiving thread has ended.
    pub fn try_next_event(&mut self) -> Result<Option<CanEvent>, CanError> {
        let FrameSource::Events(events) = &mut self.source else { return Ok(None) };
        match events.try_recv() {
            Ok(event) => Ok(Some(event)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(CanError::ThreadEnded { interface: self.name.clone() }),
        }
    }
}
