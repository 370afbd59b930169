//! Stored `$` settings of the simulated control, derived from its machine. Numbers and meanings are those of grblHAL's
//! `settings.h`; the homing direction is that of its `machine_limits.c`.

use std::collections::BTreeMap;

use machine::Axis;
use machine::record::machine::Machine;

pub(super) const REPORT_MASK_SETTING: u16 = 10;
pub(super) const REPORT_INCHES_SETTING: u16 = 13;
/// Number of the setting for steps per mm or degree of the first axis; the numbers of the next axes follow.
const FIRST_STEPS_PER_UNIT_SETTING: u16 = 100;
/// Number of the setting for the maximum rate, mm/min or deg/min, of the first axis; the next axes follow.
const FIRST_MAX_RATE_SETTING: u16 = 110;
/// Number of the setting for the acceleration, mm/s² or deg/s², of the first axis; the next axes follow.
const FIRST_ACCELERATION_SETTING: u16 = 120;
/// Number of the setting for the length of the travel, mm or degrees, of the first axis; the next axes follow.
const FIRST_MAX_TRAVEL_SETTING: u16 = 130;

/// First numbers of the settings for minimum and maximum of the travel, an extension: grblHAL cannot express a
/// travel on both sides of zero.
const FIRST_MIN_AND_MAX_TRAVEL_SETTINGS: [u16; 2] = [9000, 9050];

/// Bit of the report mask: reports contain the state of the inputs.
pub(super) const REPORT_PINS_BIT: u32 = 1 << 4;
/// Bit of the report mask: reports contain the overrides.
pub(super) const REPORT_OVERRIDES_BIT: u32 = 1 << 6;

/// Steps per mm, or per degree of a rotary axis.
const MOTOR_STEPS_PER_UNIT: f64 = 1000.0;
/// Distance from the homing switch after homing, which adds to the travel of an axis with a switch.
const HOMING_PULL_OFF_MM: f64 = 1.0;
/// Homing mask: homing enabled, the switch position is zero, and an axis without a switch is homed at its
/// current position.
const HOMING_MASK: f64 = 1.0 + 8.0 + 32.0;

/// Settings of `machine`. An axis whose travel ends at zero homes there, onto a switch. grblHAL supports no
/// other travel, so the limits of any other axis are an extension.
pub(super) fn machine_settings(machine: &Machine) -> BTreeMap<u16, f64> {
    let axes = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
    let mut settings: BTreeMap<u16, f64> =
        [(0, 5.0), (1, 25.0), (2, 0.0), (3, 0.0), (4, 0.0), (5, 0.0), (6, 0.0)].into();
    settings.extend([(REPORT_MASK_SETTING, 511.0), (11, 0.01), (12, 0.002), (REPORT_INCHES_SETTING, 0.0)]);
    settings.extend([(20, 1.0), (21, 1.0), (22, HOMING_MASK), (27, HOMING_PULL_OFF_MM)]);
    let (mut homed_axes, mut to_negative, mut rotary_axes) = (0_u16, 0_u16, 0_u16);
    for ((axis, spec), number) in axes.zip(0_u16..) {
        let bit = 1 << number;
        let switched = spec.min == 0.0 || spec.max == 0.0;
        homed_axes |= if switched { bit } else { 0 };
        to_negative |= if spec.min == 0.0 { bit } else { 0 };
        rotary_axes |= if axis.is_linear() { 0 } else { bit };
        let pull_off = if switched { HOMING_PULL_OFF_MM } else { 0.0 };
        if !switched {
            settings.insert(FIRST_MIN_AND_MAX_TRAVEL_SETTINGS[0] + number, spec.min);
            settings.insert(FIRST_MIN_AND_MAX_TRAVEL_SETTINGS[1] + number, spec.max);
        }
        settings.insert(FIRST_STEPS_PER_UNIT_SETTING + number, MOTOR_STEPS_PER_UNIT);
        settings.insert(FIRST_MAX_RATE_SETTING + number, spec.rapid_per_min);
        settings.insert(FIRST_ACCELERATION_SETTING + number, spec.acceleration_per_s2);
        settings.insert(FIRST_MAX_TRAVEL_SETTING + number, spec.max - spec.min + pull_off);
    }
    settings.extend([(23, f64::from(to_negative)), (44, f64::from(homed_axes)), (376, f64::from(rotary_axes))]);
    settings
}

/// Setting as printed by `$$`: three decimals for settings 11, 12, 24, 25, 27 and 100 to 199; the others, such as
/// masks, counts and the travel limits of the extension, without rounding.
pub(super) fn format_setting(number: u16, value: f64) -> String {
    match number {
        11 | 12 | 24 | 25 | 27 | 100..200 => format!("${number}={value:.3}"),
        _ => format!("${number}={value}"),
    }
}
