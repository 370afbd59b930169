//! Conditions that the control must meet before its first motion. `check` reports the whole list, `prepare`
//! refuses the first item that prevents a measurement. Setting numbers and meanings are those of grblHAL
//! (`settings.h`).

use super::built::FirmwareInfo;
use super::driver::Grbl;
use super::fault::overridden;
use super::homing::{HomedBy, homed_by, homed_mask};
use super::message::Message;
use super::settings::{HOMING, Settings};
use crate::controllers::{ControllerError, ReadinessFinding, ReadinessItem};
use machine::Axis;

/// Bits of `$10`, and the field that each bit adds to the reports.
const REPORTED: [(u32, &str); 4] = [
    (1, "the machine position"),
    (1 << 4, "the probe"),
    (1 << 7, "the probe's result"),
    (1 << 6, "the overrides"),
];

/// Items that the control does not report. A pendant is reported; another client of the same control is
/// not.
const NOT_READABLE: [ReadinessItem; 3] =
    [ReadinessItem::Kinematics, ReadinessItem::OtherClients, ReadinessItem::Tool];

pub(super) fn not_readable(built: &FirmwareInfo) -> Vec<ReadinessItem> {
    // Classic Grbl is locked until it is homed or unlocked; it reports neither.
    let homing = built.classic.then_some(ReadinessItem::Homing);
    NOT_READABLE.into_iter().chain(homing).collect()
}

/// Words of `$G` for states in which no stylus may move: beginning of the word, state, remedy.
const HINDERING_MODES: [(&str, &str, &str); 3] = [
    ("M3", "the spindle is on (M3)", "stop the spindle (M5): a stylus must not turn"),
    ("M4", "the spindle is on (M4)", "stop the spindle (M5): a stylus must not turn"),
    ("G51", "axes are scaled (G51)", "enter G50 at the control"),
];

/// Remarks on the modal words in force, from the answer to `$G`.
pub(super) fn of_modes(modes: &[Message]) -> Vec<ReadinessFinding> {
    let words = modes.iter().find_map(|message| match message {
        Message::Modes(words) => Some(words.as_slice()),
        _ => None,
    });
    let is_in_force = |begins: &str| {
        let is_it = |word: &String| word.split(['.', ':']).next() == Some(begins);
        words.unwrap_or_default().iter().any(is_it)
    };
    let hindering = HINDERING_MODES.iter().filter(|(begins, ..)| is_in_force(begins));
    hindering.map(|(_, state, remedy)| ReadinessFinding::hinders(*state, remedy)).collect()
}

/// Remark on an active tool length offset, from the answer to `$#` once G49 is in force.
pub(super) fn tool_length(offsets: &[Message]) -> Option<ReadinessFinding> {
    let has_length = |message: &Message| {
        matches!(message, Message::Offset { name, values }
            if name == "TLO" && values.iter().any(|value| *value != 0.0))
    };
    offsets.iter().any(has_length).then(|| {
        ReadinessFinding::hinders(
            "a tool length offset is active (TLO)",
            "enter G49 at the control; the length of the stylus stands in the machine file (tool_mm)",
        )
    })
}

/// Remarks on the settings. `axes`: each axis with its index in the reports. `homed_axes`: axes that must
/// have a switch.
pub(super) fn of_settings(
    built: &FirmwareInfo,
    settings: &Settings,
    axes: &[(Axis, u16)],
    homed_axes: &[Axis],
) -> Vec<ReadinessFinding> {
    let mut remarks = Vec::new();
    let mut hinders =
        |what: String, remedy: &str| remarks.push(ReadinessFinding::hinders(what, remedy));
    // Classic Grbl has two bits in `$10` and always reports its inputs.
    let needed = if built.classic { &REPORTED[..1] } else { &REPORTED };
    let hidden: Vec<&str> =
        needed.iter().filter(|(bit, _)| !settings.has(10, *bit)).map(|(_, what)| *what).collect();
    match settings.value(10) {
        None => hinders(
            "it does not tell its settings ($$): units, homing and limits are unknown".to_owned(),
            "bring the control to Idle; use grblHAL 1.1f or newer",
        ),
        Some(mask) if !hidden.is_empty() => hinders(
            format!("its reports hide {} ($10={mask})", hidden.join(", ")),
            if built.classic {
                "enter $10=3 at the control"
            } else {
                "enter $10=511 at the control"
            },
        ),
        Some(_) => {}
    }
    if settings.has(13, 1) {
        let what = "it reports positions in inches ($13=1); here they are read as millimetres";
        hinders(what.to_owned(), "enter $13=0 at the control");
    }
    // A setting that is not reported counts as off.
    if !settings.has(22, HOMING) {
        let what = "its homing is off ($22=0): zero is where each axis stood when it was switched on, and \
                    no travel and no body of the machine file lies where it says";
        hinders(
            what.to_owned(),
            "fit homing switches and enter $22=1, or home by hand with $22=33; `trued init` can read where \
             the travel lies only after that",
        );
    }
    if settings.value(20).unwrap_or_default() == 0.0 {
        let what = "its soft limits are off ($20=0): the control refuses no move beyond its travel";
        hinders(what.to_owned(), "enter $20=1 once the axes are homed");
    }
    remarks.extend(unlimited(settings, axes));
    remarks.extend(without_switch(settings, axes, homed_axes));
    remarks
}

