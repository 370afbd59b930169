//! Reads rendered text back and compares it with the intended motions.

use std::f64::consts::TAU;

use super::dialect::Dialect;
use super::error::ReadBackMismatch;
use super::rs274::{self, MotionFrame, MotionKind, ReadError, ReadMotion};
use machine::Axis;
use machine::record::motion::Motion;

/// Half a unit of the third decimal, plus rounding; feeds (mm/min), seconds and orientations (degrees) have three
/// decimals.
const THIRD_DECIMAL_TOLERANCE: f64 = 0.000_501;

impl Dialect {
    /// Motions of `text`, which this dialect has rendered, as its control will understand them.
    ///
    /// # Errors
    /// The first line that is not understood.
    pub fn read_back(&self, text: &str) -> Result<Vec<ReadMotion>, ReadError> {
        rs274::read_program(text, Some(&self.dialect_file.work_offset), &self.options.declared_commands)
    }

    /// Maximum difference between a position and the intended one, mm or rad: half a unit of the last decimal, and a
    /// small allowance for the decimal fraction itself. For S it is the tolerance of the third decimal of a degree.
    pub fn position_rounding_tolerance(&self, axis: Axis) -> f64 {
        let decimals = match axis {
            Axis::S => return axis.to_mm_or_rad(THIRD_DECIMAL_TOLERANCE),
            axis if axis.is_linear() => self.dialect_file.decimals_mm,
            _ => self.dialect_file.decimals_deg,
        };
        axis.to_mm_or_rad(0.501 * 0.1_f64.powi(decimals as i32))
    }

    /// Checks that the read motions mean exactly the motions of one step. Targets agree to half a unit of the last
    /// decimal, all in machine coordinates.
    ///
    /// # Errors
    /// The number of motions differs, or a motion has another meaning; the error names the first such motion.
    pub fn check_read_motions(
        &self,
        step: u32,
        expected: &[Motion],
        read: &[ReadMotion],
    ) -> Result<(), ReadBackMismatch> {
        if expected.len() != read.len() {
            return Err(ReadBackMismatch::MotionCountDiffers { expected: expected.len(), read: read.len() });
        }
        expected.iter().zip(read).try_for_each(|(motion, read)| {
            let differs = |reason| ReadBackMismatch::MotionDiffers { step, line: read.line, reason };
            self.check_read_motion(step, motion, read).map_err(differs)
        })
    }

    fn check_read_motion(&self, step: u32, motion: &Motion, read: &ReadMotion) -> Result<(), String> {
        if read.step_number != Some(step) {
            let found = read.step_number.map_or_else(|| "missing".to_owned(), |number| number.to_string());
            return Err(format!("the step number (N word) is {found} instead of {step}"));
        }
        if read.frame != MotionFrame::Machine {
            return Err(format!("the motion is in the frame {:?}", read.frame));
        }
        let (to, feed) = match (motion, read.kind) {
            (Motion::Rapid { to }, MotionKind::Rapid) => (to, None),
            (Motion::BackOff { to, feed_mm_min } | Motion::Feed { to, feed_mm_min }, MotionKind::Feed)
            | (Motion::Guarded { to, feed_mm_min }, MotionKind::Probe { must_touch: false })
            | (Motion::Probe { to, feed_mm_min }, MotionKind::Probe { .. }) => (to, Some(*feed_mm_min)),
            (Motion::Dwell { seconds }, MotionKind::Dwell { seconds: read }) => {
                return check_value_within_tolerance("dwell", *seconds, read, THIRD_DECIMAL_TOLERANCE);
            }
            (Motion::OrientSpindle { s }, MotionKind::OrientSpindle { s: read }) => {
                let turn = (s - read + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
                let turn_deg = Axis::S.to_mm_or_deg(turn);
                return check_value_within_tolerance("orientation", 0.0, turn_deg, THIRD_DECIMAL_TOLERANCE);
            }
            (_, kind) => return Err(format!("the motion is a {kind:?}")),
        };
        if to.iter().count() != read.target.iter().count() {
            return Err("the motion moves other axes".to_owned());
        }
        for (axis, value) in to.iter() {
            let other = read.target.get(axis).ok_or_else(|| format!("{axis} does not move"))?;
            let half_unit = self.position_rounding_tolerance(axis);
            let [value, other, half_unit] = [value, other, half_unit].map(|value| axis.to_mm_or_deg(value));
            check_value_within_tolerance(axis.name(), value, other, half_unit)?;
        }
        match (feed, read.feed_mm_min) {
            (Some(feed), Some(read)) => check_value_within_tolerance("feed", feed, read, THIRD_DECIMAL_TOLERANCE),
            (None, None) => Ok(()),
            _ => Err("the feed is missing or unexpected".to_owned()),
        }
    }
}

/// Checks that two values agree; a NaN as either value is refused.
fn check_value_within_tolerance(what: &str, expected: f64, read: f64, tolerance: f64) -> Result<(), String> {
    if (expected - read).abs() <= tolerance {
        return Ok(());
    }
    Err(format!("{what} is {read} instead of {expected}"))
}
