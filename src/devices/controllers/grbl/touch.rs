//! One probing move and its result, and where the machine stands afterwards.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::check;
use super::driver::Grbl;
use super::message::{Message, Status};
use crate::controllers::ControllerError;
use crate::controllers::arrival::moved_by_hand;
use crate::controllers::lines::Lines;
use machine::{Axis, Position};

/// A probe may bounce this long after it came free.
const SETTLE: Duration = Duration::from_millis(300);

/// The result of a probing move as the control tells it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Touch {
    /// In the order of the control's reports, mm and degrees.
    pub values: Vec<f64>,
    pub hit: bool,
    pub t_s: Option<f64>,
}

/// The one result among what was said.
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
    /// A probing line: its result stands between the line and its `ok`.
    pub(super) async fn probe(&mut self, lines: &Lines<'_>) -> Result<Touch, ControllerError> {
        let step = lines.step;
        let said = self.send(lines).await.map_err(|error| match error {
            ControllerError::Alarm { code: 4, .. } => ControllerError::StillTripped { step },
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        touch_of(&said)
    }

    /// The control tells a touch again on `$#`: both must be the same to the last digit, and lie on
    /// the way that the machine came.
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
            return Err(ControllerError::Doubtful { step, first, again });
        }
        let contact = contact.only(|axis| axis != Axis::S);
        let astray = check::off_the_way(&from, &self.stood, &contact, |axis| self.tolerance(axis));
        astray.map_or(Ok(status), Err)
    }

    /// Wait until the machine stands, and see that it stands where it was sent.
    pub(super) async fn arrive(&mut self, target: &Position) -> Result<Status, ControllerError> {
        let deadline = Instant::now() + self.wire.patience.aftermath;
        let target = target.only(|axis| axis != Axis::S);
        loop {
            let status = self.wire.idle().await?;
            self.stood = self.stands(&status)?;
            match check::astray(&target, &self.stood, |axis| self.tolerance(axis)) {
                None => return Ok(status),
                // The reports may be older than the motion.
                Some(error) if Instant::now() > deadline => return Err(error),
                Some(_) => sleep(self.wire.patience.poll / 10).await,
            }
        }
    }

    /// The machine still stands where it was last seen to stand. Who says otherwise is asked again: a
    /// report may have been altered on its way.
    pub(super) async fn unmoved(&mut self, stands: &Position) -> Result<(), ControllerError> {
        let stood = self.stood.clone();
        if check::astray(&stood, stands, |axis| self.tolerance(axis)).is_none() {
            return Ok(());
        }
        self.arrive(&stood).await.map(drop).map_err(moved_by_hand)
    }

    pub(super) fn tolerance(&self, axis: Axis) -> f64 {
        // Axes that the machine file does not name do not matter.
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

    /// The probe reads open in the status just `seen`, or does so before long.
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
