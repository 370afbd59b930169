//! A work offset whose zero is the centre of rotation of the table.

use std::cell::{Cell, OnceCell};
use std::fmt;

use tokio::runtime::{Builder, Runtime};

use super::machine_file_checks::{check_directions, ini_file};
use crate::compensation::target::{CompensationTarget, TargetError};
use crate::setup::{ControlConfig, EarlierSessions, MachineFile, SimulationPace, WorkOffsetConfig, open_devices};
use devices::compensation::program_search::{ProgramSearch, programs_with_slot};
use devices::compensation::{ValueToWrite, are_values_equal};
use devices::controllers::{Controller, ControllerConfig, WorkOffset, WorkOffsetSlot};
use machine::Axis;
use machine::kinematics::{KinematicChain, ZParallelTableAxis};
use machine::record::machine::{AxisSense, Machine};
use methods::compensation::{ControlModel, ControlValue, RotaryAxisCoordinate};

/// The work offset of the control, which is opened at the first access and closed with this value.
pub struct WorkOffsetTarget<'a> {
    file: &'a MachineFile,
    slot: WorkOffsetSlot,
    control: &'a dyn ControllerConfig,
    /// As [`rotary_centre`]; the component of each is the axis of its value in the work offset.
    coordinates: Vec<RotaryAxisCoordinate>,
    runtime: Runtime,
    open_controller: OnceCell<Controller>,
    /// Whether the control used the slot when it was read last.
    is_selected: Cell<bool>,
}

impl fmt::Debug for WorkOffsetTarget<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkOffsetTarget").field("slot", &self.slot).finish_non_exhaustive()
    }
}

impl<'a> WorkOffsetTarget<'a> {
    /// # Errors
    /// The control is simulated; the machine has no table that turns about Z.
    pub fn new(file: &'a MachineFile, keys: &WorkOffsetConfig) -> Result<Self, TargetError> {
        let ControlConfig::Real(control) = &file.controller_section.control else {
            return Err(TargetError::SimulatedControl);
        };
        Ok(Self {
            file,
            slot: keys.slot,
            control: &**control,
            coordinates: rotary_centre(&file.machine)?,
            runtime: Builder::new_current_thread().enable_all().build().map_err(TargetError::Runtime)?,
            open_controller: OnceCell::new(),
            is_selected: Cell::new(false),
        })
    }

    /// The open control; the first call opens all devices of the machine file.
    fn controller(&self) -> Result<&Controller, TargetError> {
        if let Some(controller) = self.open_controller.get() {
            return Ok(controller);
        }
        let opening = open_devices(self.file, SimulationPace::RealTime, EarlierSessions::default());
        let devices = self.runtime.block_on(opening).map_err(|error| TargetError::Setup(Box::new(error)))?;
        Ok(self.open_controller.get_or_init(|| devices.open_controller))
    }

    /// Reads the slot, and stores whether the control uses it. Refused while the machine moves or a program runs.
    fn read_offset(&self) -> Result<WorkOffset, TargetError> {
        let offset = self.runtime.block_on(self.controller()?.read_work_offset(self.slot))?;
        self.is_selected.set(offset.is_selected);
        Ok(offset)
    }

    /// Refuses a slot with an offset of the tilting axis: the centre of rotation is valid with the rotary axes of the
    /// machine at zero.
    fn check_tilting_axis_at_zero(&self, rotary_deg: &[(Axis, f64)]) -> Result<(), TargetError> {
        let is_tilting = |axis: Axis| self.coordinates.iter().any(|own| own.axis == axis && own.component == Axis::Z);
        match rotary_deg.iter().find(|(axis, deg)| is_tilting(*axis) && *deg != 0.0) {
            Some((axis, deg)) => Err(TargetError::TiltedSlot { slot: self.slot, axis: *axis, deg: *deg }),
            None => Ok(()),
        }
    }

    /// Name of a value, such as `G54 X`.
    fn value_name(&self, axis: Axis) -> String {
        format!("{} {axis}", self.slot)
    }

    /// Axis of the value `name`; `None` if the work offset has no such value.
    fn axis_of(&self, name: &str) -> Option<Axis> {
        let mut axes = self.coordinates.iter().map(|coordinate| coordinate.component);
        axes.find(|axis| self.value_name(*axis) == name)
    }
}

