//! Detection of inconsistent data: single measurements, balls that moved between two visits, lengths. Inconsistent data
//! are reported, not removed.

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};

use super::geometry_model::length_u_mm;
use super::geometry_solution::GeometrySolution;
use crate::ball_measurement;
use crate::identification::{MeasurementToCheck, mean_coordinate_u_mm};
use estimation::coverage;
use machine::Axis;
use machine::kinematics::ErrorShape;
use machine::record::artefact::Ball;

/// Probability of a false warning of a moved ball, over all balls and all visits before which a ball may have moved.
const FALSE_ALARM_PROBABILITY: f64 = 1e-3;
/// Minimum share of χ² that the displacement of a ball must explain to be reported.
const MIN_EXPLAINED_CHI2_SHARE: f64 = 0.3;
/// Leverage above which no other row checks a row.
const MAX_CHECKED_LEVERAGE: f64 = 1.0 - 1e-4;
/// Maximum plausible disagreement between a certified length and the distance of its balls, mm/mm. The scale error of a
/// machine is smaller.
const MAX_RELATIVE_LENGTH_DISAGREEMENT: f64 = 1e-4;

impl GeometrySolution<'_> {
    fn ball_id(&self, ball: usize) -> &str {
        self.balls.balls.get(ball).map_or("", |ball| ball.id.as_str())
    }

    fn chi2(&self) -> f64 {
        self.minimum.residuals.iter().map(|r| r * r).sum()
    }

    /// Each ball at each indexation as a measurement for the outlier check.
    pub fn checked_measurements(&self) -> Vec<MeasurementToCheck> {
        let residuals = self.position_residuals();
        ball_measurement::measurements_for_outlier_check(&self.observed, |centre| {
            let u_mm = mean_coordinate_u_mm(&self.problem.whitening_matrix_from_table(centre));
            (residuals[centre], self.problem.first_row_of_measurement(centre), u_mm)
        })
    }

    /// Warning about the ball displacement between two visits that reduces χ² most. `None`: the reduction is not
    /// significant, or is at most the share `MIN_EXPLAINED_CHI2_SHARE` of χ².
    pub fn moved_ball_warning(&self) -> Option<String> {
        let candidates: Vec<(Vec<usize>, usize)> = (0..self.balls.balls.len())
            .flat_map(|ball| {
                let centres = &self.observed.centres;
                let visits: Vec<usize> = (0..centres.len()).filter(|i| centres[*i].ball_index == ball).collect();
                (1..visits.len()).map(move |split| (visits.clone(), split))
            })
            .collect();
        let moves = candidates.iter().map(|(visits, split)| self.chi2_reduction_and_ball_move(visits, *split));
        let (best, (reduction, displacement_mm)) =
            moves.enumerate().max_by(|(_, (a, _)), (_, (b, _))| a.total_cmp(b))?;
        let (visits, split) = &candidates[best];
        let variance = (self.chi2() - reduction) / self.dof().checked_sub(3)?.max(1) as f64;
        let probability = 1.0 - 2.0 * FALSE_ALARM_PROBABILITY / candidates.len() as f64;
        let (_, limit) = coverage::chi_square_bounds(3.0, probability)?;
        if reduction <= limit * variance || reduction <= MIN_EXPLAINED_CHI2_SHARE * self.chi2() {
            return None;
        }
        Some(self.describe_moved_ball(visits, *split, displacement_mm.norm() * 1e3))
    }

    /// Warning that the ball moved by `um` before its visit `first_moved`. With two or more measurements on both sides
    /// only a displacement of the ball explains the misfit. A single measurement at the end may be off because the ball
    /// moved, or because the measurement is wrong.
    fn describe_moved_ball(&self, visits: &[usize], first_moved: usize, um: f64) -> String {
        let centre = |visit: usize| &self.observed.centres[visits[visit]];
        let (ball, before) =
            (self.ball_id(centre(first_moved).ball_index), centre(first_moved - 1).label.indexation_number());
        let after = centre(first_moved).label.indexation_number();
        let alternative = match first_moved {
            1 => format!(", or its first measurement, at indexation {before}, is wrong (dirt, a loose ball)"),
            last if last + 1 == visits.len() => {
                format!(", or its last measurement, at indexation {after}, is wrong (dirt, a loose ball)")
            }
            _ => String::new(),
        };
        format!(
            "ball {ball} probably moved by {um:.1} µm between its measurements at indexations \
             {before} and {after}{alternative}: tighten the ball and measure again"
        )
    }

    /// Reduction of χ² by a displacement of the ball before its visit `first_moved`, and the displacement (table frame,
    /// mm): three more unknowns, with all others free. Both are zero if the displacement is not determined.
    fn chi2_reduction_and_ball_move(&self, visits: &[usize], first_moved: usize) -> (f64, Vector3<f64>) {
        let column = |axis: Axis| {
            let mut column = vec![0.0; self.minimum.residuals.len()];
            for centre in visits.iter().skip(first_moved) {
                let effect = -(self.problem.whitening_matrix_from_table(*centre) * axis.nominal_direction());
                column[self.problem.first_row_of_measurement(*centre)..][..3].copy_from_slice(effect.as_slice());
            }
            self.minimum.factorisation.residuals(&column)
        };
        let free = Axis::LINEAR.map(column);
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let normal = Matrix3::from(free.each_ref().map(|a| free.each_ref().map(|b| product(a, b))));
        let right = Vector3::from(free.each_ref().map(|a| product(a, &self.minimum.residuals)));
        let singular = normal.determinant().abs() < 1e-9 * normal.column(0).norm().powi(3);
        let Some(inverse) = normal.try_inverse().filter(|_| !singular) else {
            return (0.0, Vector3::zeros());
        };
        // The column is the derivative of the model by the ball: minus the weight.
        let displacement_mm = inverse * right;
        (displacement_mm.dot(&right), displacement_mm)
    }

    /// Lengths that disagree with their balls by more than 100 µm/m. The reference is the ball distance measured
    /// without this length. If only this length determines the scale, the reference is the scales of the machine.
    pub fn length_disagreement_warnings(&self) -> Vec<String> {
        let leverage = self.minimum.factorisation.leverage();
        let lines = self.balls.lengths.iter().enumerate().filter_map(|(i, length)| {
            let row = self.problem.row_of_length(i);
            let (deviation, reference) = if leverage[row] > MAX_CHECKED_LEVERAGE {
                (self.mean_linear_axis_gain(), "the scales of the machine")
            } else {
                let without_length = self.minimum.residuals[row] / (1.0 - leverage[row]);
                (without_length * length_u_mm(length) / length.mm, "the balls as measured without this length")
            };
            (deviation.abs() > MAX_RELATIVE_LENGTH_DISAGREEMENT).then(|| {
                format!(
                    "the certified length {}–{} disagrees with {reference} by {:.0} µm/m: check \
                     the certificate, its temperature and the numbers of the balls",
                    length.from,
                    length.to,
                    deviation * 1e6
                )
            })
        });
        lines.collect()
    }

    /// Mean of the identified gains of the linear axes, 0 without any. If only one length determines the scale, this
    /// gain is the disagreement between the length and the machine's scales.
    fn mean_linear_axis_gain(&self) -> f64 {
        let named = self.problem.model().parameters().iter().zip(&self.minimum.x);
        let gains: Vec<f64> = named
            .filter(|(p, _)| p.shape() == ErrorShape::Gain && p.component() == p.axis())
            .map(|(_, value)| *value)
            .collect();
        gains.iter().sum::<f64>() / gains.len().max(1) as f64
    }

    /// Balls that were measured at fewer than three indexations; their measurements determine only their own
    /// coordinates.
    pub fn describe_under_measured_balls(&self) -> Vec<String> {
        let lines = self.balls.balls.iter().enumerate().filter_map(|(ball, Ball { id, .. })| {
            let centres = self.observed.centres.iter().filter(|centre| centre.ball_index == ball);
            let positions: BTreeSet<usize> = centres.map(|centre| centre.commanded_rotary_position_index).collect();
            let count = positions.len();
            (count < 3).then(|| {
                format!(
                    "ball {id} was measured at {count} indexations: fewer than three measurements determine only \
                    its position and do not check it"
                )
            })
        });
        lines.collect()
    }
}
