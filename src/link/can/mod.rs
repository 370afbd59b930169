//! CAN frames: an interface of the kernel (SocketCAN), or frames on demand in memory. One identifier is
//! listened to.

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
pub use outlet::Outlet;

/// Frames that may wait for their reader: some seconds of the fastest sensor.
const WAITING_FRAMES: usize = 4096;

/// What comes from the bus.
#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    Frame(Frame),
    /// The interface is down or gone, in words. It is opened again once it is up.
    Down(String),
    /// It is up again; what was sent meanwhile is lost.
    Up,
    /// The bus has errors, in words.
    Trouble(String),
    /// The controller has left the bus, in words: nothing comes until it is restarted.
    Off(String),
    /// So many frames at least came while nobody took them, or while the controller could not.
    Lost(u32),
    /// Nothing of its own identifier has come for a while, and frames of this one do.
    Other(Id),
}

type OnDemand = Box<dyn FnMut() -> Option<Frame> + Send>;

enum Source {
    Listening(mpsc::Receiver<Heard>),
    OnDemand(OnDemand),
}

/// The handle: what comes, in its order.
pub struct Can {
    name: String,
    source: Source,
}

impl Can {
    /// Listen to `id` on `interface`. Frames have the time of `clock` at which the kernel received
    /// them.
    ///
    /// # Errors
    /// A kernel without CAN, no such interface.
    pub fn open(interface: &str, id: Id, clock: Arc<dyn Clock>) -> Result<Self, CanError> {
        Ok(Self::over(interface, owner::start(interface, id, clock)?))
    }

    /// What somebody hears on a bus.
    pub fn over(name: impl Into<String>, heard: mpsc::Receiver<Heard>) -> Self {
        Self { name: name.into(), source: Source::Listening(heard) }
    }

    /// Frames that are made when they are asked for; `None`: silence.
    pub fn on_demand(
        name: impl Into<String>,
        source: impl FnMut() -> Option<Frame> + Send + 'static,
    ) -> Self {
        Self { name: name.into(), source: Source::OnDemand(Box::new(source)) }
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Nothing comes unasked.
    pub fn is_on_demand(&self) -> bool {
        matches!(self.source, Source::OnDemand(_))
    }

    /// What comes next, or `None` when `wait` has passed without anything.
    ///
    /// # Errors
    /// The thread that listens has ended.
    pub async fn next(&mut self, wait: Duration) -> Result<Option<Heard>, CanError> {
        match &mut self.source {
            Source::OnDemand(source) => Ok(source().map(Heard::Frame)),
            // What is dropped here waits on a channel, not on the device.
            Source::Listening(heard) => match timeout_at(Instant::now() + wait, heard.recv()).await
            {
                Err(_) => Ok(None),
                Ok(Some(heard)) => Ok(Some(heard)),
                Ok(None) => Err(CanError::Gone { interface: self.name.clone() }),
            },
        }
    }

    /// What has come already, without waiting.
    ///
    /// # Errors
    /// The thread that listens has ended.
    pub fn waiting(&mut self) -> Result<Option<Heard>, CanError> {
        let Source::Listening(heard) = &mut self.source else { return Ok(None) };
        match heard.try_recv() {
            Ok(heard) => Ok(Some(heard)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(CanError::Gone { interface: self.name.clone() }),
        }
    }
}
