//! Modbus registers as a port, over RTU and TCP. One thread owns the connection; the handle is a
//! channel, so that a dropped wait never drops a request half-way.
//!
//! **The hazard.** An RTU reply does not say which request it answers. After a time-out the late reply
//! waits in the line, and a client that asks again takes it for the answer to its next request; from
//! then on every value is one request old. So, after *any* time-out or reply that does not fit:
//! - The context that waited is dropped, with all that it had read.
//! - TCP: the connection is closed and opened anew. A reply carries its transaction's number, and a
//!   new connection has no old replies.
//! - RTU: the line is kept quiet until nothing has come for the silence of 3.5 characters. Then, before
//!   anything else, a read whose reply has another shape than all that are still owed: another function
//!   or another count. A device answers in order; once *that* reply comes, no older one can follow.
//!
//! Handles of one RTU line may have units of their own. A reply shows its unit, so that a late one is never taken for
//! that of another unit; the line is cleared before the next request to the unit that owes it.
//!
//! Before each RTU request the silence is kept as well, and whatever comes meanwhile (a reply sent
//! twice) is thrown away. What remains: a reply that comes twice, the second time after the next
//! request has gone out. Registers that count (a sequence, a heartbeat) must bind a value to its time.
//!
//! A request is sent once. A write without an answer is never repeated by the link: whether it
//! arrived is not known, and the caller decides by what the device counts
//! ([`ModbusError::may_have_arrived`]).

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use tokio::sync::{mpsc, oneshot};

mod allowed;
mod ask;
mod device;
mod error;
mod exchange;
mod inbox;
mod line;
mod owner;
#[cfg(test)]
mod tests;
pub mod value;
mod wire;

pub use allowed::{Allowed, Range};
pub use device::{Device, DeviceKeys};
pub use error::ModbusError;
pub use line::{Framing, Line, Parity};

use ask::Ask;

/// The four address spaces of a device. A bit counts as a register that is 0 or 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Space {
    Holding,
    Input,
    Coil,
    Discrete,
}

/// How a device is spoken to.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The unit identifier: RTU 1 to 247; TCP 255 unless a gateway forwards by it.
    pub unit: u8,
    /// How long an answer may take.
    pub timeout: Duration,
    pub allowed: Allowed,
}

/// The handle.
pub struct Modbus {
    name: String,
    settings: Arc<Settings>,
    jobs: mpsc::UnboundedSender<Job>,
    urgent: mpsc::UnboundedSender<Ahead>,
}

/// Leads to an open line, and does not keep it open.
pub(super) struct WeakModbus {
    name: String,
    jobs: mpsc::WeakUnboundedSender<Job>,
    urgent: mpsc::WeakUnboundedSender<Ahead>,
}

impl WeakModbus {
    /// One more handle, to the device of `settings`; `None` where the line is closed.
    pub(super) fn upgrade(&self, settings: Settings) -> Option<Modbus> {
        let (jobs, urgent) = (self.jobs.upgrade()?, self.urgent.upgrade()?);
        Some(Modbus { name: self.name.clone(), settings: Arc::new(settings), jobs, urgent })
    }
}

/// One write that goes ahead of everything that is queued, from any thread, without blocking: a hold.
///
/// It waits for the request that is under way: over TCP 20 ms at most (then that one's connection is
/// given up), over RTU until its answer or its time-out, as two requests at once would spoil each
/// other. It is sent once, and nobody is told how it ended: look at the device.
#[derive(Clone)]
pub struct Urgent {
    ask: Ask,
    settings: Arc<Settings>,
    queue: mpsc::UnboundedSender<Ahead>,
}

struct Job {
    ask: Ask,
    /// Of the device that it is for.
    settings: Arc<Settings>,
    /// A write is read back.
    read_back: bool,
    answer: oneshot::Sender<Result<Vec<u16>, ModbusError>>,
}

struct Ahead {
    ask: Ask,
    settings: Arc<Settings>,
    last: bool,
}

impl Urgent {
    pub fn send(&self) {
        self.queue(false);
    }

    /// As `send`, and every other write that is queued or will be is refused
    /// ([`ModbusError::Held`]); reads go on.
    pub fn send_and_close(&self) {
        self.queue(true);
    }

    fn queue(&self, last: bool) {
        let (ask, settings) = (self.ask.clone(), self.settings.clone());
        let _ = self.queue.send(Ahead { ask, settings, last });
    }
}

impl Modbus {
    /// Open `line` on the thread that will own it. A connection that is lost later is opened anew by
    /// the next request.
    ///
    /// # Errors
    /// What opening says; whether a device answers shows with the first request.
    pub async fn open(line: Line, settings: Settings) -> Result<Self, ModbusError> {
        let name = line.to_string();
        let (jobs, queue) = mpsc::unbounded_channel();
        let (urgent, urgent_queue) = mpsc::unbounded_channel();
        owner::start(line, owner::Ends { queue, urgent_queue }).await?;
        Ok(Self { name, settings: Arc::new(settings), jobs, urgent })
    }

    pub(super) fn downgrade(&self) -> WeakModbus {
        let (jobs, urgent) = (self.jobs.downgrade(), self.urgent.downgrade());
        WeakModbus { name: self.name.clone(), jobs, urgent }
    }

    /// `count` registers from `address` on (counted from 0).
    ///
    /// # Errors
    /// See [`ModbusError`].
    pub async fn read(
        &self,
        space: Space,
        address: u16,
        count: u16,
    ) -> Result<Vec<u16>, ModbusError> {
        self.ask(Ask::Read { space, address, count }, false).await
    }

    /// Write holding registers from `address` on, then read them back.
    ///
    /// # Errors
    /// See [`ModbusError`]; [`ModbusError::NotAsWritten`] when the device keeps something else.
    pub async fn write(&self, address: u16, words: &[u16]) -> Result<(), ModbusError> {
        self.ask(Ask::Write { address, words: words.to_vec() }, true).await.map(drop)
    }

    /// As `write`, of registers that the device clears itself: nothing is read back.
    ///
    /// # Errors
    /// See [`ModbusError`].
    pub async fn write_without_echo(&self, address: u16, words: &[u16]) -> Result<(), ModbusError> {
        self.ask(Ask::Write { address, words: words.to_vec() }, false).await.map(drop)
    }

    /// Make a write ready that will overtake all others.
    ///
    /// # Errors
    /// It is not allowed.
    pub fn urgent(&self, address: u16, words: &[u16]) -> Result<Urgent, ModbusError> {
        let ask = Ask::Write { address, words: words.to_vec() };
        self.settings.allowed.check(&ask)?;
        let (settings, queue) = (self.settings.clone(), self.urgent.clone());
        Ok(Urgent { ask, settings, queue })
    }

    async fn ask(&self, ask: Ask, read_back: bool) -> Result<Vec<u16>, ModbusError> {
        self.settings.allowed.check(&ask)?;
        let ended = || ModbusError::Ended { link: self.name.clone() };
        let (answer, result) = oneshot::channel();
        let settings = self.settings.clone();
        self.jobs.send(Job { ask, settings, read_back, answer }).map_err(|_| ended())?;
        result.await.map_err(|_| ended())?
    }
}
