//! One probing move and its result, and the position of the machine afterwards.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::check;
use super::driver::Grbl;
use super::message::{Message, Status};
use crate::controllers::ControllerError;
use crate::controllers::arrival::moved_by_hand;
use crate::controllers::lines::Lines;
use machine::{Axis, Position};

/// Maximum time that a probe bounces after it has come free.
const SETTLE: Duration = Duration::from_millis(300);

/// Result of a probing move as the control reports it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Touch {
    /// Axis values in the order of the control's reports, mm and degrees.
    pub values: Vec<f64>,
    pub hit: bool,
    pub t_s: Option<f64>,
}

/// Returns the result of the probing move; there must be exactly one among the messages.
fn touch_of(said: &[Message]) -> Result<Touch, ControllerError> {
    let mut found = None;
    let mut t_s = None;
    for message in said {
        match message {
            Message::Touch { values, hit } if found.is_none() => {
                found = Some((values.clone(), *hit));
            }
            Message::Touch { .. } => {
                let text = format!("two results of one probing move: {said:?}");
                return Err(ControllerError::Garbled { text });
            }
            Message::Time(stamp) => t_s = Some(*stamp),
            _ => {}
        }
    }
    let (values, hit) = found.ok_or_else(|| ControllerError::Garbled {
        text: format!("no [PRB:..] before ok, but {said:?}"),
    })?;
    Ok(Touch { values, hit, t_s })
}

impl Grbl {
    /// Sends a probing line; its result comes between the line and its `ok`.
    pub(super) async fn probe(&mut self, lines: &Lines<'_>) -> Result<Touch, ControllerError> {
        let step = lines.step;
        let said = self.send(lines).await.map_err(|error| match error {
            ControllerError::Alarm { code: 4, .. } => ControllerError::StillTripped { step },
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        touch_of(&said)
    }

    /// Reads the touch again from `$#`: both results must be equal to the last digit, and the contact must
    /// be on the path of the move.
    pub(super) async fn confirm(
        &mut self,
        step: u32,
        said: &Touch,
        contact: &Position,
    ) -> Result<Status, ControllerError> {
        let from = self.stood.clone();
        let status = self.wire.idle().await?;
        self.stood = self.stands(&status)?;
        let again = touch_of(&self.wire.ask("$#").await?)?;
        if again != *said {
            let (first, again) = (format!("{said:?}"), format!("{again:?}"));
            return Err(ControllerError::ContradictoryTouch { step, first, again });
        }
        let contact = contact.only(|axis| axis != Axis::S);
        let astray =
            check::contact_off_path(&from, &self.stood, &contact, |axis| self.tolerance(axis));
        astray.map_or(Ok(status), Err)
    }

    /// Waits until the machine is at rest, and checks that it is at its target.
    pub(super) async fn arrive(&mut self, target: &Position) -> Result<Status, ControllerError> {
        let deadline = Instant::now() + self.wire.patience.aftermath;
        let target = target.only(|axis| axis != Axis::S);
        loop {
            let status = self.wire.idle().await?;
            self.stood = self.stands(&status)?;
            match check::astray(&target, &self.stood, |axis| self.tolerance(axis)) {
                None => return Ok(status),
                // The status reports may be older than the end of the motion.
                Some(error) if Instant::now() > deadline => return Err(error),
                Some(_) => sleep(self.wire.patience.poll / 10).await,
            }
        }
    }

    /// Checks that the machine is still at its last rest position. A deviating report is read again: it may
    /// have been altered in transmission.
    pub(super) async fn unmoved(&mut self, stands: &Position) -> Result<(), ControllerError> {
        let stood = self.stood.clone();
        if check::astray(&stood, stands, |axis| self.tolerance(axis)).is_none() {
            return Ok(());
        }
        self.arrive(&stood).await.map(drop).map_err(moved_by_hand)
    }

    pub(super) fn tolerance(&self, axis: Axis) -> f64 {
        // Axes that the machine file does not name are not checked.
        self.tolerance.get(&axis).copied().unwrap_or(f64::INFINITY)
    }

    pub(super) fn stands(&self, status: &Status) -> Result<Position, ControllerError> {
        let values = status.position.as_ref().ok_or_else(|| ControllerError::NotReady {
            state: "its reports hide the machine position".to_owned(),
            remedy: "set $10=511 at the control".to_owned(),
        })?;
        self.position(values)
    }

    pub(super) fn position(&self, values: &[f64]) -> Result<Position, ControllerError> {
        if values.len() != self.axes.len() {
            return Err(ControllerError::Garbled { text: format!("[PRB:{values:?}]") });
        }
        let named = self.axes.iter().zip(values);
        let axes =
            named.filter_map(|(axis, value)| axis.map(|axis| (axis, axis.from_edge(*value))));
        let spindle = self.spindle.map(|s| (Axis::S, s));
        Ok(axes.chain(spindle).collect())
    }

    /// Waits until the probe reads open, first in the status `seen`; an error after `SETTLE`.
    pub(super) async fn open_probe(
        &mut self,
        step: u32,
        seen: &Status,
    ) -> Result<(), ControllerError> {
        let deadline = Instant::now() + SETTLE;
        let mut closed = seen.probe_closed;
        while closed {
            if Instant::now() > deadline {
                return Err(ControllerError::StillTripped { step });
            }
            sleep(SETTLE / 10).await;
            closed = self.wire.status().await?.probe_closed;
        }
        Ok(())
    }
}
