//! Error of the tip over two axes at a time, with the others fixed: before a correction, and the uncertainty
//! that remains after it.

use super::Predictor;
use crate::Refused;
use machine::{Axis, Position};

/// Number of positions of an axis over its range.
const POSITIONS: usize = 7;

#[derive(Debug, Clone, PartialEq)]
pub struct Slice {
    /// The two axes and their positions, mm and degrees: horizontal (`across`) and vertical (`up`).
    pub across: (Axis, Vec<f64>),
    pub up: (Axis, Vec<f64>),
    /// Positions of the other axes.
    pub others: Position,
    /// Length of the error of the tip, row by row upwards, mm.
    pub error_mm: Vec<Vec<f64>>,
    /// Standard uncertainty of the tip error, √(u_x² + u_y² + u_z²), mm. It remains after a correction of all
    /// errors.
    pub u_mm: Vec<Vec<f64>>,
}

impl Predictor<'_> {
    /// Slices over X and Y at mid Z with the rotary axes at 0 or the nearest measured position; over X and Y
    /// at the lowest, the middle and the highest Z with the rotary axes as in `at`; and over two rotary axes
    /// with X, Y and Z at mid range. Axes over which the estimate was not measured are left out.
    ///
    /// # Errors
    /// The estimate does not state the ranges over which it was measured.
    pub fn slices(&self, at: &Position) -> Result<Vec<Slice>, Refused> {
        self.check_ranges()?;
        let ranged = |axis: &Axis| self.measured.get(axis).filter(|[least, most]| least < most);
        let middle = |[least, most]: &[f64; 2]| 0.5 * (least + most);
        let linear = self.measured.iter().filter(|(axis, _)| axis.is_linear());
        let linear: Position = linear.map(|(axis, range)| (*axis, middle(range))).collect();
        let others = at.only(|axis| !axis.is_linear()).updated_by(&linear);
        let mut slices = Vec::new();
        if let Some((x, y)) = ranged(&Axis::X).zip(ranged(&Axis::Y)) {
            let levels = match ranged(&Axis::Z) {
                Some(z) => vec![z[0], middle(z), z[1]],
                None => vec![others.at(Axis::Z)],
            };
            let zero = |(axis, [least, most]): (&Axis, &[f64; 2])| {
                (*axis, axis.from_edge(0.0_f64.clamp(*least, *most)))
            };
            let rotary = self.measured.iter().filter(|(axis, _)| !axis.is_linear());
            let at_zero: Position = rotary.map(zero).collect();
            slices.push(self.slice((Axis::X, x), (Axis::Y, y), others.updated_by(&at_zero)));
            for z in levels {
                slices.push(self.slice(
                    (Axis::X, x),
                    (Axis::Y, y),
                    others.clone().with(Axis::Z, z),
                ));
            }
        }
        let rotary: Vec<(Axis, &[f64; 2])> = [Axis::A, Axis::B, Axis::C]
            .into_iter()
            .filter_map(|axis| Some((axis, ranged(&axis)?)))
            .collect();
        if let [tilt, turn] = rotary[..] {
            slices.push(self.slice(turn, tilt, others));
        }
        Ok(slices)
    }

    fn slice(&self, across: (Axis, &[f64; 2]), up: (Axis, &[f64; 2]), others: Position) -> Slice {
        let positions = |[least, most]: &[f64; 2]| -> Vec<f64> {
            let step = (most - least) / (POSITIONS - 1) as f64;
            (0..POSITIONS).map(|k| least + step * k as f64).collect()
        };
        let (columns, rows) = (positions(across.1), positions(up.1));
        let pose = |y: f64, x: f64| {
            let at = others.clone().with(across.0, across.0.from_edge(x));
            at.with(up.0, up.0.from_edge(y))
        };
        let poses: Vec<Position> =
            rows.iter().flat_map(|y| columns.iter().map(|x| pose(*y, *x))).collect();
        let tips = self.tips(&poses);
        let errors = self.with_directions(&poses, &tips);
        let by_row = |of: fn(&super::PoseError) -> f64| -> Vec<Vec<f64>> {
            errors.chunks(columns.len()).map(|row| row.iter().map(of).collect()).collect()
        };
        Slice {
            error_mm: by_row(|error| error.tip_mm.norm()),
            u_mm: by_row(|error| error.u_tip_mm.norm()),
            across: (across.0, columns),
            up: (up.0, rows),
            others: others.only(|axis| axis != across.0 && axis != up.0),
        }
    }
}
