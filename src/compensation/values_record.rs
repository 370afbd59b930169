//! The values of the control at the start of a run, for its record, and their comparison with the journal.

use super::target::TargetError;
use super::targets::open_target;
use crate::setup::{CompensationConfig, MachineFile};
use crate::store::{CompensationState, StoredCompensation, StoredRun};
use devices::compensation::are_values_equal;
use machine::record::event::RunEvent;
use methods::compensation::ControlValue;

/// Sentences on the present compensation values of the control, and on their differences from the `stored`
/// compensations of its machine, newest first. Values that are read over the link of the control are left out: the run
/// uses this link, and the readings do not contain their effect. Blocks the thread.
pub fn describe_compensation_values(file: &MachineFile, stored: &[StoredCompensation]) -> Vec<String> {
    let of_target = |config: &CompensationConfig| {
        let last = stored.iter().find(|own| own.target == config.kind());
        describe_values(file, config.kind(), last)
    };
    file.compensation.iter().filter(|config| !config.needs_control_link()).flat_map(of_target).collect()
}

fn describe_values(file: &MachineFile, kind: &str, last: Option<&StoredCompensation>) -> Vec<String> {
    let values = match read_values_in_effect(file, kind) {
        Ok(values) => values,
        Err(error) => return vec![format!("the compensation values of the control ({kind}) are unknown: {error}")],
    };
    let of_last =
        last.and_then(|last| describe_differences(&values, last).or_else(|| describe_missing_verification(last)));
    [values_message(kind, &values)].into_iter().chain(of_last).collect()
}

/// Sentence about a last compensation that is not verified, or not confirmed; otherwise `None`.
fn describe_missing_verification(last: &StoredCompensation) -> Option<String> {
    let id = last.id;
    match last.state {
        CompensationState::Written => Some(format!(
            "compensation {id} is not verified: verify it with this run, if it measures at other positions than run {} \
             (`trued compensate verify`)",
            last.run
        )),
        CompensationState::NotConfirmed => Some(format!(
            "compensation {id} is not confirmed by its verification: restore the values before it, or find the cause"
        )),
        _ => None,
    }
}

/// The present values, after a check that the control uses them.
fn read_values_in_effect(file: &MachineFile, kind: &str) -> Result<Vec<ControlValue>, TargetError> {
    let target = open_target(file, Some(kind))?;
    let values = target.read()?.values().to_vec();
    target.check_in_effect(&[])?;
    Ok(values)
}

/// Message that states the values of the control, for the record of a run. Checks that a run used the present values
/// compare this text, so its form must not change.
fn values_message(kind: &str, values: &[ControlValue]) -> String {
    let listed: Vec<String> = values.iter().map(|value| format!("{} {} mm", value.name, value.text)).collect();
    format!("{}{}", values_message_prefix(kind), listed.join(", "))
}

fn values_message_prefix(kind: &str) -> String {
    format!("compensation values of the control ({kind}): ")
}

/// Journaled values of the compensation files, whose effect the readings contain. Empty: the machine has no
/// compensation files. `None`: the journal does not confirm that the control used the same files during the whole run.
pub fn recorded_compensation_file_values<'a>(file: &MachineFile, stored: &'a StoredRun) -> Option<&'a str> {
    let Some(config) = file.compensation.iter().find(|config| config.is_in_readings()) else { return Some("") };
    let prefix = values_message_prefix(config.kind());
    let mut recorded = stored.events.iter().filter_map(|(_, event)| match event {
        RunEvent::OperatorMessage { text } if text.starts_with(&prefix) => Some(text.as_str()),
        _ => None,
    });
    let first = recorded.next()?;
    recorded.all(|text| text == first).then_some(first)
}

/// Whether the run recorded these values of the control, and no other values.
pub(super) fn records_same_values(stored: &StoredRun, kind: &str, values: &[ControlValue]) -> bool {
    let [prefix, present] = [values_message_prefix(kind), values_message(kind, values)];
    let mut recorded = stored.events.iter().filter_map(|(_, event)| match event {
        RunEvent::OperatorMessage { text } => text.starts_with(&prefix).then_some(text),
        _ => None,
    });
    let first = recorded.next();
    first.is_some_and(|text| *text == present) && recorded.all(|text| *text == present)
}

/// Sentence about values of the control that differ from those of the last compensation (after an undo: from those
/// before it); `None` if all agree.
fn describe_differences(values: &[ControlValue], last: &StoredCompensation) -> Option<String> {
    let is_undone = last.state.is_undone();
    let differences = last.changes.iter().filter_map(|change| {
        let expected_mm = if is_undone { change.before_mm } else { change.after_mm };
        let present_mm = values.iter().find(|value| value.name == change.name)?.present_mm;
        let differs = !are_values_equal(present_mm, expected_mm);
        differs.then(|| format!("{} is {present_mm} mm, not {expected_mm} mm", change.name))
    });
    let differences: Vec<String> = differences.collect();
    (!differences.is_empty()).then(|| {
        format!(
            "the values in the control differ from compensation {}, which is {}: {}. A control may lose its values \
             at a restart",
            last.id,
            last.state.as_str(),
            differences.join(", ")
        )
    })
}
