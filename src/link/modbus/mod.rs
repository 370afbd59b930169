//! Client of Modbus registers, over RTU and TCP. One thread owns the connection. The handle is a channel, so that a
//! dropped future never interrupts a request.
//!
//! **The hazard.** An RTU reply does not identify its request. After a timeout, the late reply stays in the line,
//! and a client that sends another request takes it for the new reply; from then on every value is one request old.
//! Therefore, after *any* timeout or unexpected reply:
//! - The context that waited is dropped, with all bytes that it has read.
//! - TCP: the connection is closed and reopened. A reply contains its transaction number, and a new connection has
//!   no old replies.
//! - RTU: the link waits until the line has been silent for 3.5 characters. Then it first sends a read whose reply
//!   differs in function or count from all replies that are still pending. A device answers in order: after the reply
//!   to this read, no older reply can follow.
//!
//! Handles of one RTU line may have different units. A reply contains its unit, so a late reply is never taken for
//! a reply of another unit. The line is cleared before the next request to the unit whose reply is pending.
//!
//! The link also keeps the silence before each RTU request, and drops bytes that arrive meanwhile (a reply sent
//! twice). One risk remains: a duplicate reply that arrives after the next request was sent. Therefore each reply
//! should contain a counter (a sequence, a heartbeat) that shows whether its values are new.
//!
//! A request is sent once. The link never repeats a write without a reply: it is unknown whether the write has
//! arrived, and the caller must read the device's counter before it repeats the write.

use std::sync::{Arc, Weak};
use std::time::Duration;

use serde::Deserialize;
use tokio::sync::{mpsc, oneshot};

mod access_list;
mod device_config;
mod drainable_stream;
mod error;
mod exchange;
mod framing;
mod line_config;
mod line_owner;
pub mod number_format;
mod register_access;
#[cfg(test)]
mod tests;
mod urgent_queue;

pub use access_list::{AccessList, RegisterRange};
pub use device_config::{ModbusDeviceConfig, ModbusDeviceKeys};
pub use error::ModbusError;
pub use framing::Framing;
pub use line_config::{ModbusLineConfig, Parity};

use register_access::RegisterAccess;

/// The four address spaces of a device. A bit counts as a register with the value 0 or 1. Default: the input
/// registers, which hold measured values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RegisterSpace {
    Holding,
    #[default]
    Input,
    Coil,
    Discrete,
}

impl RegisterSpace {
    /// Whether the space has single bits instead of registers of 16 bits.
    fn has_bits(self) -> bool {
        matches!(self, Self::Coil | Self::Discrete)
    }
}

/// Settings of a Modbus device.
#[derive(Debug, Clone)]
pub struct DeviceSettings {
    /// The unit identifier: RTU 1 to 247; TCP 255, unless a gateway needs it to select the device.
    pub unit: u8,
    /// Maximum time until the reply.
    pub timeout: Duration,
    /// Registers that this program may access; other requests are refused before they are sent.
    pub access_list: AccessList,
}

/// Handle of a Modbus device.
pub struct ModbusClient {
    settings: Arc<DeviceSettings>,
    line: Arc<OpenLine>,
}

/// Queues to the thread of an open line, which the handles of its devices share.
pub(super) struct OpenLine {
    name: String,
    access_queue: mpsc::UnboundedSender<QueuedAccess>,
    urgent_queue: mpsc::UnboundedSender<UrgentWrite>,
}

/// One write that overtakes all queued requests, for a hold. It can be sent from any thread, without blocking.
///
/// The write waits for the pending request: over TCP 20 ms at most (then the connection of that request is
/// dropped), over RTU until its reply or its timeout, because two requests at the same time would disturb each
/// other. It is sent once, and its result is not reported: check the device.
#[derive(Clone)]
pub struct UrgentWriteSender {
    access: RegisterAccess,
    settings: Arc<DeviceSettings>,
    urgent_queue: mpsc::UnboundedSender<UrgentWrite>,
}

