//! Properties that the control reports: the registers of its status, read once.

use super::driver::ModbusControl;
use super::otherwise::TRAVEL_MARGIN;
use super::status::Status;
use crate::controllers::{ControllerError, DeviceInfo, ReadinessFinding, ReportedAxis};
use machine::Axis;

impl ModbusControl {
    pub(super) async fn report_identity(&mut self) -> Result<DeviceInfo, ControllerError> {
        let status = self.window.status().await?;
        let places = &self.window.map.status.position;
        let says = |(axis, register): (&Axis, &super::map::Register)| {
            let whole = !register.number.kind.is_float();
            let step = whole.then_some(register.number.scale);
            (*axis, ReportedAxis { step, ..ReportedAxis::default() })
        };
        Ok(DeviceInfo {
            identity: self.identity(),
            axes: places.iter().map(says).collect(),
            remarks: self.remarks(&status),
            polarity: None,
        })
    }

    fn remarks(&self, status: &Status) -> Vec<ReadinessFinding> {
        let mut remarks = Vec::new();
        for (axis, spec) in &self.machine.axes {
            let Some(value) = status.position.get(*axis) else { continue };
            let stands = axis.to_edge(value);
            if stands < spec.min - TRAVEL_MARGIN || stands > spec.max + TRAVEL_MARGIN {
                let what = format!(
                    "{axis} is read as {stands}, outside its travel from {} to {}: suspected: wrong scale or \
                     type of its position, or a travel that is not the machine's",
                    spec.min, spec.max
                );
                let remedy = "compare with the control's display: `scale`, `type` and `order` in \
                              [controller.registers.status.position] and .latch, or [axes] min and max";
                remarks.push(ReadinessFinding::hinders(what, remedy));
            }
        }
        if status.position.iter().all(|(_, value)| value == 0.0) {
            let what = "all axes are read as zero, as they would be with any order, type and scale";
            let remedy = "jog each axis a little at the control and look again";
            remarks.push(ReadinessFinding::note(what, remedy));
        }
        if status.time_s.is_none() {
            let what = "it does not tell its time: readings carry the time at which they came here";
            remarks.push(ReadinessFinding::note(what, "none needed; drift is told less exactly"));
        }
        remarks
    }
}
