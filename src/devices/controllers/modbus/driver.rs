//! Driver: executes proven blocks and returns their outcomes.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::ModbusConfig;
use super::fault::{ALARM_PROBE_CLOSED, require_open_probe};
use super::program::ResidentProgram;
use super::status::WindowStatus;
use super::timeouts::ModbusTimeouts;
use super::window::WindowConnection;
use crate::controllers::arrival::{self, AxisMonitor};
use crate::controllers::control_clock::ControlTimestamp;
use crate::controllers::motion_lines::{self, MotionLines};
use crate::controllers::{
    ControllerDriver, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot, PreparedControl, require_prepared,
};
use machine::Position;
use machine::record::machine::Machine;
use machine::record::motion::{Motion, MotionBlockOutcome};
use planning::proof::{ProvenBlock, ProvenModeText};

/// Maximum time that a probe bounces after it has come free. A probe that still reads closed afterwards is a fault.
const MAX_PROBE_BOUNCE_TIME: Duration = Duration::from_millis(300);

/// Driver of one control behind a Modbus window.
pub struct ModbusDriver {
    pub(super) window: WindowConnection,
    /// Lines that set the control's modes before the first block and restore them after the last.
    pub(super) mode_text: ProvenModeText,
    pub(super) machine: Machine,
    /// Address of the control, for the record.
    pub(super) address_label: String,
    /// Axes with their tolerances, last position at a standstill, commanded orientation of the spindle, clock of the
    /// control.
    pub(super) monitor: AxisMonitor,
    /// Whether the control is prepared and no fault has occurred since.
    pub(super) is_prepared: bool,
    /// Resident program that executes the blocks; if `None`, their lines are sent.
    pub(super) program: Option<Arc<ResidentProgram>>,
}

impl ModbusDriver {
    /// Opens the window of `machine`'s control; also returns the handle that halts the machine. Nothing is commanded
    /// yet. After a halt the link writes nothing more: a new run opens a new link.
    ///
    /// # Errors
    /// The link cannot be opened, the register map lacks an axis, or the machine file has commands for the probe or
    /// clamps although a resident program is configured.
    pub async fn open(
        config: &ModbusConfig,
        machine: &Machine,
        modes: ProvenModeText,
    ) -> Result<(Self, HaltHandle), ControllerError> {
        let monitor = AxisMonitor::new(machine);
        if let Some(axis) = config.map.axis_without_registers(&monitor.axes_without_spindle) {
            return Err(ControllerError::UnsupportedByControl {
                reason: format!("the register map has no registers for axis {axis}"),
                remedy: "add the axis to [controller.registers.status.position] and .latch".to_owned(),
            });
        }
        let switches = modes.settling_time_after_head_s().is_some() || modes.probe_off_program().is_some();
        if config.program.is_some() && switches {
            return Err(ControllerError::UnsupportedByControl {
                reason: "a resident program receives no commands for the probe and the clamps".to_owned(),
                remedy: "switch the probe and the clamps in the resident program, and remove [probe] on, off and every clamp from the machine file"
                    .to_owned(),
            });
        }
        let (window, halt) = WindowConnection::open(&config.device, config.map.clone()).await?;
        let driver = Self {
            window,
            mode_text: modes,
            machine: machine.clone(),
            address_label: format!("{}, unit {}", config.device.line, config.device.unit),
            monitor,
            is_prepared: false,
            program: config.program.clone(),
        };
        Ok((driver, halt))
    }

    /// Replaces the default timeouts.
    pub fn with_timeouts(mut self, timeouts: ModbusTimeouts) -> Self {
        self.window.timeouts = timeouts;
        self
    }

    /// Sends the lines of one motion; returns the status after the last line.
    async fn send_lines(&mut self, lines: &MotionLines<'_>) -> Result<WindowStatus, ControllerError> {
        let mut status = None;
        for line in lines.text.lines() {
            status = Some(self.window.execute_line(line, lines.planned_standstill_time).await?);
        }
        self.standstill_status(status).await
    }

