//! Queue of urgent writes.

use std::collections::VecDeque;

use tokio::sync::mpsc;

use super::UrgentWrite;

/// Queue of urgent writes, which can be checked during a request.
pub(super) struct Inbox {
    queue: mpsc::UnboundedReceiver<UrgentWrite>,
    waiting: VecDeque<UrgentWrite>,
}

impl Inbox {
    pub(super) fn new(queue: mpsc::UnboundedReceiver<UrgentWrite>) -> Self {
        Self { queue, waiting: VecDeque::new() }
    }

    /// Waits until an urgent write is queued. Cancel safe.
    pub(super) async fn come(&mut self) {
        if self.has_come() {
            return;
        }
        match self.queue.recv().await {
            Some(ahead) => self.waiting.push_back(ahead),
            None => std::future::pending().await,
        }
    }

    pub(super) fn has_come(&mut self) -> bool {
        while let Ok(ahead) = self.queue.try_recv() {
            self.waiting.push_back(ahead);
        }
        !self.waiting.is_empty()
    }

    /// Removes the oldest urgent write.
    pub(super) fn pop(&mut self) -> Option<UrgentWrite> {
        self.waiting.pop_front()
    }
}
