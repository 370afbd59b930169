//! Driver of a Grbl control: executes proven blocks and returns their outcomes.

use super::check;
use super::connection::GrblConnection;
use super::fault::is_at_rest_after;
use super::message::{GrblMessage, GrblStatus};
use super::timeouts::GrblTimeouts;
use crate::controllers::arrival::{self, AxisMonitor};
use crate::controllers::control_clock::ControlTimestamp;
use crate::controllers::motion_lines::{self, MotionLines};
use crate::controllers::{
    ControllerDriver, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot, PreparedControl, WorkOffset,
    WorkOffsetSlot, require_prepared,
};
use link::LineLink;
use machine::record::machine::{Homing, Machine};
use machine::record::motion::{Motion, MotionBlockOutcome};
use machine::{Axis, Position};
use planning::proof::{ProvenBlock, ProvenModeText};

/// Driver of one Grbl control.
pub struct GrblDriver {
    pub(super) connection: GrblConnection,
    pub(super) mode_text: ProvenModeText,
    pub(super) monitor: AxisMonitor,
    /// Axes with a homing switch by the machine file: the control must have homed them.
    pub(super) required_homed_axes: Vec<Axis>,
    /// Whether the control is prepared and no fault has occurred since.
    pub(super) is_prepared: bool,
    /// How a halt stops the machine, with its braking distances, in words.
    pub(super) stop_description: String,
    /// Axes in the order of the control's reports; `None` for an axis letter without a name in `trued`.
    pub(super) axes_in_report_order: Vec<Option<Axis>>,
    /// Maximum length of a line, bytes; `usize::MAX` until the control reports the length.
    pub(super) max_line_bytes: usize,
    /// Modal words before the first preparation, which `restore_modes` sends again; empty if none are stored.
    pub(super) initial_modes: Vec<String>,
}

impl GrblDriver {
    /// Creates a driver for `machine` on `link` that sets `modes`, and the handle that halts the machine. After a halt
    /// the link accepts no more lines: a new run opens a new link.
    pub fn new(link: LineLink, machine: &Machine, modes: ProvenModeText) -> (Self, HaltHandle) {
        let (connection, halt) = GrblConnection::new(link);
        let monitor = AxisMonitor::new(machine);
        let has_switch = |axis: &Axis| machine.axes.get(axis).is_some_and(|spec| spec.homing == Homing::Switch);
        let homed_axes = monitor.axes_without_spindle.iter().copied().filter(has_switch).collect();
        let grbl = Self {
            connection,
            mode_text: modes,
            monitor,
            required_homed_axes: homed_axes,
            is_prepared: false,
            stop_description: format!("feed hold (!): {}", arrival::describe_braking_distances(machine)),
            axes_in_report_order: Vec::new(),
            max_line_bytes: usize::MAX,
            initial_modes: Vec::new(),
        };
        (grbl, halt)
    }

    /// Replaces the default timeouts.
    pub fn with_timeouts(mut self, timeouts: GrblTimeouts) -> Self {
        self.connection.timeouts = timeouts;
        self
    }

    /// Sends the lines of one motion and returns the messages received meanwhile.
    pub(super) async fn send_lines(&mut self, lines: &MotionLines<'_>) -> Result<Vec<GrblMessage>, ControllerError> {
        let mut messages = Vec::new();
        for line in lines.text.lines() {
            messages.extend(self.connection.send_line_with_standstill(line, lines.planned_standstill_time).await?);
        }
        Ok(messages)
    }

