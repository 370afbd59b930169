//! Error of the tip over two axes at a time, with the other axes fixed, and its uncertainty, which remains after a
//! correction of the error.

use super::ErrorPredictor;
use crate::MethodRefusal;
use machine::{Axis, Position};

/// Number of positions of an axis over its range.
const POSITIONS_PER_AXIS: usize = 7;

/// Predicted error of the tip on a grid of two axes; the other axes are fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorSlice {
    /// Axis of the columns, with its positions in ascending order, mm or degrees.
    pub horizontal_axis: (Axis, Vec<f64>),
    /// Axis of the rows, with its positions in ascending order, mm or degrees.
    pub vertical_axis: (Axis, Vec<f64>),
    /// Positions of the other axes.
    pub other_positions: Position,
    /// Length of the error of the tip relative to the work zero, one row for each position of the vertical axis, mm.
    pub error_mm: Vec<Vec<f64>>,
    /// Standard uncertainty of the tip error, √(u_x² + u_y² + u_z²), arranged as `error_mm`, mm. It remains after a
    /// correction of all errors.
    pub u_mm: Vec<Vec<f64>>,
}

impl ErrorPredictor<'_> {
    /// Slices over X and Y at mid Z with the rotary axes at 0 or the nearest measured position; over X and Y at the
    /// lowest, the middle and the highest Z with the rotary axes as in `at`; and, if exactly two rotary axes were
    /// measured, over both with X, Y and Z at mid range. Axes over which the estimate was not measured are left out.
    ///
    /// # Errors
    /// The estimate does not state the ranges over which it was measured.
    pub fn xy_and_rotary_error_slices(&self, at: &Position) -> Result<Vec<ErrorSlice>, MethodRefusal> {
        self.check_has_measured_ranges()?;
        let ranged = |axis: &Axis| self.measured_ranges.get(axis).filter(|[least, most]| least < most);
        let middle = |[least, most]: &[f64; 2]| 0.5 * (least + most);
        let linear = self.measured_ranges.iter().filter(|(axis, _)| axis.is_linear());
        let linear: Position = linear.map(|(axis, range)| (*axis, middle(range))).collect();
        let others = at.filter_axes(|axis| !axis.is_linear()).updated_by(&linear);
        let mut slices = Vec::new();
        if let Some((x, y)) = ranged(&Axis::X).zip(ranged(&Axis::Y)) {
            let levels = match ranged(&Axis::Z) {
                Some(z) => vec![z[0], middle(z), z[1]],
                None => vec![others.get_or_zero(Axis::Z)],
            };
            let nearest_to_zero =
                |(axis, [least, most]): (&Axis, &[f64; 2])| (*axis, axis.to_mm_or_rad(0.0_f64.clamp(*least, *most)));
            let rotary = self.measured_ranges.iter().filter(|(axis, _)| !axis.is_linear());
            let at_zero: Position = rotary.map(nearest_to_zero).collect();
            slices.push(self.error_slice((Axis::X, x), (Axis::Y, y), others.updated_by(&at_zero)));
            for z in levels {
                slices.push(self.error_slice((Axis::X, x), (Axis::Y, y), others.clone().with(Axis::Z, z)));
            }
        }
        let rotary: Vec<(Axis, &[f64; 2])> =
            [Axis::A, Axis::B, Axis::C].into_iter().filter_map(|axis| Some((axis, ranged(&axis)?))).collect();
        if let [tilt, turn] = rotary[..] {
            slices.push(self.error_slice(turn, tilt, others));
        }
        Ok(slices)
    }

    fn error_slice(&self, horizontal: (Axis, &[f64; 2]), vertical: (Axis, &[f64; 2]), others: Position) -> ErrorSlice {
        let positions = |[least, most]: &[f64; 2]| -> Vec<f64> {
            let step = (most - least) / (POSITIONS_PER_AXIS - 1) as f64;
            (0..POSITIONS_PER_AXIS).map(|k| least + step * k as f64).collect()
        };
        let (columns, rows) = (positions(horizontal.1), positions(vertical.1));
        let pose = |y: f64, x: f64| {
            let at = others.clone().with(horizontal.0, horizontal.0.to_mm_or_rad(x));
            at.with(vertical.0, vertical.0.to_mm_or_rad(y))
        };
        let poses: Vec<Position> = rows.iter().flat_map(|y| columns.iter().map(|x| pose(*y, *x))).collect();
        let tips = self.tip_errors(&poses);
        let errors = self.pose_errors(&poses, &tips);
        let by_row = |value: fn(&super::PoseError) -> f64| -> Vec<Vec<f64>> {
            errors.chunks(columns.len()).map(|row| row.iter().map(value).collect()).collect()
        };
        ErrorSlice {
            error_mm: by_row(|error| error.tip_error_mm.norm()),
            u_mm: by_row(|error| error.u_tip_error_mm.norm()),
            horizontal_axis: (horizontal.0, columns),
            vertical_axis: (vertical.0, rows),
            other_positions: others.filter_axes(|axis| axis != horizontal.0 && axis != vertical.0),
        }
    }
}
