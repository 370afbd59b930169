//! How the control homes an axis, and the ends of the axis' travel after homing (grblHAL
//! `motion_control.c`, `mc_homing_cycle`; `machine_limits.c`, `limits_set_work_envelope`).

use super::message::GrblMessage;
use super::settings::{
    FIRST_SIMULATED_TRAVEL_SETTINGS, GrblSettings, HARD_LIMITS_MASK, HOMING_ENABLED_MASK, MANUAL_HOMING_MASK,
    ZERO_AT_SWITCH_MASK,
};
use machine::Axis;

/// Settings that list the axes of the homing cycles, one setting a cycle.
const HOMING_CYCLE_SETTINGS: std::ops::Range<u16> = 44..50;

/// How the zero of an axis is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HomingMethod {
    /// Homing is off.
    Off,
    /// A switch: the axis is in a homing cycle.
    Switch,
    /// `$H` sets the zero at the end of travel to which the operator has moved the axis.
    Manual,
    /// The axis is in no homing cycle.
    InNoCycle,
    /// The control does not list its homing cycles.
    CyclesNotReported,
}

/// How the axis is homed, from the settings. `axis_index` is the index of the axis in the reports, from 0.
pub(super) fn homing_method(settings: &GrblSettings, axis_index: u16) -> HomingMethod {
    let is_listed = HOMING_CYCLE_SETTINGS.into_iter().any(|cycle| settings.value(cycle).is_some());
    let in_cycle = HOMING_CYCLE_SETTINGS.into_iter().any(|cycle| settings.has_bit(cycle, 1 << axis_index));
    match () {
        () if !settings.has_bit(22, HOMING_ENABLED_MASK) => HomingMethod::Off,
        () if in_cycle => HomingMethod::Switch,
        () if settings.has_bit(22, MANUAL_HOMING_MASK) => HomingMethod::Manual,
        () if is_listed => HomingMethod::InNoCycle,
        () => HomingMethod::CyclesNotReported,
    }
}

/// Bit mask of the homed axes, from `[HOME:..:mask]` of `$#`. 0 if it is not reported.
pub(super) fn homed_axes_mask(offsets: &[GrblMessage]) -> u32 {
    let mask = offsets.iter().find_map(|message| match message {
        GrblMessage::HomedAxesMask(mask) => Some(*mask),
        _ => None,
    });
    mask.unwrap_or(0)
}

/// Whether the control homes the axis; `None` if the control does not report it. With manual homing, `$H` homes all
/// axes and `$HX` only X: an axis that is not homed while others are has no homing.
pub(super) fn has_homing(settings: &GrblSettings, axis_index: u16, homed_axes_mask: u32) -> Option<bool> {
    let is_homed = homed_axes_mask >> axis_index & 1 == 1;
    match homing_method(settings, axis_index) {
        HomingMethod::Off => None,
        HomingMethod::Switch => Some(true),
        HomingMethod::Manual => Some(is_homed || homed_axes_mask == 0),
        HomingMethod::InNoCycle => Some(is_homed),
        HomingMethod::CyclesNotReported => is_homed.then_some(true),
    }
}

/// Ends of the travel in machine coordinates after homing, mm or degrees; `None` if they are not known.
pub(super) fn travel_limits(
    settings: &GrblSettings,
    axis: Axis,
    axis_index: u16,
    homed_axes_mask: u32,
) -> Option<(f64, f64)> {
    let travel = settings.value(130 + axis_index).filter(|travel| *travel > 0.0)?;
    let method = homing_method(settings, axis_index);
    let is_homed = has_homing(settings, axis_index, homed_axes_mask);
    let counts_from_home = match method {
        HomingMethod::Off | HomingMethod::InNoCycle => false,
        _ => is_homed == Some(true) || axis.is_linear(),
    };
    if !counts_from_home {
        return None;
    }
    let simulated = FIRST_SIMULATED_TRAVEL_SETTINGS.map(|first| settings.value(first + axis_index));
    if let [Some(min), Some(max)] = simulated {
        return Some((min, max));
    }
    // With hard limits an axis of a homing cycle keeps the pull-off distance from its switch. An axis that
    // may be in a cycle counts as part of one.
    let has_switch = matches!(method, HomingMethod::Switch | HomingMethod::CyclesNotReported);
    let pull_off_mm = if has_switch && settings.has_bit(21, HARD_LIMITS_MASK) { settings.value(27)? } else { 0.0 };
    Some(match (settings.has_bit(22, ZERO_AT_SWITCH_MASK), settings.has_bit(23, 1 << axis_index)) {
        (true, true) => (0.0, travel - pull_off_mm),
        (true, false) => (pull_off_mm - travel, 0.0),
        // `0.0 - x` instead of `-x`: -0.0 would appear in the machine file.
        (false, _) => (pull_off_mm - travel, 0.0 - pull_off_mm),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grbl_settings(numbers: &[(u16, f64)]) -> GrblSettings {
        GrblSettings(numbers.iter().copied().collect())
    }

    #[test]
    fn axis_left_out_of_manual_homing_has_no_homing() {
        let by_hand = grbl_settings(&[(22, 35.0), (44, 0.0), (130, 400.0), (133, 360.0)]);
        for (mask, homed) in [(0, true), (7, false), (31, true)] {
            assert_eq!(has_homing(&by_hand, 3, mask), Some(homed), "{mask}");
            assert_eq!(travel_limits(&by_hand, Axis::X, 0, mask), Some((-400.0, 0.0)));
            let turns = travel_limits(&by_hand, Axis::B, 3, mask);
            assert_eq!(turns, homed.then_some((-360.0, 0.0)));
        }
    }

    #[test]
    fn rotary_axis_without_cycle_list_is_judged_by_the_mask() {
        let unlisted = grbl_settings(&[(22, 1.0), (130, 400.0)]);
        assert_eq!(has_homing(&unlisted, 3, 7), None);
        assert_eq!(has_homing(&unlisted, 3, 15), Some(true));
        let listed = grbl_settings(&[(22, 1.0), (44, 7.0)]);
        assert_eq!(has_homing(&listed, 3, 7), Some(false));
        assert_eq!(has_homing(&grbl_settings(&[(22, 0.0), (44, 7.0)]), 3, 0), None);
    }
}
