//! Destination of the daemon's log. Under systemd: the systemd journal, with machine, run and step as fields
//! (`TRUED_RUN=17`). Otherwise: plain lines on standard error.

use std::fmt::{Debug, Write as _};
use std::fs::File;
use std::io::Write as _;
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;

use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

use super::log::{Log, LogLevel};

/// Prefix of the names of this program's fields in the systemd journal.
const SYSTEMD_JOURNAL_FIELD_PREFIX: &str = "TRUED";

/// Starts the log for the whole process. The systemd journal also gets each step of a run, at level debug.
pub fn start_log() -> Log {
    let journal = is_stderr_systemd_journal().then(tracing_journald::layer).and_then(Result::ok);
    let journal = journal.map(|layer| {
        layer.with_field_prefix(Some(SYSTEMD_JOURNAL_FIELD_PREFIX.to_owned())).with_filter(LevelFilter::DEBUG)
    });
    let plain_lines = journal.is_none().then(|| StderrLineLayer.with_filter(LevelFilter::INFO));
    // If a subscriber is already set, it stays in use.
    let _ = tracing_subscriber::registry().with(journal).with(plain_lines).try_init();
    Log::new(|severity, message| match severity {
        LogLevel::Info => tracing::info!("{message}"),
        LogLevel::Error => tracing::error!("{message}"),
    })
}

/// Whether standard error goes to systemd's journal (systemd.exec, `$JOURNAL_STREAM`).
fn is_stderr_systemd_journal() -> bool {
    let own = || {
        let stderr = std::io::stderr().as_fd().try_clone_to_owned().ok()?;
        let about = File::from(stderr).metadata().ok()?;
        Some(format!("{}:{}", about.dev(), about.ino()))
    };
    std::env::var("JOURNAL_STREAM").is_ok_and(|stream| own() == Some(stream))
}

/// Writes each message as a plain line to standard error; write errors are ignored.
struct StderrLineLayer;

impl<S: Subscriber> Layer<S> for StderrLineLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut message = MessageVisitor(String::new());
        event.record(&mut message);
        let _ = writeln!(std::io::stderr(), "{}", message.0);
    }
}

/// Collects the field `message` of an event; other fields are ignored.
struct MessageVisitor(String);

impl Visit for MessageVisitor {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            let _ = write!(self.0, "{value:?}");
        }
    }
}
