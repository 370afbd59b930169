//! Connection between a link and its device: direct, recorded by a capture, or replaced by a capture. The mode
//! applies to all links that are opened while a future runs, so drivers contain no code for it.

use super::LinkError;
use super::boxed_stream::BoxedStream;
use super::capture::{CaptureWriter, LinkProtocol, LinkRecorder};
use super::replay::{CaptureReplay, LinkReplay};

/// How the links of a future are connected to their devices.
#[derive(Clone, Default)]
pub enum LinkMode {
    #[default]
    Direct,
    /// The device is opened; the bytes in both directions are also written to the capture.
    Captured(CaptureWriter),
    /// No device is opened: a capture answers.
    Replayed(CaptureReplay),
}

tokio::task_local! {
    static LINK_MODE: LinkMode;
}

impl LinkMode {
    /// Runs `opening`. The mode applies to the links that `opening` opens, until they are closed.
    pub async fn apply_to<F: Future>(self, opening: F) -> F::Output {
        LINK_MODE.scope(self, opening).await
    }

    /// Mode of the running future; `Direct` outside of `apply_to`.
    pub fn current() -> Self {
        LINK_MODE.try_with(Self::clone).unwrap_or_default()
    }

    pub fn is_replayed(&self) -> bool {
        matches!(self, Self::Replayed(_))
    }

    /// Backend of the link `name`, which may be opened more than once. Each call counts as a new link of the capture.
    pub(super) fn backend_for_link(&self, name: &str, protocol: LinkProtocol) -> LinkBackend {
        match self {
            Self::Direct => LinkBackend::Direct,
            Self::Captured(capture) => LinkBackend::Recorded(capture.create_link_recorder(name, protocol)),
            Self::Replayed(replay) => LinkBackend::Replayed(replay.take_link_replay(name, protocol)),
        }
    }
}

/// How one link is connected to its device.
pub(super) enum LinkBackend {
    Direct,
    Recorded(LinkRecorder),
    Replayed(LinkReplay),
}

impl LinkBackend {
    pub(super) fn is_replayed(&self) -> bool {
        matches!(self, Self::Replayed(_))
    }

    /// Records that the link is opened; does nothing unless the link is recorded.
    pub(super) fn record_opening(&self) {
        if let Self::Recorded(recorder) = self {
            recorder.record_opening();
        }
    }

    /// Records `bytes` after `mark` (`>` sent, `<` received); does nothing unless the link is recorded.
    pub(super) fn record_bytes(&self, mark: char, bytes: &[u8]) {
        if let Self::Recorded(recorder) = self {
            recorder.record_bytes(mark, bytes);
        }
    }

    /// Opens the device, unless a capture replaces it.
    pub(super) async fn open(
        &self,
        open: impl Future<Output = Result<BoxedStream, LinkError>>,
    ) -> Result<BoxedStream, LinkError> {
        Ok(match self {
            Self::Direct => open.await?,
            Self::Recorded(recorder) => Box::pin(recorder.wrap_stream(open.await?)),
            Self::Replayed(link_replay) => Box::pin(link_replay.stream()),
        })
    }
}
