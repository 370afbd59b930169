//! Test of the probe before the first approach of a new or a resumed run.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::{Run, RunError};
use devices::controllers::ControllerError;
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::event::Event;
use machine::record::machine::LiveCheck;

/// Maximum wait for the operator to deflect the stylus, and again to release it.
const STYLUS_TIMEOUT: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(20);

impl Run<'_> {
    /// Tests the probe. Nothing moves here unless an operator who was asked to the machine moves it: then the
    /// present position is returned.
    ///
    /// # Errors
    /// The stylus was not deflected and released in time, or the machine is halted.
    pub(super) async fn live_check(&mut self) -> Result<Option<Position>, RunError> {
        match self.plan.probe.live_check {
            LiveCheck::Touch => {
                let mut text = "until touches in three directions have confirmed where X, Y and Z stand, \
                                they go by the upper end of Z, and nothing is fast; the first touch shows \
                                whether the probe lives: have the stop at hand"
                    .to_owned();
                if let Artefact::Cylinder(_) = self.plan.artefact {
                    text += " (a round part does not show where the rotary axes stand)";
                }
                self.note(Event::Announced { text }).await?;
                Ok(None)
            }
            LiveCheck::Person => {
                let seconds = STYLUS_TIMEOUT.as_secs();
                let text = format!("deflect the stylus by hand and let it go, within {seconds} s");
                self.note(Event::Announced { text }).await?;
                self.stylus(true).await?;
                self.stylus(false).await?;
                self.probe_lives = true;
                self.note(Event::Announced { text: "the probe lives".to_owned() }).await?;
                // The operator may have moved the machine, and changed modes, offsets or overrides.
                Ok(Some(self.devices.controller.prepare().await?.stands))
            }
        }
    }

    /// Waits until the probe input is `closed`.
    async fn stylus(&mut self, closed: bool) -> Result<(), RunError> {
        let deadline = Instant::now() + STYLUS_TIMEOUT;
        let controller = &self.devices.controller;
        loop {
            if controller.halt().is_halted() {
                return Err(ControllerError::Halted.into());
            }
            if controller.look().await?.probe_closed == closed {
                return Ok(());
            }
            if Instant::now() > deadline {
                return Err(RunError::DeadProbe { closed, seconds: STYLUS_TIMEOUT.as_secs() });
            }
            sleep(POLL).await;
        }
    }
}
