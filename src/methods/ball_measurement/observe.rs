//! Conversion of readings to measurements of balls: the axis positions at which the stylus ball centre
//! coincides with the ball centre.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::artefact::ball_index;
use super::touch_label::{MeasurementPurpose, TouchLabel};
use crate::{IdentifyError, MethodRefusal};
use estimation::sphere::{SphereError, fit_sphere};
use machine::frame::unit_vector;
use machine::record::artefact::{Artefact, Balls};
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};

/// Maximum difference between the readings of an axis at rest and that of the first touch, rad (0.005°): encoder
/// readings flicker, and a control leaves a small position error.
const MAX_DIFFERENCE_FROM_FIRST_TOUCH_RAD: f64 = 8.7e-5;
/// Minimum number of touches for a centre and a radius.
const MIN_TOUCH_COUNT: usize = 4;

/// One measurement of one ball: its touches and the sphere fitted to them.
#[derive(Debug, Clone)]
pub struct BallCentre {
    /// Label of one of the touches of the measurement.
    pub label: TouchLabel,
    /// Index of the ball in the artefact.
    pub ball_index: usize,
    /// Index of the rotary position in [`ObservedBalls::measured_rotary_positions`].
    pub measured_rotary_position_index: usize,
    /// Index of the commanded rotary position in [`ObservedBalls::commanded_rotary_positions`].
    pub commanded_rotary_position_index: usize,
    /// Centre, as axis positions, mm.
    pub centre_axis_positions_mm: Vector3<f64>,
    /// Sum of the radii of ball and stylus ball, minus pre-travel, mm.
    pub contact_radius_mm: f64,
    /// Form: largest minus smallest deviation of the touches from the fitted sphere, mm.
    pub form_mm: f64,
    /// The touches that were fitted; flagged ones are not contained.
    pub touches: Vec<FittedTouch>,
    /// Mean time of the touches, s.
    pub mean_time_s: f64,
}

/// One touch of a fitted sphere: its position, and how it shifts the measured ball centre.
#[derive(Debug, Clone, Copy, Default)]
pub struct FittedTouch {
    /// Axis positions of the touch, mm.
    pub axis_positions_mm: Vector3<f64>,
    /// Outward normal of the ball, machine frame.
    pub normal: Vector3<f64>,
    /// Shift of the centre per unit deviation of the touch along the normal.
    pub centre_gain: Vector3<f64>,
}

#[derive(Debug, Clone, Default)]
pub struct ObservedBalls {
    /// Measured positions of rotary axes and spindle.
    pub measured_rotary_positions: Vec<Position>,
    /// Commanded positions of rotary axes and spindle. Several `measured_rotary_positions` belong to one commanded
    /// position if the readings flicker.
    pub commanded_rotary_positions: Vec<Position>,
    /// Measurements that were fitted, in the order of their mean times.
    pub centres: Vec<BallCentre>,
    /// Measurements that were not used, each as a text with the reason.
    pub skipped_measurements: Vec<String>,
}

/// Key of the touches that form one measurement; ordered by repeat, then indexation, purpose and ball.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct MeasurementKey {
    repeat: u32,
    indexation_index: u32,
    purpose: MeasurementPurpose,
    ball: String,
}

