//! Checks before the first motion: whether a live control is behind the registers, and whether its modes
//! are set.

use super::driver::ModbusDriver;
use super::fault::not_ready_error;
use super::format_diagnosis;
use super::status::WindowStatus;
use crate::controllers::control_clock::ControlClock;
use crate::controllers::motion_lines::duration_or_zero;
use crate::controllers::{ControllerError, PreparedControl, READINESS_ITEMS, ReadinessItem, arrival};
use planning::gcode::TransmissionForm;

impl ModbusDriver {
    /// Refuses a control that cannot measure, then sets its modes. `check_probe` refuses a wrong state of the probe
    /// input.
    pub(super) async fn prepare_control(
        &mut self,
        check_probe: fn(&WindowStatus) -> Result<(), ControllerError>,
    ) -> Result<PreparedControl, ControllerError> {
        self.is_prepared = false;
        let status = self.window.exchange_first_heartbeats().await?;
        if let Some(error) = not_ready_error(&status) {
            return Err(error);
        }
        // Sequence numbers continue from here; a chunk that was written before the control started is not
        // accepted.
        (self.window.checked_sequence, self.window.is_checked_chunk_own) = (status.checked_sequence, false);
        self.refuse_implausible_positions(&status)?;
        if !self.mode_text.has_probe_on_command() {
            check_probe(&status)?;
        }
        if self.program.is_some() {
            self.clear_results(&status).await?;
        }
        let head = self.mode_text.head_lines().to_vec();
        self.set_modes(&head).await?;
        let status = self.window.wait_idle_and_chunks_complete().await?;
        check_probe(&status)?;
        self.check_probe_health(&status)?;
        self.monitor.standstill_position = self.monitor.machine_axes_only(&status.position);
        self.monitor.clock = ControlClock::default();
        self.contact_or_status_time_s(None, &status)?;
        let stop_description = format!(
            "hold (a register): takes effect when the pending request is answered, within {:.1} s at most; \
             then {}",
            self.window.timeouts.reply_timeout.as_secs_f64(),
            arrival::describe_braking_distances(&self.machine)
        );
        let transmission = match self.program {
            Some(_) => TransmissionForm::TableRows,
            // A chunk holds one line.
            None => TransmissionForm::Lines { max_line_bytes: self.window.map.command.chunk.capacity_bytes() + 1 },
        };
        // The window has registers for the position and the probe; the control's program checks all else.
        let unreadable_items = READINESS_ITEMS.map(|(item, _)| item).into_iter();
        let unreadable_items = unreadable_items.filter(|item| *item != ReadinessItem::ProbeInput).collect();
        self.is_prepared = true;
        Ok(PreparedControl {
            identity: self.identity(),
            stop_description,
            position: self.monitor.standstill_position.clone(),
            transmission,
            unreadable_items,
        })
    }

    /// Describes what is behind the window, and its address.
    pub(super) fn identity(&self) -> String {
        let kind = match &self.program {
            Some(program) => format!("resident program {}", program.program_number),
            None => "a line window".to_owned(),
        };
        format!("{kind} over Modbus, {}", self.address_label)
    }

    /// Refuses a position that is outside its travel by more than the length of the travel, or a misread integer.
    /// Numbers in the wrong word order are far beyond any travel; whole numbers read as floating point are nearly zero.
    fn refuse_implausible_positions(&self, status: &WindowStatus) -> Result<(), ControllerError> {
        for (axis, spec) in &self.machine.axes {
            let Some(value) = status.position.get(*axis) else { continue };
            let (position, span) = (axis.to_mm_or_deg(value), spec.max - spec.min);
            let is_misread = format_diagnosis::is_misread_integer(position);
            if is_misread || position < spec.min - span || position > spec.max + span {
                let position = if is_misread { format!("{position:e}") } else { position.to_string() };
                return Err(ControllerError::UnexpectedDevice {
                    state: format!(
                        "the reported position {axis} = {position} is not plausible: the travel is from {} to {}",
                        spec.min, spec.max
                    ),
                    remedy: "compare `type`, `order` and `scale` of [controller.registers.status] \
                             position with the control's program"
                        .to_owned(),
                });
            }
        }
        Ok(())
    }

    /// Error if one of the probe's health inputs that the machine file declares (a letter or the number of a bit) is
    /// on.
    pub(super) fn check_probe_health(&self, status: &WindowStatus) -> Result<(), ControllerError> {
        let is_on = |input: &str| {
            let letter = input.chars().next().filter(char::is_ascii_uppercase);
            let bit = match letter {
                Some(letter) => Some(u32::from(letter) - u32::from('A')),
                None => input.parse().ok(),
            };
            bit.and_then(|bit| status.input_bits.checked_shr(bit)).is_some_and(|bits| bits & 1 == 1)
        };
        match self.mode_text.probe_health_inputs().find(|(input, _)| is_on(input)) {
            Some((_, fault)) => Err(ControllerError::ProbeFault { fault }),
            None => Ok(()),
        }
    }

    /// Sends the lines of the program's head or foot, which set modes. A resident program sets its modes itself.
    pub(super) async fn set_modes(&mut self, lines: &[String]) -> Result<(), ControllerError> {
        if self.program.is_some() {
            return Ok(());
        }
        let max_bytes = self.window.map.command.chunk.capacity_bytes();
        let standstill_time = duration_or_zero(self.mode_text.settling_time_after_head_s().unwrap_or_default());
        // Comments have no effect at the control, and may be longer than the window.
        for line in lines.iter().filter(|line| !line.starts_with('(')) {
            if line.len() > max_bytes {
                let reason = format!("a line is longer than the window: `{line}`");
                return Err(ControllerError::RenderFailed { step: 0, reason });
            }
            self.window.execute_line(line, standstill_time).await?;
        }
        Ok(())
    }
}
