//! Thread that owns a connection, and the order in which it sends requests.

use std::io;

use tokio::sync::{mpsc, oneshot};

use super::access::RegisterAccess;
use super::exchange::ModbusExchange;
use super::urgent_queue::UrgentQueue;
use super::{DeviceSettings, ModbusError, ModbusLine, QueuedAccess, RegisterSpace, UrgentWrite};
use crate::LinkError;
use crate::mode::LinkMode;

/// Receiving ends of the handles' channels.
pub(super) struct ChannelEnds {
    pub(super) queue: mpsc::UnboundedReceiver<QueuedAccess>,
    pub(super) urgent_queue: mpsc::UnboundedReceiver<UrgentWrite>,
}

/// Starts the thread, which opens its line.
pub(super) async fn start_owner_thread(line: ModbusLine, ends: ChannelEnds) -> Result<(), ModbusError> {
    let name = line.to_string();
    let open_error = |source| LinkError::OpenFailed { address: name.clone(), source };
    let (opened, result) = oneshot::channel();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(open_error)?;
    let backend = LinkMode::current().for_link(&name, line.protocol());
    let owner_task = async move {
        let mut exchange = ModbusExchange::new(line, backend);
        if let Err(error) = exchange.open().await {
            return drop(opened.send(Err(error)));
        }
        let _ = opened.send(Ok(()));
        let urgent_queue = UrgentQueue::new(ends.urgent_queue);
        LineOwner { exchange, urgent_queue, is_held: false }.run(ends.queue).await;
    };
    std::thread::Builder::new()
        .name("modbus".to_owned())
        .spawn(move || runtime.block_on(owner_task))
        .map_err(open_error)?;
    result.await.map_err(|_| open_error(io::Error::other("the thread of the link has ended")))?
}

struct LineOwner {
    exchange: ModbusExchange,
    urgent_queue: UrgentQueue,
    /// After a hold, only urgent writes are sent.
    is_held: bool,
}

impl LineOwner {
    /// Runs until the handle is dropped; an urgent write that is queued at the end is still sent.
    async fn run(mut self, mut queue: mpsc::UnboundedReceiver<QueuedAccess>) {
        loop {
            tokio::select! {
                biased;
                () = self.urgent_queue.wait_for_write() => self.send_urgent_writes().await,
                job = queue.recv() => match job {
                    Some(job) => self.handle_access(job).await,
                    None => break,
                },
            }
        }
        if self.urgent_queue.has_write() {
            self.send_urgent_writes().await;
        }
    }

    async fn send_urgent_writes(&mut self) {
        while let Some(UrgentWrite { access, settings, blocks_writes }) = self.urgent_queue.pop() {
            self.is_held |= blocks_writes;
            self.exchange.perform_urgent(&access, &settings, &mut self.urgent_queue).await;
        }
    }

    async fn handle_access(&mut self, job: QueuedAccess) {
        let QueuedAccess { access, settings, read_back, reply } = job;
        let result = match (&access, self.is_held) {
            (RegisterAccess::Write { .. }, true) => Err(ModbusError::HoldActive { request: access.to_string() }),
            (RegisterAccess::Write { address, words }, false) if read_back => {
                self.write_and_verify(&access, &settings, *address, words).await
            }
            _ => self.exchange.perform(&access, &settings, &mut self.urgent_queue).await,
        };
        // If the caller no longer waits, the request was sent nevertheless.
        let _ = reply.send(result);
    }

    /// Writes, then reads back.
    async fn write_and_verify(
        &mut self,
        access: &RegisterAccess,
        settings: &DeviceSettings,
        address: u16,
        words: &[u16],
    ) -> Result<Vec<u16>, ModbusError> {
        let request = access.to_string();
        self.exchange.perform(access, settings, &mut self.urgent_queue).await?;
        let count = u16::try_from(words.len()).unwrap_or(u16::MAX);
        let back = RegisterAccess::Read { space: RegisterSpace::Holding, address, count };
        match self.exchange.perform(&back, settings, &mut self.urgent_queue).await {
            Ok(read) if read == words => Ok(read),
            Ok(read) => Err(ModbusError::ReadBackDiffers { request, written: words.to_vec(), read }),
            Err(source) => Err(ModbusError::ReadBackFailed { request, source: Box::new(source) }),
        }
    }
}
