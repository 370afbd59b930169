//! Compensation files of LinuxCNC for linear axes.

use super::machine_file_checks::{check_directions, ini_file};
use crate::compensation::target::{CompensationTarget, TargetError};
use crate::setup::{LinuxcncHalConfig, MachineFile};
use devices::compensation::ValueToWrite;
use devices::compensation::linuxcnc_joints::{JointTable, JointTableTarget, TableKind, TableValue};
use machine::Axis;
use machine::record::machine::{AxisSense, Machine};
use methods::compensation::{ControlModel, ControlValue, ControlledTravel, TravelEntry};

/// Compensation values in the compensation files (`COMP_FILE`) of LinuxCNC, for linear axes.
#[derive(Debug)]
pub struct LinuxcncJointTables<'a> {
    machine: &'a Machine,
    tables: JointTableTarget,
}

impl<'a> LinuxcncJointTables<'a> {
    /// # Errors
    /// The INI file cannot be read, is not supported, or names no compensation file.
    pub fn open(file: &'a MachineFile, keys: &LinuxcncHalConfig) -> Result<Self, TargetError> {
        Ok(Self { machine: &file.machine, tables: JointTableTarget::new(ini_file(file)?, &keys.halcmd)? })
    }
}

impl CompensationTarget for LinuxcncJointTables<'_> {
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
            let entries = positions_mm.zip(values.len()..).map(|(nominal_mm, value)| TravelEntry {
                nominal_mm,
                value_index: value,
                correction_sign: sign,
            });
            let entries = entries.collect();
            check_covers_travel(self.machine, &table)?;
            travels.extend(ControlledTravel::new(table.axis, entries));
            values.extend(control_values(&table));
        }
        Ok(ControlModel::of_correction_tables(values, travels))
    }

    /// Always permits a write, because LinuxCNC reads the files only when it starts.
    fn check_writable(&self) -> Result<(), TargetError> {
        Ok(())
    }

    fn is_written_in_one_batch(&self) -> bool {
        true
    }

    /// Writes the files and reads them back; LinuxCNC uses the values after its next start.
    fn write(&self, values: &[ValueToWrite<'_>]) -> Result<(), TargetError> {
        Ok(self.tables.write(values)?)
    }

    fn needs_restart(&self) -> bool {
        true
    }

    /// Checks that LinuxCNC uses the values of the files; `replaced`: names and values (mm) that it must not use any
    /// more.
    fn check_in_effect(&self, replaced: &[(String, f64)]) -> Result<(), TargetError> {
        let mut before = self.tables.read()?;
        for table in &mut before {
            let names: Vec<String> = table.values.iter().map(|value| table.value_name(value)).collect();
            for (value, name) in table.values.iter_mut().zip(names) {
                if let Some((_, mm)) = replaced.iter().find(|(own, _)| *own == name) {
                    value.value_mm = *mm;
                }
            }
        }
        Ok(self.tables.check_in_effect(&before)?)
    }

    fn advice_after_write(&self) -> String {
        "Restart LinuxCNC, home all axes, and move each corrected axis near an end of its travel. Then confirm with `trued \
         compensate finish`; until then no run starts. Then measure again, positions of rotary axes too: only a \
         measurement shows that the values are correct"
            .to_owned()
    }
}

/// Checks that a table covers the travel of its axis: outside its positions, a table corrects only part of the error.
fn check_covers_travel(machine: &Machine, table: &JointTable) -> Result<(), TargetError> {
    let (axis, positions) = (table.axis, table.values.iter().map(|value| value.position_mm));
    let from_mm = positions.clone().fold(f64::INFINITY, f64::min);
    let to_mm = positions.fold(f64::NEG_INFINITY, f64::max);
    match machine.axes.get(&axis) {
        Some(stated) if stated.min < from_mm || stated.max > to_mm => {
            Err(TargetError::ShortTable { axis, from_mm, to_mm, min_mm: stated.min, max_mm: stated.max })
        }
        _ => Ok(()),
    }
}

fn control_values(table: &JointTable) -> Vec<ControlValue> {
    let values = table.values.iter();
    let value = |own: &TableValue| ControlValue {
        name: table.value_name(own),
        present_mm: own.value_mm,
        text: own.value_text.clone(),
    };
    values.map(value).collect()
}