    /// Executes one motion. `last_status` is the status after the previous motion, if it was read. Returns the
    /// status after this motion, if it was read.
    async fn execute_motion(
        &mut self,
        lines: &MotionLines<'_>,
        outcome: &mut MotionBlockOutcome,
        last_status: Option<GrblStatus>,
    ) -> Result<Option<GrblStatus>, ControllerError> {
        let step = lines.step;
        match lines.motion {
            Motion::Dwell { .. } => {
                self.send_lines(lines).await?;
                Ok(None)
            }
            Motion::OrientSpindle { s } => {
                self.send_lines(lines).await?;
                self.monitor.spindle_rad = Some(*s);
                Ok(None)
            }
            Motion::Rapid { to } | Motion::Feed { to, .. } => self.execute_positioning_move(lines, to).await.map(Some),
            Motion::BackOff { to, .. } => {
                self.send_lines(lines).await?;
                let status = self.wait_arrival(to).await?;
                self.wait_probe_open(step, &status).await?;
                Ok(Some(status))
            }
            Motion::Guarded { to, .. } => {
                if self.execute_probing(lines).await?.has_contact {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                self.wait_arrival(to).await.map(Some)
            }
            Motion::Probe { .. } => {
                let status = self.standstill_status(last_status).await?;
                self.wait_probe_open(step, &status).await?;
                self.execute_touch(lines, outcome).await.map(Some)
            }
        }
    }

    /// Status at a standstill; read from the control unless `last_status` was read after the last motion.
    async fn standstill_status(&mut self, last_status: Option<GrblStatus>) -> Result<GrblStatus, ControllerError> {
        match last_status {
            Some(status) => Ok(status),
            None => self.connection.wait_idle().await,
        }
    }

    /// Executes a move that should touch nothing, at rapid or at feed (a turn before the position is
    /// confirmed). The control does not stop the move on a contact: the status reports show the contact,
    /// and the driver holds.
    async fn execute_positioning_move(
        &mut self,
        lines: &MotionLines<'_>,
        to: &Position,
    ) -> Result<GrblStatus, ControllerError> {
        self.connection.positioning_step = Some(lines.step);
        let result = match self.send_lines(lines).await {
            Ok(_) => self.wait_arrival(to).await,
            Err(error) => Err(error),
        };
        self.connection.positioning_step = None;
        result
    }

    async fn execute_touch(
        &mut self,
        lines: &MotionLines<'_>,
        outcome: &mut MotionBlockOutcome,
    ) -> Result<GrblStatus, ControllerError> {
        let step = lines.step;
        let result = self.execute_probing(lines).await?;
        if !result.has_contact {
            return Err(ControllerError::NoContact { step });
        }
        let contact = self.position_from_axis_values(&result.position_mm_or_deg)?;
        let status = self.confirm_touch(step, &result, &contact).await?;
        outcome.trigger_position = Some(contact);
        outcome.trigger_time_s = result.contact_time_s;
        Ok(status)
    }

    async fn execute_block(&mut self, block: &ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        let lines = motion_lines::motion_lines(block)?;
        self.check_block_start(block).await?;
        self.connection.is_block_running = true;
        let result = self.execute_motions(&lines).await;
        self.connection.is_block_running = false;
        let (mut outcome, status) = result?;
        self.check_overrides()?;
        let contact = ControlTimestamp { name: "TIME", t_s: outcome.trigger_time_s };
        let now = ControlTimestamp { name: "Time", t_s: status.control_time_s };
        outcome.trigger_time_s = self.monitor.clock.check_and_select_time(contact, now)?;
        Ok(outcome)
    }

    /// Executes the motions of a block in order; returns their results and the status at the end.
    async fn execute_motions(
        &mut self,
        lines: &[MotionLines<'_>],
    ) -> Result<(MotionBlockOutcome, GrblStatus), ControllerError> {
        let (mut outcome, mut last_status) = (MotionBlockOutcome::default(), None);
        for lines in lines {
            last_status = self.execute_motion(lines, &mut outcome, last_status).await?;
        }
        let status = self.standstill_status(last_status).await?;
        Ok((outcome, status))
    }

    /// Checks before a block moves: overrides at 100 %, no fault of the probe, probe open (except before a back-off),
    /// machine at the start of the block.
    async fn check_block_start(&mut self, block: &ProvenBlock) -> Result<(), ControllerError> {
        let status = self.connection.read_status().await?;
        self.check_overrides()?;
        check::check_probe_health(&status, &self.mode_text)?;
        let backs_off = matches!(block.motions().next(), Some(Motion::BackOff { .. }));
        if !backs_off {
            self.wait_probe_open(block.step(), &status).await?;
        }
        let position = self.status_position(&status)?;
        self.check_position_unchanged(&position).await?;
        self.monitor.check_standstill_position(block.start_position()).map_err(arrival::moved_between_blocks_error)
    }

    /// After any fault nothing is sent until `prepare`. If it is not certain that the machine is at rest,
    /// the driver holds it; after that only a new link accepts lines.
    fn hold_after_fault(&mut self, error: ControllerError) -> ControllerError {
        self.is_prepared = false;
        if !is_at_rest_after(&error) {
            self.connection.send_hold();
        }
        error
    }
}

impl ControllerDriver for GrblDriver {
    async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
        self.prepare_control(check::require_open_probe).await
    }

    async fn prepare_in_contact(&mut self) -> Result<PreparedControl, ControllerError> {
        self.prepare_control(|_| Ok(())).await
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        require_prepared(self.is_prepared, self.connection.is_halt_requested())?;
        let outcome = self.execute_block(&block).await;
        outcome.map_err(|error| self.hold_after_fault(error))
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        if self.axes_in_report_order.is_empty() {
            // Before `prepare` the axes of the reported values are unknown.
            self.connection.synchronize_and_read_status().await?;
            self.check_firmware_axes().await?;
        }
        let status = self.connection.read_status().await?;
        self.monitor.standstill_position = self.status_position(&status)?;
        let position = self.monitor.standstill_position.clone();
        Ok(MachineSnapshot { is_probe_closed: status.is_probe_closed, position })
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.read_device_info().await
    }

    async fn restore_modes(&mut self) -> Result<(), ControllerError> {
        // A blank line clears a latched error.
        self.connection.send_line("").await?;
        let foot = self.mode_text.foot_lines().to_vec();
        self.set_modes(&foot).await?;
        let initial_modes = std::mem::take(&mut self.initial_modes);
        if !initial_modes.is_empty() {
            self.connection.send_line(&initial_modes.join(" ")).await?;
        }
        self.connection.wait_idle().await.map(|_| ())
    }

    async fn read_work_offset(&mut self, slot: WorkOffsetSlot) -> Result<WorkOffset, ControllerError> {
        self.read_offset_slot(slot).await
    }

    async fn write_work_offset(
        &mut self,
        slot: WorkOffsetSlot,
        zero_mm: &[(Axis, f64)],
    ) -> Result<(), ControllerError> {
        self.set_offset_slot(slot, zero_mm).await
    }
}
