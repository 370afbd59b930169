//! Connection between a link and its device: direct, recorded by a capture, or replaced by a capture. It applies to
//! all links that are opened while a future runs, so drivers contain no code for it.

use super::LinkError;
use super::boxed_stream::BoxedStream;
use super::capture::{Capture, LinkProtocol, LinkRecorder};
use super::replay::{CaptureReplay, LinkReplay};

#[derive(Clone, Default)]
pub enum LinkMode {
    #[default]
    Direct,
    Captured(Capture),
    /// No device is opened: a capture answers.
    Replayed(CaptureReplay),
}

tokio::task_local! {
    static LINK_MODE: LinkMode;
}

impl LinkMode {
    /// Runs `opening`; this wiring applies to the links that it opens, until they are closed.
    pub async fn apply_to<F: Future>(self, opening: F) -> F::Output {
        LINK_MODE.scope(self, opening).await
    }

    /// Wiring of the running future.
    pub fn current() -> Self {
        LINK_MODE.try_with(Self::clone).unwrap_or_default()
    }

    pub fn is_replayed(&self) -> bool {
        matches!(self, Self::Replayed(_))
    }

    /// Wiring of the link `name`, which may be opened more than once.
    pub(super) fn for_link(&self, name: &str, protocol: LinkProtocol) -> LinkBackend {
        match self {
            Self::Direct => LinkBackend::Direct,
            Self::Captured(capture) => LinkBackend::Recorded(capture.recorder(name, protocol)),
            Self::Replayed(replay) => LinkBackend::Replayed(replay.link_replay(name, protocol)),
        }
    }
}

/// Wiring of one link.
pub(super) enum LinkBackend {
    Direct,
    Recorded(LinkRecorder),
    Replayed(LinkReplay),
}

impl LinkBackend {
    pub(super) fn is_replayed(&self) -> bool {
        matches!(self, Self::Replayed(_))
    }

    /// Records that the link is opened.
    pub(super) fn record_opening(&self) {
        if let Self::Recorded(recorder) = self {
            recorder.record_opening();
        }
    }

    pub(super) fn record(&self, mark: char, bytes: &[u8]) {
        if let Self::Recorded(recorder) = self {
            recorder.record(mark, bytes);
        }
    }

    /// Opens the device, unless a capture replaces it.
    pub(super) async fn open(
        &self,
        open: impl Future<Output = Result<BoxedStream, LinkError>>,
    ) -> Result<BoxedStream, LinkError> {
        Ok(match self {
            Self::Direct => open.await?,
            Self::Recorded(recorder) => Box::pin(recorder.record_stream(open.await?)),
            Self::Replayed(link_replay) => Box::pin(link_replay.stream()),
        })
    }
}
