//! The values of the control at the start of a run, for its record, and their comparison with the journal.

use super::target::{CompensationTarget, TargetError};
use crate::setup::MachineFile;
use crate::store::{CompensationState, StoredCompensation};
use devices::compensation::linuxcnc_trunnion::MAX_READ_BACK_DEVIATION_MM;
use methods::compensation::ControlValue;

/// Sentences on the values that the control holds now, and on differences from the `last` compensation of its machine.
/// Blocks the thread.
pub fn describe_values_of_control(file: &MachineFile, last: Option<&StoredCompensation>) -> Vec<String> {
    let values = match read_values(file) {
        Ok(values) => values,
        Err(error) => return vec![format!("the compensation values of the control are unknown: {error}")],
    };
    let listed: Vec<String> = values.iter().map(|value| format!("{} {} mm", value.name, value.present_mm)).collect();
    let listed = format!("compensation values of the control: {}", listed.join(", "));
    [listed].into_iter().chain(last.and_then(|last| describe_differences(&values, last))).collect()
}

fn read_values(file: &MachineFile) -> Result<Vec<ControlValue>, TargetError> {
    Ok(CompensationTarget::open(file)?.read()?.values().to_vec())
}

fn describe_differences(values: &[ControlValue], last: &StoredCompensation) -> Option<String> {
    let is_undone = last.state == CompensationState::Undone;
    let differences = last.changes.iter().filter_map(|change| {
        let expected_mm = if is_undone { change.before_mm } else { change.after_mm };
        let present_mm = values.iter().find(|value| value.name == change.name)?.present_mm;
        let differs = (present_mm - expected_mm).abs() >= MAX_READ_BACK_DEVIATION_MM;
        differs.then(|| format!("{} is {present_mm} mm, not {expected_mm} mm", change.name))
    });
    let differences: Vec<String> = differences.collect();
    (!differences.is_empty()).then(|| {
        format!(
            "the control does not hold the values of compensation {}, which is {}: {}. After a restart LinuxCNC has the \
             values of its HAL files",
            last.id,
            last.state.as_str(),
            differences.join(", ")
        )
    })
}
