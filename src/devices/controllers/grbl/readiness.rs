//! Conditions that the control must meet before its first motion. `check` reports the whole list, `prepare`
//! refuses the first item that prevents a measurement. Setting numbers and meanings are those of grblHAL
//! (`settings.h`).

use super::driver::GrblDriver;
use super::fault::override_finding;
use super::homing::{HomingMethod, homed_axes_mask, homing_method};
use super::message::GrblMessage;
use super::settings::{FirmwareInfo, GrblSettings, HOMING_ENABLED_MASK};
use crate::controllers::{ControllerError, ReadinessFinding, ReadinessItem};
use machine::Axis;

/// Masks of `$10`, and the field that each adds to the status reports.
const REQUIRED_REPORT_FIELDS: [(u32, &str); 4] =
    [(1, "the machine position"), (1 << 4, "the probe"), (1 << 7, "the probe's result"), (1 << 6, "the overrides")];

/// Items that the control does not report. A pendant is reported; another client of the same control is
/// not.
const UNREADABLE_ITEMS: [ReadinessItem; 3] =
    [ReadinessItem::Kinematics, ReadinessItem::OtherClients, ReadinessItem::ToolInSpindle];

pub(super) fn unreadable_items(firmware: &FirmwareInfo) -> Vec<ReadinessItem> {
    // Classic Grbl is locked until it is homed or unlocked; it reports neither.
    let homing = firmware.is_classic.then_some(ReadinessItem::Homing);
    UNREADABLE_ITEMS.into_iter().chain(homing).collect()
}

/// Words of `$G` for states in which no stylus may move: beginning of the word, state, remedy.
const BLOCKING_MODES: [(&str, &str, &str); 3] = [
    ("M3", "the spindle is on (M3)", "stop the spindle (M5): the stylus must not rotate"),
    ("M4", "the spindle is on (M4)", "stop the spindle (M5): the stylus must not rotate"),
    ("G51", "axes are scaled (G51)", "enter G50 at the control"),
];

/// A blocking remark for each of `BLOCKING_MODES` in force, from the answer to `$G`; none without that answer.
pub(super) fn blocking_mode_findings(modes: &[GrblMessage]) -> Vec<ReadinessFinding> {
    let words = modes.iter().find_map(|message| match message {
        GrblMessage::ModalWords(words) => Some(words.as_slice()),
        _ => None,
    });
    let is_in_force = |prefix: &str| {
        let is_it = |word: &String| word.split(['.', ':']).next() == Some(prefix);
        words.unwrap_or_default().iter().any(is_it)
    };
    let blocking_modes = BLOCKING_MODES.iter().filter(|(prefix, ..)| is_in_force(prefix));
    blocking_modes.map(|(_, state, remedy)| ReadinessFinding::blocking(*state, remedy)).collect()
}

/// Remark on an active tool length offset, from the answer to `$#` once G49 is in force.
pub(super) fn tool_length_finding(offsets: &[GrblMessage]) -> Option<ReadinessFinding> {
    let has_length = |message: &GrblMessage| {
        matches!(message, GrblMessage::Offset { name, values }
            if name == "TLO" && values.iter().any(|value| *value != 0.0))
    };
    offsets.iter().any(has_length).then(|| {
        ReadinessFinding::blocking(
            "a tool length offset is active (TLO)",
            "enter G49 at the control; the length of the stylus is set in the machine file (tool_mm)",
        )
    })
}

