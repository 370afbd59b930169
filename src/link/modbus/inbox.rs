//! The urgent writes that wait to go out.

use std::collections::VecDeque;

use tokio::sync::mpsc;

use super::Ahead;

/// Urgent writes: they are seen while a request is under way.
pub(super) struct Inbox {
    queue: mpsc::UnboundedReceiver<Ahead>,
    waiting: VecDeque<Ahead>,
}

impl Inbox {
    pub(super) fn new(queue: mpsc::UnboundedReceiver<Ahead>) -> Self {
        Self { queue, waiting: VecDeque::new() }
    }

    /// Wait until one is there. Can be given up without harm.
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

    /// The oldest that has come.
    pub(super) fn pop(&mut self) -> Option<Ahead> {
        self.waiting.pop_front()
    }
}
