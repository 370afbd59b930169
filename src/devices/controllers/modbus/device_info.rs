//! Device information of the control: properties that one read of its status shows.

use super::driver::ModbusDriver;
use super::format_diagnosis::TRAVEL_MARGIN_MM_OR_DEG;
use super::status::WindowStatus;
use crate::controllers::{ControllerError, DeviceInfo, ReadinessFinding, ReportedAxisProperties};
use machine::Axis;

impl ModbusDriver {
    pub(super) async fn read_device_info(&mut self) -> Result<DeviceInfo, ControllerError> {
        let status = self.window.read_status().await?;
        let registers = &self.window.map.status.position;
        let reported_axis = |(axis, register): (&Axis, &super::map::Register)| {
            let whole = !register.number_format.number_type.is_float();
            let resolution = whole.then_some(register.number_format.scale);
            (*axis, ReportedAxisProperties { resolution, ..ReportedAxisProperties::default() })
        };
        Ok(DeviceInfo {
            identity: self.identity(),
            axes: registers.iter().map(reported_axis).collect(),
            findings: self.findings(&status),
            probe_inversion_hint: None,
        })
    }

    /// Findings from one status: positions outside the travel (blocking), all positions zero, no reported time.
    fn findings(&self, status: &WindowStatus) -> Vec<ReadinessFinding> {
        let mut findings = Vec::new();
        for (axis, spec) in &self.machine.axes {
            let Some(value) = status.position.get(*axis) else { continue };
            let position = axis.to_mm_or_deg(value);
            if position < spec.min - TRAVEL_MARGIN_MM_OR_DEG || position > spec.max + TRAVEL_MARGIN_MM_OR_DEG {
                let description = format!(
                    "{axis} reads {position}, outside the travel from {} to {}; suspected: wrong scale or \
                     type of the position, or wrong travel in the machine file",
                    spec.min, spec.max
                );
                let remedy = "compare with the control's display: `scale`, `type` and `order` in \
                              [controller.registers.status.position] and .latch, or [axes] min and max";
                findings.push(ReadinessFinding::blocking(description, remedy));
            }
        }
        if status.position.iter().all(|(_, value)| value == 0.0) {
            let description =
                "all axes read zero: a wrong order of bytes or words, a wrong type or scale is not detectable";
            let remedy = "jog each axis by a small distance at the control and repeat the check";
            findings.push(ReadinessFinding::non_blocking(description, remedy));
        }
        if status.control_time_s.is_none() {
            let description =
                "the control does not report its time: each reading has the time at which trued received it";
            findings.push(ReadinessFinding::non_blocking(
                description,
                "no action needed; drift is determined less precisely",
            ));
        }
        findings
    }
}
