//! One probing move and its result, and the position of the machine afterwards.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::driver::GrblDriver;
use super::message::{GrblMessage, GrblStatus};
use crate::controllers::ControllerError;
use crate::controllers::arrival::moved_between_blocks_error;
use crate::controllers::motion_lines::MotionLines;
use machine::Position;

/// Maximum time that a probe bounces after it has come free.
const MAX_PROBE_BOUNCE_TIME: Duration = Duration::from_millis(300);

/// Result of a probing move as the control reports it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ProbeResult {
    /// The position: a value for each axis in the order of the control's reports, mm and degrees.
    pub position_mm_or_deg: Vec<f64>,
    pub has_contact: bool,
    /// Time of the contact on the clock of the control, s; only the simulated control reports it.
    pub contact_time_s: Option<f64>,
}

/// Returns the result of the probing move; there must be exactly one among the messages.
fn single_probe_result(messages: &[GrblMessage]) -> Result<ProbeResult, ControllerError> {
    let mut found = None;
    let mut t_s = None;
    for message in messages {
        match message {
            GrblMessage::ProbeResult { values, has_contact } if found.is_none() => {
                found = Some((values.clone(), *has_contact));
            }
            GrblMessage::ProbeResult { .. } => {
                let text = format!("two results of one probing move: {messages:?}");
                return Err(ControllerError::UnreadableReply { text });
            }
            GrblMessage::ContactTime(stamp) => t_s = Some(*stamp),
            _ => {}
        }
    }
    let (values, has_contact) = found.ok_or_else(|| ControllerError::UnreadableReply {
        text: format!("no [PRB:..] before ok; received: {messages:?}"),
    })?;
    Ok(ProbeResult { position_mm_or_deg: values, has_contact, contact_time_s: t_s })
}

impl GrblDriver {
    /// Sends a probing line; its result comes between the line and its `ok`.
    pub(super) async fn execute_probing(&mut self, lines: &MotionLines<'_>) -> Result<ProbeResult, ControllerError> {
        let step = lines.step;
        let messages = self.send_lines(lines).await.map_err(|error| match error {
            ControllerError::Alarm { code: 4, .. } => ControllerError::ProbeStillClosed { step },
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        single_probe_result(&messages)
    }

    /// Reads the touch again from `$#`: both results must be equal to the last digit, and the contact must
    /// be on the path of the move.
    pub(super) async fn confirm_touch(
        &mut self,
        step: u32,
        first_result: &ProbeResult,
        contact: &Position,
    ) -> Result<GrblStatus, ControllerError> {
        let from = self.monitor.standstill_position.clone();
        let status = self.connection.wait_idle().await?;
        self.monitor.standstill_position = self.status_position(&status)?;
        let second = single_probe_result(&self.connection.send_line("$#").await?)?;
        if second != *first_result {
            let (first, second) = (format!("{first_result:?}"), format!("{second:?}"));
            return Err(ControllerError::TouchMismatch { step, first, second });
        }
        self.monitor.check_contact_on_path(&from, &self.monitor.standstill_position, contact)?;
        Ok(status)
    }

    /// Waits until the machine is at rest, and checks that it is at its target.
    pub(super) async fn wait_arrival(&mut self, target: &Position) -> Result<GrblStatus, ControllerError> {
        let deadline = Instant::now() + self.connection.timeouts.follow_up_timeout;
        loop {
            let status = self.connection.wait_idle().await?;
            self.monitor.standstill_position = self.status_position(&status)?;
            match self.monitor.check_standstill_position(target) {
                Ok(()) => return Ok(status),
                // The status reports may be older than the end of the motion.
                Err(error) if Instant::now() > deadline => return Err(error),
                Err(_) => sleep(self.connection.timeouts.poll_interval / 10).await,
            }
        }
    }

    /// Checks that the reported `position` is still the last rest position. If it deviates, the position is read
    /// again: the report may have been altered in transmission.
    pub(super) async fn check_position_unchanged(&mut self, position: &Position) -> Result<(), ControllerError> {
        let standstill_position = self.monitor.standstill_position.clone();
        if self.monitor.check_position(&standstill_position, position).is_ok() {
            return Ok(());
        }
        self.wait_arrival(&standstill_position).await.map(drop).map_err(moved_between_blocks_error)
    }

    pub(super) fn status_position(&self, status: &GrblStatus) -> Result<Position, ControllerError> {
        let missing = "the status reports do not contain the machine position";
        let values = status.machine_position.as_ref();
        self.position_from_axis_values(
            values.ok_or_else(|| ControllerError::not_ready(missing, "set $10=511 at the control"))?,
        )
    }

    /// Position from values in the order of the control's reports, with the orientation of the spindle; an error if
    /// their number is not that of the axes.
    pub(super) fn position_from_axis_values(&self, values: &[f64]) -> Result<Position, ControllerError> {
        if values.len() != self.axes_in_report_order.len() {
            return Err(ControllerError::UnreadableReply { text: format!("[PRB:{values:?}]") });
        }
        let named = self.axes_in_report_order.iter().zip(values);
        let axes = named.filter_map(|(axis, value)| axis.map(|axis| (axis, axis.to_mm_or_rad(*value))));
        Ok(self.monitor.with_spindle_orientation(axes))
    }

    /// Waits until the probe reads open, first in the status `last_status`; an error after `MAX_PROBE_BOUNCE_TIME`.
    pub(super) async fn wait_probe_open(&mut self, step: u32, last_status: &GrblStatus) -> Result<(), ControllerError> {
        let deadline = Instant::now() + MAX_PROBE_BOUNCE_TIME;
        let mut closed = last_status.is_probe_closed;
        while closed {
            if Instant::now() > deadline {
                return Err(ControllerError::ProbeStillClosed { step });
            }
            sleep(MAX_PROBE_BOUNCE_TIME / 10).await;
            closed = self.connection.read_status().await?.is_probe_closed;
        }
        Ok(())
    }
}