/// Remarks on the settings. `required_homed_axes`: axes that the control must home.
pub(super) fn settings_findings(
    firmware: &FirmwareInfo,
    settings: &GrblSettings,
    required_homed_axes: &[Axis],
) -> Vec<ReadinessFinding> {
    let axes = &firmware.axes_with_report_index();
    let mut findings = Vec::new();
    let mut add_blocking =
        |description: String, remedy: &str| findings.push(ReadinessFinding::blocking(description, remedy));
    // Classic Grbl has two bits in `$10` and always reports its inputs.
    let needed = if firmware.is_classic { &REQUIRED_REPORT_FIELDS[..1] } else { &REQUIRED_REPORT_FIELDS };
    let hidden: Vec<&str> =
        needed.iter().filter(|(bit, _)| !settings.has_bit(10, *bit)).map(|(_, description)| *description).collect();
    match settings.value(10) {
        None => add_blocking(
            "the control does not report its settings ($$): units, homing and limits are unknown".to_owned(),
            "bring the control to the state Idle; use grblHAL 1.1f or newer",
        ),
        Some(mask) if !hidden.is_empty() => add_blocking(
            format!("the status reports do not contain {} ($10={mask})", hidden.join(", ")),
            if firmware.is_classic { "enter $10=3 at the control" } else { "enter $10=511 at the control" },
        ),
        Some(_) => {}
    }
    if settings.has_bit(13, 1) {
        let description = "the control reports positions in inches ($13=1), but trued reads them as millimetres";
        add_blocking(description.to_owned(), "enter $13=0 at the control");
    }
    // A setting that is not reported counts as off.
    if !settings.has_bit(22, HOMING_ENABLED_MASK) {
        let description = "homing is off ($22=0): the zero of each axis is its position at power-on, so the travels \
                    and bodies of the machine file are at wrong positions";
        add_blocking(
            description.to_owned(),
            "fit homing switches and enter $22=1, or home by hand with $22=33; after that, `trued init` can read \
             the travel limits",
        );
    }
    if settings.value(20).unwrap_or_default() == 0.0 {
        let description = "soft limits are off ($20=0): the control does not refuse moves beyond the travel";
        add_blocking(description.to_owned(), "enter $20=1 once the axes are homed");
    }
    findings.extend(zero_travel_finding(settings, axes));
    findings.extend(homing_cycle_finding(settings, axes, required_homed_axes));
    findings
}

/// Blocking finding if the stored travel of a linear axis is zero: soft limits do not limit this axis. A rotary axis
/// may turn without end.
fn zero_travel_finding(settings: &GrblSettings, axes: &[(Axis, u16)]) -> Option<ReadinessFinding> {
    let zero = |(axis, index): &&(Axis, u16)| axis.is_linear() && settings.value(130 + index) == Some(0.0);
    let without: Vec<&(Axis, u16)> = axes.iter().filter(zero).collect();
    let (_, first) = without.first()?;
    let description =
        format!("soft limits do not limit {}: the travel in the settings is 0", join_axis_names(&without));
    Some(ReadinessFinding::blocking(
        description,
        &format!("enter the travel in mm at the control: ${} and following", 130 + first),
    ))
}

/// Blocking remark on the axes of `required_homed_axes` that are in no homing cycle, while homing is on.
fn homing_cycle_finding(
    settings: &GrblSettings,
    axes: &[(Axis, u16)],
    required_homed_axes: &[Axis],
) -> Option<ReadinessFinding> {
    let is_unhomed = |(axis, index): &&(Axis, u16)| {
        required_homed_axes.contains(axis) && homing_method(settings, *index) == HomingMethod::InNoCycle
    };
    let unhomed: Vec<&(Axis, u16)> = axes.iter().filter(is_unhomed).collect();
    (!unhomed.is_empty()).then(|| {
        let description = format!(
            "the control does not home {}: the zero is the position at power-on ($44 to $49)",
            join_axis_names(&unhomed)
        );
        ReadinessFinding::blocking(
            description,
            "add the axes to the homing cycle; for a rotary axis without a switch, set homing = \"none\" in \
             the machine file: the operator then confirms its zero before each run",
        )
    })
}