/// Remark on axes without limits: soft limits do not limit an axis whose stored travel is zero. A rotary
/// axis may turn without end.
fn unlimited(settings: &Settings, axes: &[(Axis, u16)]) -> Option<ReadinessFinding> {
    let zero =
        |(axis, place): &&(Axis, u16)| axis.is_linear() && settings.value(130 + place) == Some(0.0);
    let without: Vec<&(Axis, u16)> = axes.iter().filter(zero).collect();
    let (_, first) = without.first()?;
    let what = format!("its soft limits do not limit {}: their travel is 0", names(&without));
    Some(ReadinessFinding::hinders(
        what,
        &format!("enter the travel in mm at the control: ${} and so on", 130 + first),
    ))
}

/// Remark on the axes of `homed_axes` that the control does not home.
fn without_switch(
    settings: &Settings,
    axes: &[(Axis, u16)],
    homed_axes: &[Axis],
) -> Option<ReadinessFinding> {
    let is_lost = |(axis, place): &&(Axis, u16)| {
        homed_axes.contains(axis) && homed_by(settings, *place) == HomedBy::Nothing
    };
    let lost: Vec<&(Axis, u16)> = axes.iter().filter(is_lost).collect();
    (!lost.is_empty()).then(|| {
        let what = format!(
            "it does not home {}: zero is where they stood when it was started ($44 to $49)",
            names(&lost)
        );
        ReadinessFinding::hinders(
            what,
            "enter them into the homing cycle; of a rotary axis without a switch state homing = \"none\" in \
             the machine file: a person then confirms its zero before each run",
        )
    })
}

/// Remark on the axes of `homed_axes` that are not homed, from `[HOME:..:mask]` of `$#`.
pub(super) fn homed(
    built: &FirmwareInfo,
    settings: &Settings,
    axes: &[(Axis, u16)],
    homed_axes: &[Axis],
    offsets: &[Message],
) -> Option<ReadinessFinding> {
    if built.classic {
        // Classic Grbl is locked until it is homed or an operator unlocks it.
        return settings.has(22, HOMING).then(|| {
            let what = "whether its axes are homed is not readable on this control";
            ReadinessFinding::note(
                what,
                "home it before each measurement ($H), do not unlock it ($X)",
            )
        });
    }
    let mask = homed_mask(offsets);
    let is_lost =
        |(axis, place): &&(Axis, u16)| homed_axes.contains(axis) && mask >> place & 1 == 0;
    let lost: Vec<&(Axis, u16)> = axes.iter().filter(is_lost).collect();
    (!lost.is_empty()).then(|| {
        let what = format!(
            "{} not homed since the control was started or reset: machine zero is unknown",
            match lost.len() {
                1 => format!("{} is", names(&lost)),
                _ => format!("{} are", names(&lost)),
            }
        );
        let by_hand = lost.iter().any(|(_, place)| homed_by(settings, *place) == HomedBy::Hand);
        let remedy = if by_hand {
            "it is homed by hand: $H makes zero where the axes stand. Jog Z up, then each axis to its end, turn \
             the rotary axes to their marks; then $H, and start again"
        } else {
            "look at the machine, home it ($H) at the control, start again"
        };
        ReadinessFinding::hinders(what, remedy)
    })
}

/// Returns the first item that prevents a measurement as an error.
pub(super) fn refuse(
    remarks: impl IntoIterator<Item = ReadinessFinding>,
) -> Result<(), ControllerError> {
    match remarks.into_iter().find(|remark| remark.hinders) {
        Some(ReadinessFinding { what, remedy, .. }) => {
            Err(ControllerError::NotReady { state: what, remedy })
        }
        None => Ok(()),
    }
}

fn names(axes: &[&(Axis, u16)]) -> String {
    axes.iter().map(|(axis, _)| axis.to_string()).collect::<Vec<_>>().join(", ")
}

impl Grbl {
    /// Refuses overrides other than 100 %, as last reported.
    pub(super) fn speed_as_planned(&self) -> Result<(), ControllerError> {
        refuse(self.wire.overrides.and_then(overridden))
    }

    /// Remarks on the status report with all its fields; classic Grbl has no such report and reports its
    /// overrides from time to time.
    pub(super) async fn readiness_of_state(
        &mut self,
        built: &FirmwareInfo,
    ) -> Result<Vec<ReadinessFinding>, ControllerError> {
        let status =
            if built.classic { self.wire.status().await? } else { self.wire.full_status().await? };
        let mut remarks = Vec::new();
        if status.position.is_none() {
            remarks.push(ReadinessFinding::hinders(
                "its reports lack the machine position (MPos)",
                "enter $10=511 at the control (classic Grbl: $10=3)",
            ));
        }
        if status.has_pendant {
            remarks.push(ReadinessFinding::hinders(
                "a pendant has the control (MPG mode)",
                "switch the pendant off, start again",
            ));
        }
        match self.wire.overrides {
            Some(overrides) => remarks.extend(overridden(overrides)),
            None if built.classic => remarks.push(ReadinessFinding::note(
                "its overrides were not reported yet",
                "set them to 100 % at the control",
            )),
            None => remarks.push(ReadinessFinding::hinders(
                "its reports lack the overrides (Ov)",
                "enter $10=511 at the control",
            )),
        }
        Ok(remarks)
    }
}
