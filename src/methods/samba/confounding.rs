//! Determines which errors measurements in all directions can separate, independent of the design. The equations are
//! evaluated at poses without symmetry. Axis limits are ignored.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use estimation::independence::{find_linear_combination, independent_candidate_indices};
use machine::frame::unit_vector;
use machine::kinematics::{ErrorParameter, ErrorShape, KinematicChain};
use machine::record::artefact::Balls;
use machine::record::estimate::Unit;
use machine::{Axis, Position, frame::Point};

use crate::ball_measurement::{ball_index, tip_derivative_by_stylus};
use crate::identification::reported_unit;

/// Number of poses for the separability check. The poses have no symmetry and cover all directions.
const SEPARABILITY_POSE_COUNT: usize = 60;
/// Positions of balls for the separability check, without symmetry, table frame, mm.
const SEPARABILITY_BALL_CENTRES_MM: [[f64; 3]; 5] =
    [[-152.0, 11.0, 41.0], [149.0, -23.0, 57.0], [160.0, 161.0, 178.0], [-158.0, 137.0, 95.0], [31.0, -166.0, 76.0]];
/// The square roots of these primes give angles of the poses that repeat in no axis.
const POSE_ANGLE_PRIMES: [f64; Axis::ALL.len()] = [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0];
/// Stylus on the axis of the spindle, mm. Only there is a tilt of the spindle equivalent to an offset.
const SEPARABILITY_STYLUS_MM: Vector3<f64> = Vector3::new(0.0, 0.0, -150.0);
/// Minimum share of its length that a column keeps after the other columns are projected out. Below this share, the
/// column is a linear combination of the others.
const MIN_INDEPENDENT_SHARE: f64 = 1e-6;
/// Minimum length of the term of a named member of a linear combination, relative to the length of the column of the
/// error.
const MIN_NAMED_RELATIVE_EFFECT: f64 = 1e-2;
/// Tolerance within which the absolute value of a coefficient counts as one. Smaller deviations come from the slant
/// of a bar.
const UNIT_COEFFICIENT_TOLERANCE: f64 = 0.05;

/// Distance of two balls with a certified length from their midpoint, mm.
const SEPARABILITY_BALL_HALF_DISTANCE_MM: f64 = 150.0;
/// Weight of a certified length relative to a measured coordinate, large enough to keep the length nearly
/// fixed.
const CERTIFIED_LENGTH_WEIGHT: f64 = 30.0;
/// Minimum share of its length that the column of a gain keeps. With a smaller limit, a certified length with a slight
/// slant would count as a measurement of the gain. The share is about 0.65·cos² of the angle between length and axis,
/// so the limit corresponds to a slant of 12°.
const MIN_INDEPENDENT_GAIN_SHARE: f64 = 0.03;
/// Cosine above which the directions of two lengths are parallel.
const MIN_PARALLEL_COSINE: f64 = 0.9999;

/// Names of the coordinates of a point in the symbols of unknowns.
pub const COORDINATE_NAMES: [&str; 3] = ["x", "y", "z"];

/// Measuring conditions of a machine: its rotary axes, including S, that stay at zero; and the directions on
/// the table of the certified lengths. Without certified lengths, one along X is assumed; the rank check of the
/// measurements reports later that it is missing.
#[derive(Debug, Clone, Copy)]
pub struct MeasuringConditions<'a> {
    pub chain: &'a KinematicChain,
    /// Rotary axes, including S, that stay at zero.
    pub fixed_axes: &'a [Axis],
    /// Directions of the certified lengths, unit vectors, table frame. Empty: one along X is assumed.
    pub length_directions: &'a [Vector3<f64>],
}

/// Columns of the unknowns, one `Vec` per unknown: three stylus coordinates, three coordinates of each ball, the
/// errors of the machine. The last rows are the certified lengths, without which the scale would be undetermined.
struct UnknownColumns {
    stylus: Vec<Vec<f64>>,
    balls: Vec<Vec<f64>>,
    machine: Vec<Vec<f64>>,
}

