//! Errors that measurements in all directions can separate, independent of the design: columns of the
//! equations on poses without symmetry and without limits.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use estimation::independence::{combination_of, independent_columns};
use machine::frame::unit_vector;
use machine::kinematics::{Chain, ErrorParameter, Shape};
use machine::record::artefact::Balls;
use machine::{Axis, Position, frame::Point};

/// Number of poses, and positions of balls, mm, for the separability check. They have no symmetry and cover
/// all directions.
const POSES: usize = 60;
const BALLS: [[f64; 3]; 5] = [
    [-152.0, 11.0, 41.0],
    [149.0, -23.0, 57.0],
    [160.0, 161.0, 178.0],
    [-158.0, 137.0, 95.0],
    [31.0, -166.0, 76.0],
];
/// Their square roots give angles that repeat in no axis.
const PRIMES: [f64; Axis::ALL.len()] = [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0];
/// Stylus on the axis of the spindle, mm. Only there is a tilt of the spindle equivalent to an offset.
const TOOL: Vector3<f64> = Vector3::new(0.0, 0.0, -150.0);
/// Minimum share of its length that an independent column keeps after projection out of the others; below it
/// the column is a linear combination of them.
const MIN_INDEPENDENT_SHARE: f64 = 1e-6;
/// Minimum coefficient of a named member of a linear combination, mm/mm.
const MIN_NAMED_COEFFICIENT: f64 = 1e-2;
/// Tolerance within which a coefficient counts as one. A deviation within it comes from the slant of a bar.
const UNIT_COEFFICIENT_TOLERANCE: f64 = 0.05;

/// Distance of two balls with a certified length from their midpoint, mm.
const HALF_LENGTH: f64 = 150.0;
/// Weight of a certified length relative to a measured coordinate, large enough to keep the length nearly
/// fixed.
const LENGTH_WEIGHT: f64 = 30.0;
/// Minimum share of its length that the column of a gain keeps; otherwise even a slight slant of a length
/// would show a gain, without use. About 0.65·cos² of the angle between length and axis; 12° of slant.
const GAIN_SHOWS: f64 = 0.03;
/// Cosine above which the directions of two lengths are parallel.
const PARALLEL: f64 = 0.9999;

/// Measuring conditions of a machine: its rotary axes, including S, that stay at zero; and the directions on
/// the table of the certified lengths. Without lengths one along X is assumed; the measurements will show
/// that it is missing.
#[derive(Debug, Clone, Copy)]
pub struct Way<'a> {
    pub chain: &'a Chain,
    pub stands: &'a [Axis],
    pub lengths: &'a [Vector3<f64>],
}

/// Columns of the unknowns. The last rows are the certified lengths, without which the scale would be
/// undetermined.
struct Columns {
    stylus: Vec<Vec<f64>>,
    balls: Vec<Vec<f64>>,
    machine: Vec<Vec<f64>>,
}

/// What an error is inseparable from.
#[derive(Debug, Default)]
pub struct Confounding {
    /// Names of errors, coordinates of the stylus (`tool_x`), or the balls. Empty: the error has no effect on
    /// the measurements.
    pub names: Vec<String>,
    /// Sums that are reported, e.g. `tool_x is given as tool_x + EX0S`.
    pub sums: Vec<String>,
}

/// The directions of the certified lengths, from the stated positions of the balls.
pub fn directions(balls: &Balls) -> Vec<Vector3<f64>> {
    let at = |id: &str| {
        let ball = balls.balls.iter().find(|ball| ball.id == id);
        ball.map(|ball| Vector3::from(ball.centre_mm))
    };
    let mut all: Vec<Vector3<f64>> = Vec::new();
    for length in &balls.lengths {
        let (Some(from), Some(to)) = (at(&length.from), at(&length.to)) else { continue };
        let Some(along) = unit_vector(to - from) else { continue };
        if !all.iter().any(|known| known.dot(&along).abs() > PARALLEL) {
            all.push(along);
        }
    }
    all
}

#[derive(PartialEq, Eq)]
enum Kind {
    Offset,
    Angle,
    Gain,
}

