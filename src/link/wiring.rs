//! What lies between a link and its device: nothing, a capture, or a capture instead of the device.
//! It holds for whatever is opened while a future runs, so that no driver knows of it.

use std::pin::Pin;

use tokio::io::{AsyncRead, AsyncWrite};

use super::LinkError;
use super::capture::{Capture, Speech, Tap};
use super::replay::{Player, Replay};

pub(super) trait Stream: AsyncRead + AsyncWrite + Send {}
impl<S: AsyncRead + AsyncWrite + Send> Stream for S {}

pub(super) type Boxed = Pin<Box<dyn Stream>>;

#[derive(Clone, Default)]
pub enum Wiring {
    #[default]
    Plain,
    Captured(Capture),
    /// Nothing is opened: a capture answers.
    Replayed(Replay),
}

tokio::task_local! {
    static WIRING: Wiring;
}

impl Wiring {
    /// Run `opening`; the links that it opens are wired so, to their end.
    pub async fn during<F: Future>(self, opening: F) -> F::Output {
        WIRING.scope(self, opening).await
    }

    /// That of the future that runs.
    pub fn current() -> Self {
        WIRING.try_with(Self::clone).unwrap_or_default()
    }

    pub fn is_replayed(&self) -> bool {
        matches!(self, Self::Replayed(_))
    }

    /// For the link `name`, which may be opened more than once.
    pub(super) fn of(&self, name: &str, speech: Speech) -> Wired {
        match self {
            Self::Plain => Wired::Plain,
            Self::Captured(capture) => Wired::Tapped(capture.tap(name, speech)),
            Self::Replayed(replay) => Wired::Played(replay.player(name, speech)),
        }
    }
}

/// One link's wiring.
pub(super) enum Wired {
    Plain,
    Tapped(Tap),
    Played(Player),
}

impl Wired {
    /// Open the device, unless a capture answers instead.
    pub(super) async fn open<S: Stream + 'static>(
        &self,
        open: impl Future<Output = Result<S, LinkError>>,
    ) -> Result<Boxed, LinkError> {
        Ok(match self {
            Self::Plain => Box::pin(open.await?),
            Self::Tapped(tap) => Box::pin(tap.on(open.await?)),
            Self::Played(player) => Box::pin(player.stream()),
        })
    }
}
