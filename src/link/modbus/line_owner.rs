//! Thread that owns a connection, and the order in which it sends requests.

use tokio::sync::mpsc;

use super::exchange::ModbusExchange;
use super::register_access::RegisterAccess;
use super::urgent_queue::UrgentQueue;
use super::{DeviceSettings, ModbusError, ModbusLineConfig, QueuedAccess, RegisterSpace, UrgentWrite};
use crate::capture::LinkProtocol;
use crate::link_mode::LinkMode;
use crate::stream_owner::spawn_owner_thread;

/// Starts the thread, which opens its line and sends the requests of both queues.
pub(super) async fn start_line_owner_thread(
    line: ModbusLineConfig,
    queue: mpsc::UnboundedReceiver<QueuedAccess>,
    urgent_queue: mpsc::UnboundedReceiver<UrgentWrite>,
) -> Result<(), ModbusError> {
    let name = line.to_string();
    let backend = LinkMode::current().backend_for_link(&name, LinkProtocol::Modbus(line.framing));
    let opening = async move {
        let mut exchange = ModbusExchange::new(line, backend, UrgentQueue::new(urgent_queue));
        exchange.open().await.map(|()| exchange)
    };
    spawn_owner_thread("modbus", &name, opening, |exchange| LineOwner { exchange, is_hold_active: false }.run(queue))
        .await
}

struct LineOwner {
    exchange: ModbusExchange,
    /// Whether a hold was sent: from then on, until this thread ends, all writes except urgent ones are refused.
    /// Reads continue.
    is_hold_active: bool,
}

impl LineOwner {
    /// Runs until the handle is dropped; an urgent write that is queued at the end is still sent.
    async fn run(mut self, mut queue: mpsc::UnboundedReceiver<QueuedAccess>) {
        loop {
            tokio::select! {
                biased;
                () = self.exchange.urgent_queue.wait_for_write() => self.send_urgent_writes().await,
                job = queue.recv() => match job {
                    Some(job) => self.handle_access(job).await,
                    None => break,
                },
            }
        }
        if self.exchange.urgent_queue.has_write() {
            self.send_urgent_writes().await;
        }
    }

    /// Sends all queued urgent writes; from then on the hold is active.
    async fn send_urgent_writes(&mut self) {
        while let Some(UrgentWrite { access, settings }) = self.exchange.urgent_queue.pop() {
            self.is_hold_active = true;
            self.exchange.perform_urgent(&access, &settings).await;
        }
    }

    /// Performs one access and sends the result to its caller. A write is refused while a hold is active.
    async fn handle_access(&mut self, job: QueuedAccess) {
        let QueuedAccess { access, settings, needs_read_back: read_back, reply_sender: reply } = job;
        let result = match access.is_write() {
            true if self.is_hold_active => Err(ModbusError::HoldActive { request: access.to_string() }),
            true if read_back => self.write_and_verify(&access, &settings).await,
            _ => self.exchange.perform(&access, &settings).await,
        };
        // If the caller no longer waits, the request was sent nevertheless.
        let _ = reply.send(result);
    }

    /// Writes, then reads back and compares; returns the values read.
    async fn write_and_verify(
        &mut self,
        access: &RegisterAccess,
        settings: &DeviceSettings,
    ) -> Result<Vec<u16>, ModbusError> {
        self.exchange.perform(access, settings).await?;
        let request = access.to_string();
        let written = access.written_words.clone().unwrap_or_default();
        let back = RegisterAccess::new_read(RegisterSpace::Holding, access.address, access.register_or_bit_count);
        match self.exchange.perform(&back, settings).await {
            Ok(read) if read == written => Ok(read),
            Ok(read) => Err(ModbusError::ReadBackDiffers { request, written, read }),
            Err(source) => Err(ModbusError::ReadBackFailed { request, source: Box::new(source) }),
        }
    }
}
