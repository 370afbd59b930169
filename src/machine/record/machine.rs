//! The machine, its probe and its artefact, as the machine file and the plan declare them.
//!
//! Keys contain their units (`_mm`, `_um`, `_deg`); `min`, `max` and the speeds of an axis are in mm for X, Y, Z
//! and in degrees for A, B, C, S.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{default_value, is_default};
use crate::{Axis, Position};

/// Sense of a positive command: `iso` after ISO 841, `reversed` the opposite.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AxisSense {
    #[default]
    Iso,
    Reversed,
}

impl AxisSense {
    pub fn direction_sign(self) -> f64 {
        match self {
            AxisSense::Iso => 1.0,
            AxisSense::Reversed => -1.0,
        }
    }
}

/// Method by which an axis finds its zero after the control has started.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Homing {
    /// The control homes the axis.
    #[default]
    Switch,
    /// A rotary axis without a switch: the operator confirms its zero before each run.
    None,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    pub name: String,
    /// Axes from the workpiece to the tool, e.g. `w-C-B-X-F-Z-Y-S-t` or `V[w-C-B-b-Y-X-Z-(C)-t]` (ISO 10791).
    pub topology: String,
    #[serde(default)]
    pub axes: BTreeMap<Axis, StatedAxis>,
    /// Position of the stylus-ball centre relative to the spindle datum.
    #[serde(default)]
    pub tool_mm: [f64; 3],
    /// Declared thermal drift between table and spindle: standard deviation of its rate in each of X, Y and Z, and
    /// of the rate of a round part's radius.
    #[serde(default)]
    pub drift_um_per_h: f64,
    /// Standard deviation of the squareness error between each two of X, Y and Z.
    #[serde(default, skip_serializing_if = "is_default")]
    pub squareness_urad: f64,
}

impl Machine {
    /// Smallest acceleration of X, Y and Z, mm/s².
    pub fn min_linear_acceleration_mm_s2(&self) -> f64 {
        let linear = self.axes.iter().filter(|(axis, _)| axis.is_linear());
        linear.map(|(_, spec)| spec.acceleration_per_s2).fold(f64::INFINITY, f64::min)
    }

    /// Position of the rotary axes alone: each at zero, or at the limit nearest to zero. Neither X, Y, Z nor S is
    /// contained: the spindle keeps its orientation.
    pub fn rotary_zero_position(&self) -> Position {
        let rotary = self.axes.iter().filter(|(axis, _)| !axis.is_linear() && **axis != Axis::S);
        rotary.map(|(axis, spec)| (*axis, axis.to_mm_or_rad(spec.position_nearest_zero()))).collect()
    }
}

/// Properties of an axis, as declared in `[axes.X]` of the machine file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedAxis {
    /// Sense of a positive command of the axis.
    #[serde(default)]
    pub positive: AxisSense,
    /// A point on a rotary axis, all axes at zero, machine frame.
    #[serde(default)]
    pub point_mm: [f64; 3],
    /// Direction, machine frame; `[0,0,0]` means the nominal direction of the axis after ISO 841.
    #[serde(default)]
    pub direction: [f64; 3],
    /// Lower travel limit, mm or degrees.
    pub min: f64,
    /// Upper travel limit, mm or degrees.
    pub max: f64,
    #[serde(default, skip_serializing_if = "is_default")]
    pub homing: Homing,
    /// Rapid speed, mm/min or deg/min.
    #[serde(default = "default_value::<10_000>")]
    pub rapid_per_min: f64,
    /// Acceleration, mm/s² or deg/s².
    #[serde(default = "default_value::<1_000>")]
    pub acceleration_per_s2: f64,
    /// Resolution of the displayed position, um (linear axes).
    #[serde(default)]
    pub resolution_um: f64,
    /// Declared error motions: standard deviation of the deviation along each of X, Y and Z, um. For a linear axis:
    /// positioning and straightness, at any position. For a rotary axis (ISO 230-7): at any angle, without the mean
    /// and without the part that turns with the axis once per revolution.
    #[serde(default)]
    pub error_motion_um: f64,
    /// For a rotary axis: harmonic orders of its error motion, each with an equal share of the variance. Empty:
    /// unknown; then each order that a method cannot separate counts with the whole variance.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub error_motion_orders: Vec<u32>,
    /// For a linear axis: standard uncertainty of the lost motion at a reversal that remains after the control's
    /// compensation, um.
    #[serde(default, skip_serializing_if = "is_default")]
    pub backlash_um: f64,
    /// For a linear axis: standard deviation of its angular error motion about each of X, Y and Z (roll, pitch,
    /// yaw), urad.
    #[serde(default, skip_serializing_if = "is_default")]
    pub angular_motion_urad: f64,
    /// Distance over which error motions of a linear axis change, mm.
    #[serde(default = "default_value::<200>")]
    pub error_wavelength_mm: f64,
    /// Clamp of a rotary axis that must be unclamped to turn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<Clamp>,
}

impl StatedAxis {
    /// Zero, or the limit nearest to it, mm or degrees.
    pub fn position_nearest_zero(&self) -> f64 {
        0.0_f64.max(self.min).min(self.max)
    }

    /// The integers n of the first and the last position n·`increment` (mm or degrees) within the limits.
    pub fn first_and_last_multiplier_within_limits(&self, increment: f64) -> [i64; 2] {
        [(self.min / increment - 1e-9).ceil() as i64, (self.max / increment + 1e-9).floor() as i64]
    }
}

