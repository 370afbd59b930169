//! Where the words of the daemon go: under systemd to the journal, with machine, run and step as fields
//! (`TRUED_RUN=17`); otherwise as plain lines to standard error.

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

use super::log::{Kind, Log};

/// Of each field of ours in the journal.
const PREFIX: &str = "TRUED";

/// From now on, for the whole process. In the journal each step of a run stands as well (debug).
pub fn start() -> Log {
    let journal = is_journal().then(tracing_journald::layer).and_then(Result::ok);
    let journal = journal.map(|layer| {
        layer.with_field_prefix(Some(PREFIX.to_owned())).with_filter(LevelFilter::DEBUG)
    });
    let words = journal.is_none().then(|| Words.with_filter(LevelFilter::INFO));
    // Begun already: then that goes on.
    let _ = tracing_subscriber::registry().with(journal).with(words).try_init();
    Log::new(|kind, words| match kind {
        Kind::Word => tracing::info!("{words}"),
        Kind::Fault => tracing::error!("{words}"),
    })
}

/// Whether standard error goes to systemd's journal (systemd.exec, `$JOURNAL_STREAM`).
fn is_journal() -> bool {
    let own = || {
        let stderr = std::io::stderr().as_fd().try_clone_to_owned().ok()?;
        let about = File::from(stderr).metadata().ok()?;
        Some(format!("{}:{}", about.dev(), about.ino()))
    };
    std::env::var("JOURNAL_STREAM").is_ok_and(|stream| own() == Some(stream))
}

/// Plain lines; nobody needs to read them.
struct Words;

impl<S: Subscriber> Layer<S> for Words {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut message = Message(String::new());
        event.record(&mut message);
        let _ = writeln!(std::io::stderr(), "{}", message.0);
    }
}

struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            let _ = write!(self.0, "{value:?}");
        }
    }
}
