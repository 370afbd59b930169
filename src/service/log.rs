//! Log lines of the daemon.

use std::sync::Arc;

/// Severity of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    Info,
    /// An error that needs attention.
    Error,
}

type LogSink = dyn Fn(LogLevel, &str) + Send + Sync;

/// Sink of the daemon's log lines; cloneable and usable from any thread.
#[derive(Clone)]
pub struct Log(Arc<LogSink>);

impl Log {
    pub fn new(sink: impl Fn(LogLevel, &str) + Send + Sync + 'static) -> Self {
        Self(Arc::new(sink))
    }

    pub fn info(&self, line: &str) {
        (self.0)(LogLevel::Info, line);
    }

    pub fn error(&self, line: &str) {
        (self.0)(LogLevel::Error, line);
    }

    /// A log that puts the machine's name before each line.
    pub fn with_machine_prefix(&self, name: String) -> Self {
        let log = self.clone();
        Self::new(move |severity, line| (log.0)(severity, &format!("{name}: {line}")))
    }
}