impl CompensationTarget for WorkOffsetTarget<'_> {
    fn kind(&self) -> &'static str {
        "work-offset"
    }

    fn describe(&self) -> String {
        format!("work offset {} of the control at {}", self.slot, self.control.describe_address())
    }

    fn notes(&self) -> Vec<String> {
        let search = ini_file(self.file).ok().and_then(|ini| programs_with_slot(ini, self.slot));
        let mut notes = vec![describe_programs(self.slot, search.as_ref())];
        if self.is_selected.get() {
            notes.push(format!(
                "the control uses {} now: the coordinates that it displays change with the write",
                self.slot
            ));
        }
        if self.slot.name() == "G54" {
            notes.push("programs that select no work offset use G54 too".to_owned());
        }
        notes
    }

    fn read(&self) -> Result<ControlModel, TargetError> {
        let WorkOffset { zero_mm, rotary_deg, decimals, .. } = self.read_offset()?;
        self.check_tilting_axis_at_zero(&rotary_deg)?;
        let value = |coordinate: &RotaryAxisCoordinate| {
            let axis = coordinate.component;
            let present_mm = zero_mm.iter().find(|(own, _)| *own == axis).map(|(_, mm)| *mm);
            let present_mm = present_mm.ok_or(TargetError::NoWorkOffsetOfAxis { axis })?;
            let value = ControlValue { name: self.value_name(axis), present_mm, text: present_mm.to_string() };
            Ok((*coordinate, value))
        };
        let values = self.coordinates.iter().map(value).collect::<Result<Vec<_>, TargetError>>()?;
        Ok(ControlModel::work_offset(values, decimals))
    }

    fn has_value(&self, name: &str) -> bool {
        self.axis_of(name).is_some()
    }

    /// Each read refuses a machine that moves and a program that runs.
    fn check_writable(&self) -> Result<(), TargetError> {
        self.read_offset().map(drop)
    }

    fn is_written_in_one_batch(&self) -> bool {
        true
    }

    /// Writes all values in one block and reads them back.
    fn write(&self, values: &[ValueToWrite<'_>]) -> Result<(), TargetError> {
        let parse = |value: &ValueToWrite<'_>| Some((self.axis_of(value.name)?, value.text.parse().ok()?));
        let zero_mm: Option<Vec<(Axis, f64)>> = values.iter().map(parse).collect();
        let zero_mm = zero_mm.ok_or(TargetError::UnreadableValue { slot: self.slot })?;
        self.runtime.block_on(self.controller()?.write_work_offset(self.slot, zero_mm.clone()))?;
        let read = self.read_offset()?.zero_mm;
        for (axis, written_mm) in zero_mm {
            let read_mm = read.iter().find(|(own, _)| *own == axis).map_or(f64::NAN, |(_, mm)| *mm);
            if !are_values_equal(read_mm, written_mm) {
                return Err(TargetError::ReadBack { name: self.value_name(axis), written_mm, read_mm });
            }
        }
        Ok(())
    }

    fn advice_after_write(&self) -> String {
        let slot = self.slot;
        let displayed = match self.is_selected.get() {
            true => format!("The control uses {slot} now: the coordinates that it displays have changed at once. "),
            false => String::new(),
        };
        format!(
            "{displayed}Touch a workpiece in {slot}: only a measurement shows that the values are right. A workpiece that was \
             measured relative to {slot} must be measured again"
        )
    }
}

/// X and Y of the axis of the table along Z; Z of an axis that tilts the table.
fn rotary_centre(machine: &Machine) -> Result<Vec<RotaryAxisCoordinate>, TargetError> {
    check_directions(machine, &[Axis::X, Axis::Y, Axis::Z], AxisSense::Iso)?;
    let chain = KinematicChain::new(machine)?;
    let other = || TargetError::NoRotaryTable { topology: machine.topology.clone() };
    let about_z = ZParallelTableAxis::of_machine(machine, &chain).ok_or_else(other)?.axis;
    let tilting = chain.topology().workpiece_branch().iter().filter(|axis| !axis.is_linear() && **axis != about_z);
    let tilting: Vec<Axis> = tilting.copied().collect();
    let z = match tilting[..] {
        [] => None,
        [axis] => Some(RotaryAxisCoordinate { axis, component: Axis::Z }),
        _ => return Err(other()),
    };
    let across = [Axis::X, Axis::Y].map(|component| RotaryAxisCoordinate { axis: about_z, component });
    Ok(across.into_iter().chain(z).collect())
}

fn describe_programs(slot: WorkOffsetSlot, search: Option<&ProgramSearch>) -> String {
    let Some(ProgramSearch { folder, found, unsearched_count }) = search else {
        return format!("programs with {slot} are not searched: check which ones use it, because its zero moves");
    };
    let folder = folder.display();
    let found = match found.is_empty() {
        true => format!("no program in {folder} contains {slot}"),
        false => {
            format!("the zero of these programs in {folder} moves, because they contain {slot}: {}", found.join(", "))
        }
    };
    match unsearched_count {
        0 => found,
        count => format!("{found}; {count} programs are not searched to their end"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(coordinates: &[RotaryAxisCoordinate]) -> Vec<String> {
        coordinates.iter().map(|own| format!("{} of {}", own.component, own.axis)).collect()
    }

    #[test]
    fn centre_of_a_tilting_table_has_the_height_of_the_tilting_axis() {
        let mut machine = MachineFile::built_in_for_method("samba").unwrap().machine;
        assert_eq!(names(&rotary_centre(&machine).unwrap()), ["X of C", "Y of C", "Z of B"], "{}", machine.topology);
        machine.topology = machine.topology.replace("B-", "");
        machine.axes.remove(&Axis::B);
        assert_eq!(names(&rotary_centre(&machine).unwrap()), ["X of C", "Y of C"], "{}", machine.topology);
        machine.topology = machine.topology.replace("C-", "");
        machine.axes.remove(&Axis::C);
        assert!(matches!(rotary_centre(&machine), Err(TargetError::NoRotaryTable { .. })), "{}", machine.topology);
    }

    #[test]
    fn programs_are_named() {
        let slot = "G55".parse().unwrap();
        assert!(describe_programs(slot, None).contains("programs with G55 are not searched"));
        let mut search = ProgramSearch { folder: "/nc".into(), found: Vec::new(), unsearched_count: 0 };
        assert_eq!(describe_programs(slot, Some(&search)), "no program in /nc contains G55");
        search.found = vec!["a.ngc".to_owned(), "b.ngc".to_owned()];
        search.unsearched_count = 2;
        let text = describe_programs(slot, Some(&search));
        assert!(text.contains("contain G55: a.ngc, b.ngc; 2 programs are not searched"), "{text}");
    }
}