struct QueuedAccess {
    access: RegisterAccess,
    /// Settings of the addressed device.
    settings: Arc<DeviceSettings>,
    /// Whether the registers are read back after the write and compared; false for a read.
    needs_read_back: bool,
    reply_sender: oneshot::Sender<Result<Vec<u16>, ModbusError>>,
}

struct UrgentWrite {
    access: RegisterAccess,
    settings: Arc<DeviceSettings>,
}

impl UrgentWriteSender {
    /// Sends the write. Ordinary writes to all devices of the line, queued or later, are refused
    /// ([`ModbusError::HoldActive`]); reads and further urgent writes continue.
    pub fn send_and_refuse_ordinary_writes(&self) {
        let _ = self.urgent_queue.send(UrgentWrite { access: self.access.clone(), settings: self.settings.clone() });
    }
}

impl ModbusClient {
    /// Opens `line` on the thread that will own it. After a loss, the next request reopens the connection.
    ///
    /// # Errors
    /// The line cannot be opened. Whether a device answers is known only after the first request.
    pub async fn open(line: ModbusLineConfig, settings: DeviceSettings) -> Result<Self, ModbusError> {
        let name = line.to_string();
        let (queue, accesses) = mpsc::unbounded_channel();
        let (urgent_queue, urgent_writes) = mpsc::unbounded_channel();
        line_owner::start_line_owner_thread(line, accesses, urgent_writes).await?;
        Ok(Self::from_open_line(Arc::new(OpenLine { name, access_queue: queue, urgent_queue }), settings))
    }

    /// Creates a handle for the device of `settings`.
    pub(super) fn from_open_line(line: Arc<OpenLine>, settings: DeviceSettings) -> Self {
        Self { settings: Arc::new(settings), line }
    }

    /// Returns a reference that does not keep the line open.
    pub(super) fn weak_line(&self) -> Weak<OpenLine> {
        Arc::downgrade(&self.line)
    }

    /// Reads `count` registers from `address` on (counted from 0).
    ///
    /// # Errors
    /// Any [`ModbusError`].
    pub async fn read(&self, space: RegisterSpace, address: u16, count: u16) -> Result<Vec<u16>, ModbusError> {
        self.perform(RegisterAccess::new_read(space, address, count), false).await
    }

    /// Writes holding registers from `address` on, then reads them back.
    ///
    /// # Errors
    /// Any [`ModbusError`]; [`ModbusError::ReadBackDiffers`] if the device holds another value afterwards.
    pub async fn write(&self, address: u16, words: &[u16]) -> Result<(), ModbusError> {
        self.perform(RegisterAccess::new_write(address, words), true).await.map(drop)
    }

    /// Like `write`, for registers that the device clears itself: they are not read back.
    ///
    /// # Errors
    /// Any [`ModbusError`].
    pub async fn write_without_read_back(&self, address: u16, words: &[u16]) -> Result<(), ModbusError> {
        self.perform(RegisterAccess::new_write(address, words), false).await.map(drop)
    }

    /// Prepares a write that will overtake all others; nothing is sent yet.
    ///
    /// # Errors
    /// The write is not allowed.
    pub fn prepare_urgent_write(&self, address: u16, words: &[u16]) -> Result<UrgentWriteSender, ModbusError> {
        let access = RegisterAccess::new_write(address, words);
        self.settings.access_list.check_access(&access)?;
        let (settings, queue) = (self.settings.clone(), self.line.urgent_queue.clone());
        Ok(UrgentWriteSender { access, settings, urgent_queue: queue })
    }

    /// Checks the access list, queues the access, and waits for its result. A queued access is performed even if the
    /// caller no longer waits.
    async fn perform(&self, access: RegisterAccess, needs_read_back: bool) -> Result<Vec<u16>, ModbusError> {
        self.settings.access_list.check_access(&access)?;
        let ended = || ModbusError::LinkThreadEnded { link: self.line.name.clone() };
        let (reply, result) = oneshot::channel();
        let queued = QueuedAccess { access, settings: self.settings.clone(), needs_read_back, reply_sender: reply };
        self.line.access_queue.send(queued).map_err(|_| ended())?;
        result.await.map_err(|_| ended())?
    }
}