    /// Executes one motion. `last_status` is the status after the previous motion, if it was read. Returns the
    /// status after this motion.
    async fn execute_motion(
        &mut self,
        lines: &MotionLines<'_>,
        outcome: &mut MotionBlockOutcome,
        last_status: Option<WindowStatus>,
    ) -> Result<WindowStatus, ControllerError> {
        let step = lines.step;
        match lines.motion {
            Motion::Dwell { .. } => self.send_lines(lines).await,
            Motion::OrientSpindle { s } => {
                let status = self.send_lines(lines).await?;
                self.monitor.spindle_rad = Some(*s);
                Ok(status)
            }
            Motion::Rapid { to } | Motion::Feed { to, .. } => {
                // The control does not stop the move on a contact: the status shows the contact, and the
                // driver holds.
                self.window.positioning_step = Some(step);
                let sent = self.send_lines(lines).await;
                self.window.positioning_step = None;
                self.store_and_check_standstill(sent?, to)
            }
            Motion::BackOff { to, .. } => {
                let status = self.send_lines(lines).await?;
                let status = self.store_and_check_standstill(status, to)?;
                self.wait_probe_open(step, status).await
            }
            Motion::Guarded { to, .. } => {
                let last_status = self.standstill_status(last_status).await?;
                let (has_contact, status) = self.execute_probing(lines, &last_status).await?;
                if has_contact {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                self.store_and_check_standstill(status, to)
            }
            Motion::Probe { .. } => {
                let last_status = self.standstill_status(last_status).await?;
                let last_status = self.wait_probe_open(step, last_status).await?;
                self.execute_touch(lines, outcome, &last_status).await
            }
        }
    }

    /// Status at a standstill; read from the control unless `last_status` was read after the last motion.
    async fn standstill_status(&mut self, last_status: Option<WindowStatus>) -> Result<WindowStatus, ControllerError> {
        match last_status {
            Some(status) => Ok(status),
            None => self.window.wait_idle_and_chunks_complete().await,
        }
    }

    /// Executes a probing move and returns whether there was a contact. The control counts its contacts;
    /// `last_status` has the count before the move, and a count that rose by more than one is an error.
    async fn execute_probing(
        &mut self,
        lines: &MotionLines<'_>,
        last_status: &WindowStatus,
    ) -> Result<(bool, WindowStatus), ControllerError> {
        let step = lines.step;
        let before = last_status.latch_count;
        let status = self.send_lines(lines).await.map_err(|error| match error {
            ControllerError::Alarm { code, .. } if code == u32::from(ALARM_PROBE_CLOSED) => {
                ControllerError::ProbeStillClosed { step }
            }
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        match status.latch_count.wrapping_sub(before) {
            0 => Ok((false, status)),
            1 => Ok((true, status)),
            _ => Err(ControllerError::TouchMismatch {
                step,
                first: format!("contact count {before}"),
                second: format!("contact count {}", status.latch_count),
            }),
        }
    }

    /// Executes a touch and stores the position and the time of its contact in `outcome`; a move without contact and a
    /// contact off the path are errors.
    async fn execute_touch(
        &mut self,
        lines: &MotionLines<'_>,
        outcome: &mut MotionBlockOutcome,
        last_status: &WindowStatus,
    ) -> Result<WindowStatus, ControllerError> {
        let step = lines.step;
        let (has_contact, status) = self.execute_probing(lines, last_status).await?;
        if !has_contact {
            return Err(ControllerError::NoContact { step });
        }
        let from = std::mem::replace(&mut self.monitor.standstill_position, status.position.clone());
        let contact = self.monitor.machine_axes_only(&status.latched_position);
        self.monitor.check_contact_on_path(&from, &self.monitor.standstill_position, &contact)?;
        outcome.trigger_position = Some(self.monitor.with_spindle_orientation(contact.iter()));
        outcome.trigger_time_s = status.latch_time_s;
        Ok(status)
    }

    /// Stores the position of `status`, and checks that the machine is at `target`.
    pub(super) fn store_and_check_standstill(
        &mut self,
        status: WindowStatus,
        target: &Position,
    ) -> Result<WindowStatus, ControllerError> {
        self.monitor.standstill_position = status.position.clone();
        self.monitor.check_standstill_position(target)?;
        Ok(status)
    }

    /// Waits until the probe reads open, first in the last status, `status`; returns the status that shows it. An
    /// error after `MAX_PROBE_BOUNCE_TIME`.
    pub(super) async fn wait_probe_open(
        &mut self,
        step: u32,
        mut status: WindowStatus,
    ) -> Result<WindowStatus, ControllerError> {
        let deadline = Instant::now() + MAX_PROBE_BOUNCE_TIME;
        while status.is_probe_closed {
            if Instant::now() > deadline {
                return Err(ControllerError::ProbeStillClosed { step });
            }
            sleep(MAX_PROBE_BOUNCE_TIME / 10).await;
            status = self.window.wait_idle_and_chunks_complete().await?;
        }
        Ok(status)
    }

    async fn execute_block(&mut self, block: &ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        if let Some(program) = self.program.clone() {
            return self.call_program(&program, block).await;
        }
        let mut outcome = MotionBlockOutcome::default();
        let lines = motion_lines::motion_lines(block)?;
        self.check_block_start(block).await?;
        let mut last_status = None;
        for lines in &lines {
            last_status = Some(self.execute_motion(lines, &mut outcome, last_status).await?);
        }
        let status = self.standstill_status(last_status).await?;
        outcome.trigger_time_s = self.contact_or_status_time_s(outcome.trigger_time_s, &status)?;
        Ok(outcome)
    }

    /// Returns the time of a contact, `latch_s`, or else the time of `status`; `None` if the control reports neither.
    /// An error if one of them is implausible.
    pub(super) fn contact_or_status_time_s(
        &mut self,
        latch_s: Option<f64>,
        status: &WindowStatus,
    ) -> Result<Option<f64>, ControllerError> {
        let contact = ControlTimestamp { name: "latch_time_s", t_s: latch_s };
        let now = ControlTimestamp { name: "time_s", t_s: status.control_time_s };
        self.monitor.clock.check_and_select_time(contact, now)
    }

    /// Checks before a block moves: no fault of the probe, probe open (unless the block begins with a back-off),
    /// machine where the last motion ended and at the start of the block.
    pub(super) async fn check_block_start(&mut self, block: &ProvenBlock) -> Result<(), ControllerError> {
        let mut status = self.window.wait_idle_and_chunks_complete().await?;
        self.check_probe_health(&status)?;
        let backs_off = matches!(block.motions().next(), Some(Motion::BackOff { .. }));
        if !backs_off {
            status = self.wait_probe_open(block.step(), status).await?;
        }
        [&self.monitor.standstill_position, block.start_position()]
            .into_iter()
            .try_for_each(|expected| self.monitor.check_position(expected, &status.position))
            .map_err(arrival::moved_between_blocks_error)
    }

    /// After any fault nothing is sent until `prepare`. If it is not certain that the machine is at rest,
    /// the driver holds it; after that only a new link accepts lines.
    fn hold_after_fault(&mut self, error: ControllerError) -> ControllerError {
        self.is_prepared = false;
        if !error.is_machine_stationary() {
            self.window.send_hold();
        }
        error
    }
}

impl ControllerDriver for ModbusDriver {
    async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
        self.prepare_control(require_open_probe).await
    }

    async fn prepare_in_contact(&mut self) -> Result<PreparedControl, ControllerError> {
        self.prepare_control(|_| Ok(())).await
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        require_prepared(self.is_prepared, self.window.is_halt_requested())?;
        let outcome = self.execute_block(&block).await;
        outcome.map_err(|error| self.hold_after_fault(error))
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        let status = self.window.read_status().await?;
        self.monitor.standstill_position = self.monitor.machine_axes_only(&status.position);
        let position = self.monitor.with_spindle_orientation(self.monitor.standstill_position.iter());
        Ok(MachineSnapshot { is_probe_closed: status.is_probe_closed, position })
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.read_device_info().await
    }

    async fn restore_modes(&mut self) -> Result<(), ControllerError> {
        let foot = self.mode_text.foot_lines().to_vec();
        self.set_modes(&foot).await?;
        self.window.wait_idle_and_chunks_complete().await.map(|_| ())
    }
}
