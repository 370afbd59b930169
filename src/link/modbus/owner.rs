//! Thread that owns a connection, and the order in which it sends requests.

use std::io;

use tokio::sync::{mpsc, oneshot};

use super::ask::Ask;
use super::exchange::Exchange;
use super::inbox::Inbox;
use super::{Job, Line, ModbusError, Settings, Space, UrgentWrite};
use crate::LinkError;
use crate::wiring::Wiring;

/// Receiving ends of the handles' channels.
pub(super) struct Ends {
    pub(super) queue: mpsc::UnboundedReceiver<Job>,
    pub(super) urgent_queue: mpsc::UnboundedReceiver<UrgentWrite>,
}

/// Starts the thread, which opens its line.
pub(super) async fn start(line: Line, ends: Ends) -> Result<(), ModbusError> {
    let name = line.to_string();
    let fault = |source| LinkError::Open { address: name.clone(), source };
    let (opened, result) = oneshot::channel();
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(fault)?;
    let wired = Wiring::current().of(&name, line.speech());
    let own = async move {
        let mut exchange = Exchange::new(line, wired);
        if let Err(error) = exchange.open().await {
            return drop(opened.send(Err(error)));
        }
        let _ = opened.send(Ok(()));
        let inbox = Inbox::new(ends.urgent_queue);
        Owner { exchange, inbox, held: false }.run(ends.queue).await;
    };
    std::thread::Builder::new()
        .name("modbus".to_owned())
        .spawn(move || runtime.block_on(own))
        .map_err(fault)?;
    result.await.map_err(|_| fault(io::Error::other("its thread has ended")))?
}

struct Owner {
    exchange: Exchange,
    inbox: Inbox,
    /// After a hold, only urgent writes are sent.
    held: bool,
}

impl Owner {
    /// Runs until the handle is dropped; an urgent write that is queued at the end is still sent.
    async fn run(mut self, mut queue: mpsc::UnboundedReceiver<Job>) {
        loop {
            tokio::select! {
                biased;
                () = self.inbox.come() => self.go_ahead().await,
                job = queue.recv() => match job {
                    Some(job) => self.serve(job).await,
                    None => break,
                },
            }
        }
        if self.inbox.has_come() {
            self.go_ahead().await;
        }
    }

    async fn go_ahead(&mut self) {
        while let Some(UrgentWrite { ask, settings, last }) = self.inbox.pop() {
            self.held |= last;
            self.exchange.perform_now(&ask, &settings, &mut self.inbox).await;
        }
    }

    async fn serve(&mut self, job: Job) {
        let Job { ask, settings, read_back, answer } = job;
        let result = match (&ask, self.held) {
            (Ask::Write { .. }, true) => Err(ModbusError::Held { request: ask.to_string() }),
            (Ask::Write { address, words }, false) if read_back => {
                self.write(&ask, &settings, *address, words).await
            }
            _ => self.exchange.perform(&ask, &settings, &mut self.inbox).await,
        };
        // If the caller no longer waits, the request was sent nevertheless.
        let _ = answer.send(result);
    }

    /// Writes, then reads back.
    async fn write(
        &mut self,
        ask: &Ask,
        settings: &Settings,
        address: u16,
        words: &[u16],
    ) -> Result<Vec<u16>, ModbusError> {
        let request = ask.to_string();
        self.exchange.perform(ask, settings, &mut self.inbox).await?;
        let count = u16::try_from(words.len()).unwrap_or(u16::MAX);
        let back = Ask::Read { space: Space::Holding, address, count };
        match self.exchange.perform(&back, settings, &mut self.inbox).await {
            Ok(read) if read == words => Ok(read),
            Ok(read) => Err(ModbusError::NotAsWritten { request, written: words.to_vec(), read }),
            Err(source) => Err(ModbusError::NotReadBack { request, source: Box::new(source) }),
        }
    }
}
