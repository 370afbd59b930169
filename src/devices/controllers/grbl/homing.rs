//! How the control homes an axis, and the ends of the axis' travel after homing (grblHAL
//! `motion_control.c`, `mc_homing_cycle`; `machine_limits.c`, `limits_set_work_envelope`).

use super::message::Message;
use super::settings::{BY_HAND, HARD_LIMITS, HOMING, SIMULATED_ENDS, SWITCH_IS_ZERO, Settings};
use machine::Axis;

/// Settings that list the axes of the homing cycles, one setting a cycle.
const CYCLES: std::ops::Range<u16> = 44..50;

/// What defines the zero of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HomedBy {
    /// Homing is off.
    Off,
    /// A switch: the axis is in a homing cycle.
    Cycle,
    /// `$H` sets the zero at the end of travel to which the operator has moved the axis.
    Hand,
    /// The axis is in no homing cycle.
    Nothing,
    /// The control does not list its homing cycles.
    NotListed,
}

/// How the axis is homed, from the settings. `place` is the index of the axis in the reports.
pub(super) fn homed_by(settings: &Settings, place: u16) -> HomedBy {
    let is_listed = CYCLES.into_iter().any(|cycle| settings.value(cycle).is_some());
    let in_cycle = CYCLES.into_iter().any(|cycle| settings.has(cycle, 1 << place));
    match () {
        () if !settings.has(22, HOMING) => HomedBy::Off,
        () if in_cycle => HomedBy::Cycle,
        () if settings.has(22, BY_HAND) => HomedBy::Hand,
        () if is_listed => HomedBy::Nothing,
        () => HomedBy::NotListed,
    }
}

/// Bit mask of the homed axes, from `[HOME:..:mask]` of `$#`.
pub(super) fn homed_mask(offsets: &[Message]) -> u32 {
    let mask = offsets.iter().find_map(|message| match message {
        Message::Homed(mask) => Some(*mask),
        _ => None,
    });
    mask.unwrap_or(0)
}

/// Whether the control homes the axis; `None` if the control does not report it. By hand, `$H` homes all
/// axes and `$HX` one of them: an axis that is not homed while others are has no homing.
pub(super) fn is_homed_axis(settings: &Settings, place: u16, homed_mask: u32) -> Option<bool> {
    let is_homed = homed_mask >> place & 1 == 1;
    match homed_by(settings, place) {
        HomedBy::Off => None,
        HomedBy::Cycle => Some(true),
        HomedBy::Hand => Some(is_homed || homed_mask == 0),
        HomedBy::Nothing => Some(is_homed),
        HomedBy::NotListed => is_homed.then_some(true),
    }
}

/// Ends of the travel in machine coordinates after homing: from 0 to one side.
pub(super) fn travel_ends(
    settings: &Settings,
    (axis, place): (Axis, u16),
    homed_mask: u32,
) -> Option<(f64, f64)> {
    let travel = settings.value(130 + place).filter(|travel| *travel > 0.0)?;
    let by = homed_by(settings, place);
    let is_homed = is_homed_axis(settings, place, homed_mask);
    let counts_from_home = match by {
        HomedBy::Off | HomedBy::Nothing => false,
        _ => is_homed == Some(true) || axis.is_linear(),
    };
    if !counts_from_home {
        return None;
    }
    let simulated = SIMULATED_ENDS.map(|first| settings.value(first + place));
    if let [Some(min), Some(max)] = simulated {
        return Some((min, max));
    }
    // With hard limits an axis of a homing cycle keeps the pull-off distance from its switch. An axis that
    // may be in a cycle counts as part of one.
    let has_switch = matches!(by, HomedBy::Cycle | HomedBy::NotListed);
    let clear = if has_switch && settings.has(21, HARD_LIMITS) { settings.value(27)? } else { 0.0 };
    Some(match (settings.has(22, SWITCH_IS_ZERO), settings.has(23, 1 << place)) {
        (true, true) => (0.0, travel - clear),
        (true, false) => (clear - travel, 0.0),
        // Not the negated value: it would be written to a file as -0.0.
        (false, _) => (clear - travel, 0.0 - clear),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(numbers: &[(u16, f64)]) -> Settings {
        Settings(numbers.iter().copied().collect())
    }

    #[test]
    fn an_axis_left_out_while_others_are_homed_by_hand_has_no_homing() {
        let by_hand = settings(&[(22, 35.0), (44, 0.0), (130, 400.0), (133, 360.0)]);
        for (mask, homed) in [(0, true), (7, false), (31, true)] {
            assert_eq!(is_homed_axis(&by_hand, 3, mask), Some(homed), "{mask}");
            assert_eq!(travel_ends(&by_hand, (Axis::X, 0), mask), Some((-400.0, 0.0)));
            let turns = travel_ends(&by_hand, (Axis::B, 3), mask);
            assert_eq!(turns, homed.then_some((-360.0, 0.0)));
        }
    }

    #[test]
    fn without_a_list_of_cycles_a_rotary_axis_is_judged_by_the_mask_alone() {
        let unlisted = settings(&[(22, 1.0), (130, 400.0)]);
        assert_eq!(is_homed_axis(&unlisted, 3, 7), None);
        assert_eq!(is_homed_axis(&unlisted, 3, 15), Some(true));
        let listed = settings(&[(22, 1.0), (44, 7.0)]);
        assert_eq!(is_homed_axis(&listed, 3, 7), Some(false));
        assert_eq!(is_homed_axis(&settings(&[(22, 0.0), (44, 7.0)]), 3, 0), None);
    }
}
