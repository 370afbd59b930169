//! What the daemon says to the person who reads its log.

use std::sync::Arc;

/// What a line is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Word,
    /// Somebody should see to it.
    Fault,
}

type Hears = dyn Fn(Kind, &str) + Send + Sync;

/// Cloneable; from any thread.
#[derive(Clone)]
pub struct Log(Arc<Hears>);

impl Log {
    pub fn new(hears: impl Fn(Kind, &str) + Send + Sync + 'static) -> Self {
        Self(Arc::new(hears))
    }

    pub fn say(&self, words: &str) {
        (self.0)(Kind::Word, words);
    }

    pub fn fault(&self, words: &str) {
        (self.0)(Kind::Fault, words);
    }

    /// With the machine's name before each line.
    pub fn of(&self, name: String) -> Self {
        let log = self.clone();
        Self::new(move |kind, words| (log.0)(kind, &format!("{name}: {words}")))
    }
}
