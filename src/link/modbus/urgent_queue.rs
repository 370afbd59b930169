//! Queue of urgent writes.

use std::collections::VecDeque;

use tokio::sync::mpsc;

use super::UrgentWrite;

/// Queue of urgent writes, which can be checked during a request.
pub(super) struct UrgentQueue {
    incoming: mpsc::UnboundedReceiver<UrgentWrite>,
    /// Writes taken from `incoming` but not yet sent, the oldest first.
    received_writes: VecDeque<UrgentWrite>,
}

impl UrgentQueue {
    pub(super) fn new(incoming: mpsc::UnboundedReceiver<UrgentWrite>) -> Self {
        Self { incoming, received_writes: VecDeque::new() }
    }

    /// Waits until an urgent write is queued, without removing the write. Never returns once all senders are dropped.
    /// Cancel safe.
    pub(super) async fn wait_for_write(&mut self) {
        if self.has_write() {
            return;
        }
        match self.incoming.recv().await {
            Some(write) => self.received_writes.push_back(write),
            None => std::future::pending().await,
        }
    }

    pub(super) fn has_write(&mut self) -> bool {
        while let Ok(write) = self.incoming.try_recv() {
            self.received_writes.push_back(write);
        }
        !self.received_writes.is_empty()
    }

    /// Removes the oldest urgent write that `wait_for_write` or `has_write` has taken from the channel.
    pub(super) fn pop(&mut self) -> Option<UrgentWrite> {
        self.received_writes.pop_front()
    }
}
