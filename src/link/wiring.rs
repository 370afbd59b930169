//! Connection between a link and its device: direct, recorded by a capture, or replaced by a capture. It applies to
//! all links that are opened while a future runs, so drivers contain no code for it.

use std::pin::Pin;

use tokio::io::{AsyncRead, AsyncWrite};

use super::LinkError;
use super::capture::{Capture, LinkProtocol, LinkRecorder};
use super::replay::{Player, Replay};

pub(super) trait Stream: AsyncRead + AsyncWrite + Send {}
impl<S: AsyncRead + AsyncWrite + Send> Stream for S {}

pub(super) type Boxed = Pin<Box<dyn Stream>>;

#[derive(Clone, Default)]
pub enum Wiring {
    #[default]
    Plain,
    Captured(Capture),
    /// No device is opened: a capture answers.
    Replayed(Replay),
}

tokio::task_local! {
    static WIRING: Wiring;
}

impl Wiring {
    /// Runs `opening`; this wiring applies to the links that it opens, until they are closed.
    pub async fn during<F: Future>(self, opening: F) -> F::Output {
        WIRING.scope(self, opening).await
    }

    /// Wiring of the running future.
    pub fn current() -> Self {
        WIRING.try_with(Self::clone).unwrap_or_default()
    }

    pub fn is_replayed(&self) -> bool {
        matches!(self, Self::Replayed(_))
    }

    /// Wiring of the link `name`, which may be opened more than once.
    pub(super) fn of(&self, name: &str, speech: LinkProtocol) -> Wired {
        match self {
            Self::Plain => Wired::Plain,
            Self::Captured(capture) => Wired::RecordedStream(capture.tap(name, speech)),
            Self::Replayed(replay) => Wired::Played(replay.player(name, speech)),
        }
    }
}

/// Wiring of one link.
pub(super) enum Wired {
    Plain,
    RecordedStream(LinkRecorder),
    Played(Player),
}

impl Wired {
    /// Opens the device, unless a capture replaces it.
    pub(super) async fn open<S: Stream + 'static>(
        &self,
        open: impl Future<Output = Result<S, LinkError>>,
    ) -> Result<Boxed, LinkError> {
        Ok(match self {
            Self::Plain => Box::pin(open.await?),
            Self::RecordedStream(tap) => Box::pin(tap.on(open.await?)),
            Self::Played(player) => Box::pin(player.stream()),
        })
    }
}