/// Groups slow and reference touches into measurements and fits the spheres. Flagged touches are left out.
///
/// # Errors
/// The readings do not belong to the plan; a step has two readings of one pass; the artefact has no balls; a label is
/// invalid.
pub fn observe_balls(plan: &Plan, readings: &[Reading]) -> Result<ObservedBalls, IdentifyError> {
    let balls = artefact_balls(plan)?;
    let steps: BTreeMap<u32, &Step> = plan.steps.iter().map(|step| (step.id, step)).collect();
    let mut seen = BTreeSet::new();
    let mut visits: BTreeMap<MeasurementKey, Vec<(&Step, &Reading, TouchLabel)>> = BTreeMap::new();
    for reading in readings {
        let step = *steps.get(&reading.step).ok_or(IdentifyError::UnknownStep { step: reading.step })?;
        if !seen.insert((reading.step, reading.repeat)) {
            let Reading { step, repeat, .. } = *reading;
            return Err(IdentifyError::DuplicateReading { step, repeat });
        }
        let label: TouchLabel = step.label.parse().map_err(|reason| wrong_plan_refusal(format!("{reason}")))?;
        if matches!(label.purpose, MeasurementPurpose::Find | MeasurementPurpose::RestCheck) {
            continue;
        }
        let visit = MeasurementKey {
            repeat: reading.repeat,
            indexation_index: label.indexation_index,
            purpose: label.purpose,
            ball: label.ball.clone(),
        };
        let touches = visits.entry(visit).or_default();
        if reading.flag == ReadingFlag::None {
            touches.push((step, reading, label));
        }
    }
    let mut observed =
        ObservedBalls { skipped_measurements: remove_superseded_measurements(&mut visits), ..ObservedBalls::default() };
    for (visit, touches) in visits {
        let ball = ball_index(balls, &visit.ball)
            .ok_or_else(|| wrong_plan_refusal(format!("the artefact has no ball {}", visit.ball)))?;
        match fit_ball_centre(&touches, ball, &mut observed) {
            Ok(centre) => observed.centres.push(centre),
            Err(reason) => observed.skipped_measurements.push(format!(
                "ball {} at indexation {} was not used: {reason}",
                visit.ball,
                visit.indexation_index + 1
            )),
        }
    }
    observed.centres.sort_by(|a, b| a.mean_time_s.total_cmp(&b.mean_time_s));
    Ok(observed)
}

/// Removes measurements that were repeated because of dirt or a loose ball: only the newest is used. Returns a text
/// for each removed one. A measurement repeated after a stop is a reference check and replaces no other measurement.
fn remove_superseded_measurements<T>(visits: &mut BTreeMap<MeasurementKey, T>) -> Vec<String> {
    let ordinary = |visit: &&MeasurementKey| visit.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP;
    let key = |visit: &MeasurementKey| (visit.purpose, visit.indexation_index, visit.ball.clone());
    // The keys come in the order of repeats: of equal keys, the last repeat remains.
    let newest: BTreeMap<_, u32> = visits.keys().filter(ordinary).map(|visit| (key(visit), visit.repeat)).collect();
    let mut left_out = Vec::new();
    visits.retain(|visit, _| {
        let is_kept = !ordinary(&visit) || newest.get(&key(visit)).is_none_or(|last| *last == visit.repeat);
        if !is_kept {
            left_out.push(format!(
                "ball {} at indexation {} was measured again: only the last measurement is used",
                visit.ball,
                visit.indexation_index + 1
            ));
        }
        is_kept
    });
    left_out
}

/// # Errors
/// The artefact has no balls.
pub fn artefact_balls(plan: &Plan) -> Result<&Balls, IdentifyError> {
    match &plan.artefact {
        Artefact::Balls(balls) => Ok(balls),
        _ => Err(wrong_plan_refusal("the artefact has no balls".into())),
    }
}

fn wrong_plan_refusal(reason: String) -> IdentifyError {
    MethodRefusal::new(reason, "give the plan of the run of these readings").into()
}

/// Fits one measurement, and adds its rotary positions to `observed`. The error is the reason why it cannot be used.
fn fit_ball_centre(
    touches: &[(&Step, &Reading, TouchLabel)],
    ball: usize,
    observed: &mut ObservedBalls,
) -> Result<BallCentre, String> {
    let [(step, _, label), ..] = touches else {
        return Err("all touches of the ball are excluded".to_owned());
    };
    if touches.len() < MIN_TOUCH_COUNT {
        return Err(format!("{} touches, at least {MIN_TOUCH_COUNT} are required", touches.len()));
    }
    let place = mean_rotary_position(touches).ok_or("the rotary axes moved between the touches of the ball")?;
    let touch = |(_, reading, _): &(&Step, &Reading, TouchLabel)| {
        let [x, y, z] = Axis::LINEAR.map(|axis| reading.position.get(axis));
        Some(FittedTouch { axis_positions_mm: Vector3::new(x?, y?, z?), ..FittedTouch::default() })
    };
    let points: Option<Vec<FittedTouch>> = touches.iter().map(touch).collect();
    let mut centre = BallCentre {
        label: label.clone(),
        ball_index: ball,
        measured_rotary_position_index: 0,
        commanded_rotary_position_index: 0,
        centre_axis_positions_mm: Vector3::zeros(),
        contact_radius_mm: 0.0,
        form_mm: 0.0,
        touches: points.ok_or("X, Y or Z of a reading is missing")?,
        mean_time_s: touches.iter().map(|(_, reading, _)| reading.t_s).sum::<f64>() / touches.len() as f64,
    };
    centre.fit_sphere_to_touches(Matrix3::identity()).map_err(|reason| reason.to_string())?;
    centre.measured_rotary_position_index =
        rotary_position_index_or_insert(place, &mut observed.measured_rotary_positions);
    let commanded = step.from.filter_axes(|axis| !axis.is_linear());
    centre.commanded_rotary_position_index =
        rotary_position_index_or_insert(commanded, &mut observed.commanded_rotary_positions);
    Ok(centre)
}

