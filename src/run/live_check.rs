//! Test of the probe before the first approach of a new or a resumed run.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::{Run, RunError};
use devices::controllers::ControllerError;
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::event::RunEvent;
use machine::record::machine::LiveCheck;

/// Maximum wait for the operator to deflect the stylus, and again to release it.
const STYLUS_TIMEOUT: Duration = Duration::from_secs(60);
const STYLUS_POLL_PERIOD: Duration = Duration::from_millis(20);

impl Run<'_> {
    /// Announces that the first touch tests the probe, and returns `None`; or waits until the operator has deflected
    /// and released the stylus, and returns the position, as the operator may have moved the machine.
    ///
    /// # Errors
    /// The stylus was not deflected and released in time, or the machine is halted.
    pub(super) async fn announce_or_await_probe_check(&mut self) -> Result<Option<Position>, RunError> {
        match self.plan.probe.live_check {
            LiveCheck::Touch => {
                let mut text = "until touches in three directions have confirmed the positions of X, Y and \
                    Z, the machine travels at the upper end of Z and at low speed. The first touch tests \
                    the probe: keep the emergency stop within reach"
                    .to_owned();
                if let Artefact::Cylinder(_) = self.plan.artefact {
                    text += " (a round part does not confirm the positions of the rotary axes)";
                }
                self.record_event(RunEvent::OperatorMessage { text }).await?;
                Ok(None)
            }
            LiveCheck::Person => {
                let seconds = STYLUS_TIMEOUT.as_secs();
                let text = format!("deflect the stylus by hand and release it within {seconds} s");
                self.record_event(RunEvent::OperatorMessage { text }).await?;
                self.wait_for_probe_input(true).await?;
                self.wait_for_probe_input(false).await?;
                self.is_probe_confirmed = true;
                self.record_event(RunEvent::OperatorMessage { text: "the probe works".to_owned() }).await?;
                // The operator may have moved the machine, and changed modes, offsets or overrides.
                Ok(Some(self.devices.open_controller.prepare().await?.position))
            }
        }
    }

    /// Waits until the probe input is closed, or open if `is_closed` is false.
    async fn wait_for_probe_input(&mut self, is_closed: bool) -> Result<(), RunError> {
        let deadline = Instant::now() + STYLUS_TIMEOUT;
        let controller = &self.devices.open_controller;
        loop {
            if controller.halt_handle().is_halt_requested() {
                return Err(ControllerError::Halted.into());
            }
            if controller.read_snapshot().await?.is_probe_closed == is_closed {
                return Ok(());
            }
            if Instant::now() > deadline {
                return Err(RunError::StylusTimeout { expects_closed: is_closed, seconds: STYLUS_TIMEOUT.as_secs() });
            }
            sleep(STYLUS_POLL_PERIOD).await;
        }
    }
}
