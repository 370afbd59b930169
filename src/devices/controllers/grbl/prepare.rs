//! Checks before the first motion: the identity of the control, whether it can measure, and whether its
//! modes are as set.

use super::check;
use super::driver::GrblDriver;
use super::fault::not_ready_error;
use super::message::{GrblMessage, GrblStatus};
use super::readiness::{self, reject_blocking};
use super::settings::FirmwareInfo;
use crate::controllers::control_clock::ControlClock;
use crate::controllers::motion_lines::duration_or_zero;
use crate::controllers::{ControllerError, PreparedControl};
use machine::Axis;
use planning::gcode::TransmissionForm;

/// Modal words that are restored after the measurement.
const RESTORED_MODAL_WORDS: [&str; 16] = [
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3", "G17", "G18", "G19", "G20", "G21", "G90",
    "G91",
];

impl GrblDriver {
    /// Refuses a control that cannot measure, then sets its modes. `check_probe` refuses a wrong state of the probe
    /// input.
    pub(super) async fn prepare_control(
        &mut self,
        check_probe: fn(&GrblStatus) -> Result<(), ControllerError>,
    ) -> Result<PreparedControl, ControllerError> {
        self.is_prepared = false;
        let status = self.connection.synchronize_and_read_status().await?;
        if status.state != "Idle" {
            return Err(not_ready_error(&status));
        }
        let firmware = self.check_firmware_axes().await?;
        let settings = self.read_settings().await?;
        reject_blocking(readiness::settings_findings(&firmware, &settings, &self.required_homed_axes))?;
        reject_blocking(self.state_findings(&firmware).await?)?;
        if !self.mode_text.has_probe_on_command() {
            check_probe(&self.connection.wait_idle().await?)?;
        }
        // The head writes an offset and switches outputs: unsuitable states are refused before the head is sent.
        let (modes, offsets) = (self.connection.send_line("$G").await?, self.connection.send_line("$#").await?);
        reject_blocking(readiness::blocking_mode_findings(&modes))?;
        reject_blocking(readiness::homed_state_finding(&firmware, &settings, &self.required_homed_axes, &offsets))?;
        self.store_initial_modes(modes);
        let head = self.mode_text.head_lines().to_vec();
        self.set_modes(&head).await?;
        let modes = self.connection.send_line("$G").await?;
        let offsets = self.connection.send_line("$#").await?;
        reject_blocking(readiness::tool_length_finding(&offsets))?;
        check::check_modes_and_offsets(&head, &modes, &offsets)?;
        let status = self.connection.wait_idle().await?;
        check_probe(&status)?;
        check::check_probe_health(&status, &self.mode_text)?;
        self.monitor.standstill_position = self.status_position(&status)?;
        self.monitor.clock = ControlClock::default();
        self.is_prepared = true;
        Ok(PreparedControl {
            identity: firmware.identity(),
            stop_description: self.stop_description.clone(),
            position: self.monitor.standstill_position.clone(),
            transmission: TransmissionForm::Lines { max_line_bytes: self.max_line_bytes },
            unreadable_items: readiness::unreadable_items(&firmware),
        })
    }

    /// Reads version and axes of the control; an error if it lacks an axis of the machine.
    pub(super) async fn check_firmware_axes(&mut self) -> Result<FirmwareInfo, ControllerError> {
        let firmware = self.read_firmware_info().await?;
        let missing: Vec<String> = (self.monitor.axes_without_spindle.iter())
            .filter(|axis| !self.axes_in_report_order.contains(&Some(**axis)))
            .map(Axis::to_string)
            .collect();
        if !missing.is_empty() {
            return Err(ControllerError::UnsupportedByControl {
                reason: format!("the control has the axes {}, but not {}", firmware.axis_letters, missing.join(", ")),
                remedy: "classic Grbl has three axes and no rotary axes: use grblHAL \
                         built with the machine's axes, or another control"
                    .to_owned(),
            });
        }
        Ok(firmware)
    }

    /// Stores the modal words as they were before the first preparation.
    fn store_initial_modes(&mut self, modes: Vec<GrblMessage>) {
        if !self.initial_modes.is_empty() {
            return;
        }
        for message in modes {
            if let GrblMessage::ModalWords(words) = message {
                self.initial_modes = words;
                self.initial_modes.retain(|word| RESTORED_MODAL_WORDS.contains(&word.as_str()));
            }
        }
    }

    /// Sends the lines of the program's head or foot, which set modes.
    pub(super) async fn set_modes(&mut self, lines: &[String]) -> Result<(), ControllerError> {
        let standstill_time = duration_or_zero(self.mode_text.settling_time_after_head_s().unwrap_or_default());
        for line in lines {
            self.connection.send_line_with_standstill(line, standstill_time).await?;
        }
        Ok(())
    }
}