/// Remark on the axes of `required_homed_axes` that are not homed, from `[HOME:..:mask]` of `$#`. Classic Grbl does
/// not report this: its remark is not blocking.
pub(super) fn homed_state_finding(
    firmware: &FirmwareInfo,
    settings: &GrblSettings,
    required_homed_axes: &[Axis],
    offsets: &[GrblMessage],
) -> Option<ReadinessFinding> {
    if firmware.is_classic {
        // Classic Grbl is locked until it is homed or an operator unlocks it.
        return settings.has_bit(22, HOMING_ENABLED_MASK).then(|| {
            let description = "this control does not report whether its axes are homed";
            ReadinessFinding::non_blocking(
                description,
                "home the machine before each measurement ($H); do not unlock the control ($X)",
            )
        });
    }
    let mask = homed_axes_mask(offsets);
    let is_unhomed = |(axis, index): &&(Axis, u16)| required_homed_axes.contains(axis) && mask >> index & 1 == 0;
    let axes = firmware.axes_with_report_index();
    let unhomed: Vec<&(Axis, u16)> = axes.iter().filter(is_unhomed).collect();
    (!unhomed.is_empty()).then(|| {
        let description = format!(
            "{} not homed since the control was started or reset: machine zero is unknown",
            match unhomed.len() {
                1 => format!("{} is", join_axis_names(&unhomed)),
                _ => format!("{} are", join_axis_names(&unhomed)),
            }
        );
        let by_hand = unhomed.iter().any(|(_, index)| homing_method(settings, *index) == HomingMethod::Manual);
        let remedy = if by_hand {
            "the machine is homed by hand: $H sets the zero at the present position. Jog Z up, then each axis to its \
             end, turn the rotary axes to their marks; then enter $H and start again"
        } else {
            "inspect the machine, home it ($H) at the control, start again"
        };
        ReadinessFinding::blocking(description, remedy)
    })
}

/// Returns the first finding that prevents a measurement as an error.
pub(super) fn reject_blocking(findings: impl IntoIterator<Item = ReadinessFinding>) -> Result<(), ControllerError> {
    match findings.into_iter().find(|remark| remark.is_blocking) {
        Some(ReadinessFinding { description, remedy, .. }) => {
            Err(ControllerError::NotReady { state: description, remedy })
        }
        None => Ok(()),
    }
}

fn join_axis_names(axes: &[&(Axis, u16)]) -> String {
    axes.iter().map(|(axis, _)| axis.to_string()).collect::<Vec<_>>().join(", ")
}

impl GrblDriver {
    /// Refuses overrides other than 100 %, as last reported; accepts overrides that were never reported.
    pub(super) fn check_overrides(&self) -> Result<(), ControllerError> {
        reject_blocking(self.connection.last_overrides.and_then(override_finding))
    }

    /// Remarks on the status report with all its fields; classic Grbl has no such report and reports its
    /// overrides from time to time.
    pub(super) async fn state_findings(
        &mut self,
        firmware: &FirmwareInfo,
    ) -> Result<Vec<ReadinessFinding>, ControllerError> {
        let status = if firmware.is_classic {
            self.connection.read_status().await?
        } else {
            self.connection.read_full_status().await?
        };
        let mut findings = Vec::new();
        if status.machine_position.is_none() {
            findings.push(ReadinessFinding::blocking(
                "the status reports do not contain the machine position (MPos)",
                "enter $10=511 at the control (classic Grbl: $10=3)",
            ));
        }
        if status.is_pendant_in_control {
            findings.push(ReadinessFinding::blocking(
                "a pendant controls the machine (MPG mode)",
                "switch the pendant off, start again",
            ));
        }
        match self.connection.last_overrides {
            Some(overrides) => findings.extend(override_finding(overrides)),
            None if firmware.is_classic => findings.push(ReadinessFinding::non_blocking(
                "the overrides are not reported yet",
                "set both overrides to 100 % at the control",
            )),
            None => findings.push(ReadinessFinding::blocking(
                "the status reports do not contain the overrides (Ov)",
                "enter $10=511 at the control",
            )),
        }
        Ok(findings)
    }
}