impl Way<'_> {
    /// The coordinates of the stylus that do more than shift all balls alike.
    pub fn free_stylus(&self) -> Vec<usize> {
        let Columns { stylus, balls, .. } = self.columns(&[]);
        independent_columns(&balls, &stylus, |_| MIN_INDEPENDENT_SHARE)
    }

    /// Those `candidates`, in their order, that are not linear combinations of stylus, balls and the
    /// candidates already kept.
    pub fn kept(&self, candidates: &[ErrorParameter]) -> Vec<ErrorParameter> {
        let Columns { stylus, balls, machine } = self.columns(candidates);
        let known = [stylus, balls].concat();
        let kept = independent_columns(&known, &machine, |i| least(&candidates[i]));
        kept.into_iter().map(|i| candidates[i]).collect()
    }

    /// What `error` is inseparable from, given the errors `taken`; `None` if it is separable.
    pub fn inseparable(
        &self,
        error: ErrorParameter,
        taken: &[ErrorParameter],
    ) -> Option<Confounding> {
        let all = [taken, &[error]].concat();
        let Columns { stylus, balls, mut machine } = self.columns(&all);
        let column = machine.pop()?;
        let free = self.free_stylus();
        let stylus = free.iter().map(|k| stylus[*k].clone());
        let known: Vec<Vec<f64>> = machine.into_iter().chain(stylus).chain(balls).collect();
        let shares = combination_of(&known, &column, least(&error))?;
        let counts = |j: usize| {
            length(&known[j]) * shares[j].abs() > MIN_NAMED_COEFFICIENT * length(&column)
        };
        let of_errors = taken.iter().map(|other| (other.to_string(), kind(*other)));
        let of_stylus =
            free.iter().map(|k| (format!("tool_{}", ["x", "y", "z"][*k]), Kind::Offset));
        let mut beside = Confounding::default();
        for (j, (name, of)) in of_errors.chain(of_stylus).enumerate().filter(|(j, _)| counts(*j)) {
            let share = shares[j];
            if of == kind(error) && (share.abs() - 1.0).abs() < UNIT_COEFFICIENT_TOLERANCE {
                let sign = if share < 0.0 { '-' } else { '+' };
                beside.sums.push(format!("{name} is given as {name} {sign} {error}"));
            }
            beside.names.push(name);
        }
        if (taken.len() + free.len()..known.len()).any(counts) {
            beside.names.push("the places of the balls".to_owned());
        }
        Some(beside)
    }

    fn columns(&self, errors: &[ErrorParameter]) -> Columns {
        let (places, lengths) = self.places();
        let mut stylus = vec![Vec::new(); 3];
        let mut balls = vec![Vec::new(); 3 * places.len()];
        let mut machine = vec![Vec::new(); errors.len()];
        for (pose, ball) in (0..POSES).flat_map(|pose| (0..places.len()).map(move |b| (pose, b))) {
            let Some(position) = self.pose_at(pose, places[ball]) else { continue };
            let of_errors = self.chain.jacobian(&position, Point::from_vec(TOOL), &[], errors);
            let table = self.chain.machine_from_table(&position, &[]).rotation;
            let of_stylus =
                table.inverse() * self.chain.machine_from_spindle(&position, &[]).rotation;
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
                    Some(k @ 0..3) => -along[k] * LENGTH_WEIGHT,
                    Some(k @ 3..6) => along[k - 3] * LENGTH_WEIGHT,
                    _ => 0.0,
                });
            }
            stylus.iter_mut().chain(&mut machine).for_each(|column| column.push(0.0));
        }
        Columns { stylus, balls, machine }
    }

    /// Positions of the balls, in pairs for the certified lengths first; and the directions of the lengths.
    fn places(&self) -> (Vec<Vector3<f64>>, &[Vector3<f64>]) {
        const ALONG_X: &[Vector3<f64>] = &[Vector3::new(1.0, 0.0, 0.0)];
        let lengths = if self.lengths.is_empty() { ALONG_X } else { self.lengths };
        let mut places = Vec::new();
        for (along, beside) in lengths.iter().zip(BALLS.iter().cycle()) {
            let middle = Vector3::from(*beside) * 0.3;
            places.extend([middle - along * HALF_LENGTH, middle + along * HALF_LENGTH]);
        }
        places.extend(BALLS.map(Vector3::from));
        (places, lengths)
    }

    fn pose_at(&self, pose: usize, ball: Vector3<f64>) -> Option<Position> {
        let turning = self.chain.topology().axes().filter(|axis| !axis.is_linear());
        let angle = |axis: Axis| match self.stands.contains(&axis) {
            true => 0.0,
            false => (pose as f64 * PRIMES[axis as usize].sqrt()).fract() * TAU,
        };
        let others: Position = turning.map(|axis| (axis, angle(axis))).collect();
        let (target, tip) = (Point::from_vec(ball), Point::from_vec(TOOL));
        let linear = self.chain.linear_axes_for(target, tip, &others, &[]).ok()?;
        Some(others.updated_by(&linear))
    }
}

fn kind(error: ErrorParameter) -> Kind {
    match (error.shape(), error.component().is_linear()) {
        (Shape::Gain, _) => Kind::Gain,
        (_, true) => Kind::Offset,
        (_, false) => Kind::Angle,
    }
}

/// Minimum share of its length that an independent column keeps.
fn least(error: &ErrorParameter) -> f64 {
    if error.shape() == Shape::Gain { GAIN_SHOWS } else { MIN_INDEPENDENT_SHARE }
}

fn length(column: &[f64]) -> f64 {
    column.iter().map(|x| x * x).sum::<f64>().sqrt()
}
