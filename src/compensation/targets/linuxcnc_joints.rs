//! Compensation files of LinuxCNC for linear axes.

use super::machine_file_checks::{check_directions, ini_file};
use crate::compensation::target::{CompensationTarget, TargetError};
use crate::setup::{LinuxcncHalConfig, MachineFile};
use devices::compensation::linuxcnc_joints::{JointTable, JointTables, TableKind, TableValue};
use machine::Axis;
use machine::record::machine::{AxisSense, Machine};
use methods::compensation::{ControlModel, ControlValue, ControlledTravel, TravelEntry};

#[derive(Debug)]
pub struct LinuxcncJoints<'a> {
    machine: &'a Machine,
    tables: JointTables,
}

impl<'a> LinuxcncJoints<'a> {
    /// # Errors
    /// The INI file cannot be read, is not supported, or names no compensation file.
    pub fn open(file: &'a MachineFile, keys: &LinuxcncHalConfig) -> Result<Self, TargetError> {
        Ok(Self { machine: &file.machine, tables: JointTables::new(ini_file(file)?, &keys.halcmd)? })
    }
}

impl CompensationTarget for LinuxcncJoints<'_> {
    fn kind(&self) -> &'static str {
        "linuxcnc-joints"
    }

    fn describe(&self) -> String {
        self.tables.describe()
    }

    fn read(&self) -> Result<ControlModel, TargetError> {
        check_directions(self.machine, &[Axis::X, Axis::Y, Axis::Z], AxisSense::Iso)?;
        let mut values = Vec::new();
        let mut travels = Vec::new();
        for table in self.tables.read()? {
            let sign = if table.kind == TableKind::Correction { 1.0 } else { -1.0 };
            let positions_mm = table.values.iter().map(|value| value.position_mm);
            let entries =
                positions_mm.zip(values.len()..).map(|(nominal_mm, value)| TravelEntry { nominal_mm, value, sign });
            let entries = entries.collect();
            let no_travel = || TargetError::NoTravel { axis: table.axis };
            travels.push(ControlledTravel::new(table.axis, entries).ok_or_else(no_travel)?);
            values.extend(control_values(&table));
        }
        Ok(ControlModel::of_travels(values, travels))
    }

    /// LinuxCNC reads the files only when it starts.
    fn check_writable(&self) -> Result<(), TargetError> {
        Ok(())
    }

    fn write(&self, name: &str, text: &str) -> Result<(), TargetError> {
        Ok(self.tables.write(name, text)?)
    }

    fn needs_restart(&self) -> bool {
        true
    }

    fn check_in_effect(&self, replaced: &[(String, f64)]) -> Result<(), TargetError> {
        let mut before = self.tables.read()?;
        for table in &mut before {
            let names: Vec<String> = table.values.iter().map(|value| table.value_name(value)).collect();
            for (value, name) in table.values.iter_mut().zip(names) {
                if let Some((_, mm)) = replaced.iter().find(|(own, _)| *own == name) {
                    value.mm = *mm;
                }
            }
        }
        Ok(self.tables.check_in_effect(&before)?)
    }

    fn advice_after_write(&self) -> &'static str {
        "restart LinuxCNC, home all axes, move each corrected axis near an end of its travel, then confirm with `trued \
         compensate finish`: until then no run starts"
    }
}

fn control_values(table: &JointTable) -> Vec<ControlValue> {
    let values = table.values.iter();
    let value =
        |own: &TableValue| ControlValue { name: table.value_name(own), present_mm: own.mm, text: own.text.clone() };
    values.map(value).collect()
}