/// The other unknowns (errors, stylus coordinates, balls) from which one error is inseparable.
#[derive(Debug, Default)]
pub struct Confounding {
    /// Names of errors, coordinates of the stylus (`tool_x`), or the balls. Empty: the error has no effect on
    /// the measurements.
    pub inseparable_names: Vec<String>,
    /// Sums that are reported in place of their first term, e.g. `tool_x is reported as tool_x + EX0S`.
    pub reported_sums: Vec<String>,
}

/// The directions of the certified lengths, from the stated positions of the balls: unit vectors, table frame. Of
/// parallel lengths only the first is returned.
pub fn length_directions(balls: &Balls) -> Vec<Vector3<f64>> {
    let position = |id| ball_index(balls, id).map(|ball| Vector3::from(balls.balls[ball].centre_mm));
    let mut all: Vec<Vector3<f64>> = Vec::new();
    for length in &balls.lengths {
        let (Some(from), Some(to)) = (position(&length.from), position(&length.to)) else { continue };
        let Some(along) = unit_vector(to - from) else { continue };
        if !all.iter().any(|known| known.dot(&along).abs() > MIN_PARALLEL_COSINE) {
            all.push(along);
        }
    }
    all
}

impl MeasuringConditions<'_> {
    /// Indices, 0 for x to 2 for z, of the stylus coordinates whose effect is not only an equal shift of all balls.
    pub fn free_stylus_coordinates(&self) -> Vec<usize> {
        let UnknownColumns { stylus, balls, .. } = self.unknown_columns(&[]);
        independent_candidate_indices(&balls, &stylus, |_| MIN_INDEPENDENT_SHARE)
    }

    /// Those `candidates`, in their order, that are not linear combinations of stylus, balls and the
    /// candidates already kept.
    pub fn separable_errors(&self, candidates: &[ErrorParameter]) -> Vec<ErrorParameter> {
        let UnknownColumns { stylus, balls, machine } = self.unknown_columns(candidates);
        let known = [stylus, balls].concat();
        let kept = independent_candidate_indices(&known, &machine, |i| min_independent_share(&candidates[i]));
        kept.into_iter().map(|i| candidates[i]).collect()
    }

    /// What `error` is inseparable from, given the errors `identified`; `None` if it is separable.
    pub fn confounding(&self, error: ErrorParameter, identified: &[ErrorParameter]) -> Option<Confounding> {
        let all = [identified, &[error]].concat();
        let UnknownColumns { stylus, balls, mut machine } = self.unknown_columns(&all);
        let column = machine.pop()?;
        let free = self.free_stylus_coordinates();
        let stylus = free.iter().map(|k| stylus[*k].clone());
        let known: Vec<Vec<f64>> = machine.into_iter().chain(stylus).chain(balls).collect();
        let shares = find_linear_combination(&known, &column, min_independent_share(&error))?;
        let is_named =
            |j: usize| column_norm(&known[j]) * shares[j].abs() > MIN_NAMED_RELATIVE_EFFECT * column_norm(&column);
        let of_errors = identified.iter().map(|known| (known.to_string(), reported_unit(known)));
        let of_stylus = free.iter().map(|k| (format!("tool_{}", COORDINATE_NAMES[*k]), Unit::Um));
        let mut confounding = Confounding::default();
        for (j, (name, unit)) in of_errors.chain(of_stylus).enumerate().filter(|(j, _)| is_named(*j)) {
            let share = shares[j];
            if unit == reported_unit(&error) && (share.abs() - 1.0).abs() < UNIT_COEFFICIENT_TOLERANCE {
                let sign = if share < 0.0 { '-' } else { '+' };
                confounding.reported_sums.push(format!("{name} is reported as {name} {sign} {error}"));
            }
            confounding.inseparable_names.push(name);
        }
        if (identified.len() + free.len()..known.len()).any(is_named) {
            confounding.inseparable_names.push("the positions of the balls".to_owned());
        }
        Some(confounding)
    }

    /// Columns of stylus, balls and `errors` for touches of all test balls at poses without symmetry.
    fn unknown_columns(&self, errors: &[ErrorParameter]) -> UnknownColumns {
        let (positions, lengths) = self.ball_positions_and_length_directions();
        let mut stylus = vec![Vec::new(); 3];
        let mut balls = vec![Vec::new(); 3 * positions.len()];
        let mut machine = vec![Vec::new(); errors.len()];
        for (pose, ball) in (0..SEPARABILITY_POSE_COUNT).flat_map(|pose| (0..positions.len()).map(move |b| (pose, b))) {
            let Some(position) = self.separability_pose(pose, positions[ball]) else { continue };
            let of_errors = self.chain.error_jacobian(&position, Point::from_vec(SEPARABILITY_STYLUS_MM), &[], errors);
            let of_stylus = tip_derivative_by_stylus(self.chain, &position, &[]);
            for axis in 0..3 {
                let own = |j| f64::from(u8::from(j == 3 * ball + axis));
                balls.iter_mut().enumerate().for_each(|(j, column)| column.push(own(j)));
                (0..3).for_each(|k| stylus[k].push(of_stylus[(axis, k)]));
                machine.iter_mut().zip(&of_errors).for_each(|(all, new)| all.push(new[axis]));
            }
        }
        for (i, along) in lengths.iter().enumerate() {
            let first = 6 * i;
            for (j, column) in balls.iter_mut().enumerate() {
                column.push(match j.checked_sub(first) {
                    Some(k @ 0..3) => -along[k] * CERTIFIED_LENGTH_WEIGHT,
                    Some(k @ 3..6) => along[k - 3] * CERTIFIED_LENGTH_WEIGHT,
                    _ => 0.0,
                });
            }
            stylus.iter_mut().chain(&mut machine).for_each(|column| column.push(0.0));
        }
        UnknownColumns { stylus, balls, machine }
    }

    /// Positions of the test balls, in pairs for the certified lengths first; and the directions (unit vectors) of the
    /// lengths.
    fn ball_positions_and_length_directions(&self) -> (Vec<Vector3<f64>>, &[Vector3<f64>]) {
        const ALONG_X: &[Vector3<f64>] = &[Vector3::new(1.0, 0.0, 0.0)];
        let lengths = if self.length_directions.is_empty() { ALONG_X } else { self.length_directions };
        let mut positions = Vec::new();
        for (along, centre) in lengths.iter().zip(SEPARABILITY_BALL_CENTRES_MM.iter().cycle()) {
            let middle = Vector3::from(*centre) * 0.3;
            positions.extend([
                middle - along * SEPARABILITY_BALL_HALF_DISTANCE_MM,
                middle + along * SEPARABILITY_BALL_HALF_DISTANCE_MM,
            ]);
        }
        positions.extend(SEPARABILITY_BALL_CENTRES_MM.map(Vector3::from));
        (positions, lengths)
    }

    /// Axis positions with the stylus tip at `ball` (table frame), for the rotary angles of the pose number `pose`.
    /// `None`: no position of the linear axes reaches the ball.
    fn separability_pose(&self, pose: usize, ball: Vector3<f64>) -> Option<Position> {
        let turning = self.chain.topology().axes().filter(|axis| !axis.is_linear());
        let angle = |axis: Axis| match self.fixed_axes.contains(&axis) {
            true => 0.0,
            false => (pose as f64 * POSE_ANGLE_PRIMES[axis as usize].sqrt()).fract() * TAU,
        };
        let others: Position = turning.map(|axis| (axis, angle(axis))).collect();
        let (target, tip) = (Point::from_vec(ball), Point::from_vec(SEPARABILITY_STYLUS_MM));
        let linear = self.chain.solve_linear_axes(target, tip, &others, &[]).ok()?;
        Some(others.updated_by(&linear))
    }
}

/// Minimum share of its length that an independent column keeps.
fn min_independent_share(error: &ErrorParameter) -> f64 {
    if error.shape() == ErrorShape::Gain { MIN_INDEPENDENT_GAIN_SHARE } else { MIN_INDEPENDENT_SHARE }
}

fn column_norm(column: &[f64]) -> f64 {
    column.iter().map(|x| x * x).sum::<f64>().sqrt()
}