/// Mean position of the rotary axes. `None`: they moved between the touches.
fn mean_rotary_position(touches: &[(&Step, &Reading, TouchLabel)]) -> Option<Position> {
    let at = |(step, reading, _): &(&Step, &Reading, TouchLabel)| {
        step.from.updated_by(&reading.position).filter_axes(|axis| !axis.is_linear())
    };
    let all: Vec<Position> = touches.iter().map(at).collect();
    let first = all.first()?;
    let mut mean = first.clone();
    for (axis, value) in first.iter() {
        let mut apart = 0.0;
        for position in &all {
            let here = position.get(axis)? - value;
            apart += here;
            if here.is_nan() || here.abs() > MAX_DIFFERENCE_FROM_FIRST_TOUCH_RAD {
                return None;
            }
        }
        mean.set(axis, value + apart / all.len() as f64);
    }
    let alike = all.iter().all(|position| position.iter().count() == first.iter().count());
    alike.then_some(mean)
}

impl ObservedBalls {
    /// Positions of all axes at the measured centre.
    pub fn axis_position_at_centre(&self, centre: &BallCentre) -> Position {
        self.measured_rotary_positions[centre.measured_rotary_position_index]
            .updated_by(&Position::from_xyz(centre.centre_axis_positions_mm))
    }

    /// Fits the spheres again with known errors of the linear axes. `motion_matrices`: for each rotary position, the
    /// matrix from a motion of the axes to the motion of the stylus.
    ///
    /// # Errors
    /// The matrices do not give a sphere through the touches.
    pub fn refit_spheres(&mut self, motion_matrices: &[Matrix3<f64>]) -> Result<(), SphereError> {
        self.centres
            .iter_mut()
            .try_for_each(|centre| centre.fit_sphere_to_touches(motion_matrices[centre.measured_rotary_position_index]))
    }
}

impl BallCentre {
    /// Gains and squareness distort the sphere to an ellipsoid in axis positions, and no touch opposite to
    /// the pole compensates for it. The sphere is therefore fitted in undistorted coordinates.
    fn fit_sphere_to_touches(&mut self, motion_matrix: Matrix3<f64>) -> Result<(), SphereError> {
        let points: Vec<[f64; 3]> =
            self.touches.iter().map(|touch| (motion_matrix * touch.axis_positions_mm).into()).collect();
        let sphere = fit_sphere(&points)?;
        let centre = Vector3::from(sphere.centre);
        let back = motion_matrix.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN));
        for (touch, point) in self.touches.iter_mut().zip(points) {
            touch.normal = unit_vector(Vector3::from(point) - centre).unwrap_or_default();
            let row = [touch.normal.x, touch.normal.y, touch.normal.z, 1.0];
            let gain = |k: usize| (0..4).map(|j| sphere.unit_variance_covariance[k][j] * row[j]).sum();
            touch.centre_gain = back * Vector3::new(gain(0), gain(1), gain(2));
        }
        self.centre_axis_positions_mm = back * centre;
        self.contact_radius_mm = sphere.radius;
        self.form_mm = sphere.form_deviation();
        Ok(())
    }
}

fn rotary_position_index_or_insert(place: Position, places: &mut Vec<Position>) -> usize {
    places.iter().position(|known| *known == place).unwrap_or_else(|| {
        places.push(place);
        places.len() - 1
    })
}