/// Commands of the control, each one M word with its parameters, that switch the clamp of an axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clamp {
    pub close: String,
    pub open: String,
    /// Time that the clamp takes to open or close.
    #[serde(default = "default_clamp_wait")]
    pub wait_s: f64,
}

fn default_clamp_wait() -> f64 {
    0.5
}

/// The touch probe and its declared properties.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Probe {
    /// Identification of the stylus, e.g. its serial number: another stylus has another name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub stylus: String,
    /// Radius of the stylus ball.
    pub ball_radius_mm: f64,
    /// Standard uncertainty of one touch (repeatability of probe and machine), um. Absent: evaluated from the
    /// residuals alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability_um: Option<f64>,
    /// Standard deviation of the direction-dependent pre-travel (lobing), um.
    #[serde(default)]
    pub lobing_um: f64,
    /// Harmonic orders of the lobing, each with an equal share of the variance. Empty: the orders are unknown, and
    /// each order from 2 to 6 counts with the whole variance.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lobing_orders: Vec<u32>,
    /// Standard uncertainty of the stated stylus offset in each of X and Y, um.
    #[serde(rename = "stylus_offset_um", default)]
    pub u_stylus_offset_um: f64,
    /// Standard uncertainty of the stylus length in `tool_mm`, relative to the tool lengths in the control, um. Absent:
    /// unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub u_stylus_length_um: Option<f64>,
    /// Maximum age of a probe qualification for runs that touch, days. Absent: no qualification is required.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub qualified_within_days: Option<f64>,
    /// Radius of the stylus stem, from the ball's centre up along the spindle axis. 0: not declared, and therefore
    /// not checked.
    #[serde(default)]
    pub stem_radius_mm: f64,
    /// Length of the stylus stem from the centre of the stylus ball.
    #[serde(default)]
    pub stem_length_mm: f64,
    /// Radius of the probe body, from the end of the stem up. 0: not declared, and therefore not checked.
    #[serde(default)]
    pub body_radius_mm: f64,
    /// Length of the probe body from the upper end of the stem.
    #[serde(default)]
    pub body_length_mm: f64,
    /// Maximum deflection of the stylus beyond contact.
    #[serde(default = "default_value::<4>")]
    pub overtravel_mm: f64,
    /// Feed of a measuring touch.
    #[serde(default = "default_value::<30>")]
    pub feed_mm_min: f64,
    /// Feed of a search touch and of the retract after any touch.
    #[serde(default = "default_value::<300>")]
    pub search_feed_mm_min: f64,
    /// Feed of guarded positioning near the artefact: the braking distance from it must be within the overtravel.
    #[serde(default = "default_value::<1_500>")]
    pub guarded_feed_mm_min: f64,
    /// Command of the control that switches the probe on, e.g. `M64 P1`; absent: the probe is always on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on: Option<String>,
    /// Command of the control that switches the probe off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off: Option<String>,
    /// Dwell between positioning and touch.
    #[serde(default, skip_serializing_if = "is_default")]
    pub settle_s: f64,
    #[serde(default, skip_serializing_if = "is_default")]
    pub live_check: LiveCheck,
    /// Input of the control that is on while the probe reports an error: a number (LinuxCNC, `M66`) or the letter
    /// of a pin in status reports (grblHAL).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_input: Option<String>,
    /// Like `error_input`: on while the probe's battery is low.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub battery_input: Option<String>,
}

impl Probe {
    /// The probe without its declared uncertainties, without the limits and feeds that do not affect a touch, and
    /// without the control's commands. A probe qualification is valid for a probe that has the same identity.
    pub fn identity(&self) -> Self {
        Self {
            repeatability_um: None,
            lobing_um: 0.0,
            lobing_orders: Vec::new(),
            u_stylus_offset_um: 0.0,
            u_stylus_length_um: None,
            qualified_within_days: None,
            overtravel_mm: 0.0,
            search_feed_mm_min: 0.0,
            guarded_feed_mm_min: 0.0,
            on: None,
            off: None,
            live_check: LiveCheck::default(),
            error_input: None,
            battery_input: None,
            ..self.clone()
        }
    }
}

/// How a run checks that the probe works, before the machine moves near anything.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LiveCheck {
    /// The first touch shows that the probe works.
    #[default]
    Touch,
    /// The operator deflects the stylus.
    Person,
}

/// A body that nothing may collide with: a table, a clamp, the spindle nose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Solid {
    pub name: String,
    /// Part of the machine that carries the body.
    pub on: Carrier,
    /// With `radius_mm`, the two ends of a cylinder's axis; otherwise two opposite corners of a box. The frame is
    /// the carrier's, which is the machine frame when all axes are at zero (for the spindle: relative to the
    /// spindle datum).
    pub from_mm: [f64; 3],
    /// Other end of the cylinder's axis, or opposite corner of the box; frame as for `from_mm`.
    pub to_mm: [f64; 3],
    /// Radius of a cylinder; absent: the body is a box.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_mm: Option<f64>,
}

/// A part of the machine that carries solids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Carrier {
    #[serde(rename = "bed")]
    Bed,
    /// The end of the chain that carries the workpiece.
    #[serde(rename = "table")]
    Table,
    /// The end of the chain that carries the tool; the body does not turn with S.
    #[serde(rename = "spindle")]
    Spindle,
    /// The part that this axis moves directly.
    #[serde(untagged)]
    Axis(Axis),
}

/// A box that nothing may enter, machine frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Keepout {
    pub name: String,
    /// Corner with the smallest coordinates, machine frame.
    pub min_mm: [f64; 3],
    /// Corner with the largest coordinates, machine frame.
    pub max_mm: [f64; 3],
}
