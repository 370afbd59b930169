//! Conversion of readings to measurements of balls: the axis positions at which the stylus ball centre
//! coincides with the ball centre.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::label::{Label, Pass};
use crate::{IdentifyError, Refused};
use estimation::sphere::{SphereError, fit_sphere};
use machine::frame::unit_vector;
use machine::record::artefact::{Artefact, Balls};
use machine::record::plan::{Plan, REPEAT_AFTER_STOP, Step};
use machine::record::reading::{Flag, Reading};
use machine::{Axis, Position};

/// Maximum spread of the readings of an axis at rest, rad (0.005°): encoder readings flicker, and a control
/// leaves a small position error.
const MAX_ROTARY_SPREAD_RAD: f64 = 8.7e-5;
/// Minimum number of touches for a centre and a radius.
const LEAST_TOUCHES: usize = 4;

/// One measurement of one ball: its touches and the sphere fitted to them.
#[derive(Debug, Clone)]
pub struct BallCentre {
    /// Label of one of the touches of the measurement.
    pub label: Label,
    /// Index of the ball in the artefact.
    pub ball: usize,
    /// Index of the rotary position in [`Observed::places`].
    pub place: usize,
    /// Index of the commanded rotary position in [`Observed::commanded`].
    pub commanded: usize,
    /// Centre, as axis positions, mm.
    pub xyz: Vector3<f64>,
    /// Sum of the radii of ball and stylus ball, minus pre-travel, mm.
    pub radius: f64,
    /// Form: largest minus smallest deviation of the touches from the fitted sphere, mm.
    pub form: f64,
    pub touches: Vec<Touch>,
    /// Mean time of the touches, s.
    pub t_s: f64,
}

/// Effect of one touch on the measured ball centre.
#[derive(Debug, Clone, Copy, Default)]
pub struct Touch {
    /// Axis positions of the touch, mm.
    pub point: Vector3<f64>,
    /// Outward normal of the ball, machine frame.
    pub normal: Vector3<f64>,
    /// Shift of the centre per unit deviation of the touch along the normal.
    pub gain: Vector3<f64>,
}

#[derive(Debug, Clone, Default)]
pub struct Observed {
    /// Measured positions of rotary axes and spindle.
    pub places: Vec<Position>,
    /// Commanded positions of rotary axes and spindle. Several `places` belong to one commanded position if
    /// the readings flicker.
    pub commanded: Vec<Position>,
    pub centres: Vec<BallCentre>,
    /// Measurements that could not be used, in words.
    pub left_out: Vec<String>,
}

/// Key of the touches that form one measurement; the order is that of the visits.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Visit {
    repeat: u32,
    indexation: u32,
    pass: Pass,
    ball: String,
}

/// Groups slow and reference touches into measurements and fits the spheres. Flagged touches are left out.
///
/// # Errors
/// The readings do not belong to the plan; the artefact has no balls; a label is invalid.
pub fn observe(plan: &Plan, readings: &[Reading]) -> Result<Observed, IdentifyError> {
    let balls = stated_balls(plan)?;
    let steps: BTreeMap<u32, &Step> = plan.steps.iter().map(|step| (step.id, step)).collect();
    let mut seen = BTreeSet::new();
    let mut visits: BTreeMap<Visit, Vec<(&Step, &Reading, Label)>> = BTreeMap::new();
    for reading in readings {
        let step =
            *steps.get(&reading.step).ok_or(IdentifyError::UnknownStep { step: reading.step })?;
        if !seen.insert((reading.step, reading.repeat)) {
            let Reading { step, repeat, .. } = *reading;
            return Err(IdentifyError::Duplicate { step, repeat });
        }
        let label: Label = step.label.parse().map_err(|why| refused(format!("{why}")))?;
        if matches!(label.pass, Pass::Find | Pass::Watch) {
            continue;
        }
        let visit = Visit {
            repeat: reading.repeat,
            indexation: label.indexation,
            pass: label.pass,
            ball: label.ball.clone(),
        };
        let touches = visits.entry(visit).or_default();
        if reading.flag == Flag::None {
            touches.push((step, reading, label));
        }
    }
    let mut observed = Observed { left_out: superseded(&mut visits), ..Observed::default() };
    for (visit, touches) in visits {
        let ball = balls.balls.iter().position(|ball| ball.id == visit.ball);
        let ball =
            ball.ok_or_else(|| refused(format!("the artefact has no ball {}", visit.ball)))?;
        match centre_of(&touches, ball, &mut observed) {
            Ok(centre) => observed.centres.push(centre),
            Err(why) => observed.left_out.push(format!(
                "ball {} at indexation {} is left out: {why}",
                visit.ball,
                visit.indexation + 1
            )),
        }
    }
    observed.centres.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    Ok(observed)
}

/// Removes measurements that were repeated because of dirt or a loose ball: the newest one counts.
/// Measurements that were repeated after a stop are a reference check and replace nothing.
fn superseded<T>(visits: &mut BTreeMap<Visit, T>) -> Vec<String> {
    let ordinary = |visit: &&Visit| visit.repeat < REPEAT_AFTER_STOP;
    let key = |visit: &Visit| (visit.pass, visit.indexation, visit.ball.clone());
    // In the order of repeats, so that the last one remains.
    let newest: BTreeMap<_, u32> =
        visits.keys().filter(ordinary).map(|visit| (key(visit), visit.repeat)).collect();
    let mut left_out = Vec::new();
    visits.retain(|visit, _| {
        let stays =
            !ordinary(&visit) || newest.get(&key(visit)).is_none_or(|last| *last == visit.repeat);
        if !stays {
            left_out.push(format!(
                "ball {} at indexation {} was measured once more: only the last measurement counts",
                visit.ball,
                visit.indexation + 1
            ));
        }
        stays
    });
    left_out
}

/// # Errors
/// The artefact has no balls.
pub fn stated_balls(plan: &Plan) -> Result<&Balls, IdentifyError> {
    match &plan.artefact {
        Artefact::Balls(balls) => Ok(balls),
        Artefact::Cylinder(_) | Artefact::DatumCylinder(_) | Artefact::None => {
            Err(refused("the artefact has no balls".into()))
        }
    }
}

fn refused(why: String) -> IdentifyError {
    let instead = "give the plan of the run that these readings come from".to_owned();
    Refused { why, instead }.into()
}

fn centre_of(
    touches: &[(&Step, &Reading, Label)],
    ball: usize,
    observed: &mut Observed,
) -> Result<BallCentre, String> {
    let [(step, _, label), ..] = touches else {
        return Err("all its touches are excluded".to_owned());
    };
    if touches.len() < LEAST_TOUCHES {
        return Err(format!("{} touches, {LEAST_TOUCHES} are needed", touches.len()));
    }
    let place =
        mean_rotary_position(touches).ok_or("its touches were not made at one rotary position")?;
    let xyz = |reading: &Reading| Axis::LINEAR.map(|axis| reading.position.get(axis));
    let points: Option<Vec<Touch>> = touches
        .iter()
        .map(|(_, reading, _)| match xyz(reading) {
            [Some(x), Some(y), Some(z)] => {
                Some(Touch { point: Vector3::new(x, y, z), ..Touch::default() })
            }
            _ => None,
        })
        .collect();
    let mut centre = BallCentre {
        label: label.clone(),
        ball,
        place: 0,
        commanded: 0,
        xyz: Vector3::zeros(),
        radius: 0.0,
        form: 0.0,
        touches: points.ok_or("a reading lacks X, Y or Z")?,
        t_s: touches.iter().map(|(_, reading, _)| reading.t_s).sum::<f64>() / touches.len() as f64,
    };
    centre.fit(Matrix3::identity()).map_err(|why| why.to_string())?;
    centre.place = index_of(place, &mut observed.places);
    let commanded = step.from.only(|axis| !axis.is_linear());
    centre.commanded = index_of(commanded, &mut observed.commanded);
    Ok(centre)
}

/// Mean position of the rotary axes. `None`: they moved between the touches.
fn mean_rotary_position(touches: &[(&Step, &Reading, Label)]) -> Option<Position> {
    let at = |(step, reading, _): &(&Step, &Reading, Label)| {
        step.from.updated_by(&reading.position).only(|axis| !axis.is_linear())
    };
    let all: Vec<Position> = touches.iter().map(at).collect();
    let first = all.first()?;
    let mut mean = first.clone();
    for (axis, value) in first.iter() {
        let mut apart = 0.0;
        for position in &all {
            let here = position.get(axis)? - value;
            apart += here;
            if here.is_nan() || here.abs() > MAX_ROTARY_SPREAD_RAD {
                return None;
            }
        }
        mean.set(axis, value + apart / all.len() as f64);
    }
    let alike = all.iter().all(|position| position.iter().count() == first.iter().count());
    alike.then_some(mean)
}

impl Observed {
    /// Fits the spheres again with known errors of the linear axes. `ways`: for each rotary position, the
    /// matrix from a motion of the axes to the motion of the stylus.
    ///
    /// # Errors
    /// The matrices do not give a sphere through the touches.
    pub fn fit_again(&mut self, ways: &[Matrix3<f64>]) -> Result<(), SphereError> {
        self.centres.iter_mut().try_for_each(|centre| centre.fit(ways[centre.place]))
    }
}

impl BallCentre {
    /// Gains and squareness distort the sphere to an ellipsoid in axis positions, and no touch opposite to
    /// the pole compensates for it. The sphere is therefore fitted in undistorted coordinates.
    fn fit(&mut self, way: Matrix3<f64>) -> Result<(), SphereError> {
        let points: Vec<[f64; 3]> =
            self.touches.iter().map(|touch| (way * touch.point).into()).collect();
        let sphere = fit_sphere(&points)?;
        let centre = Vector3::from(sphere.centre);
        let back = way.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN));
        for (touch, point) in self.touches.iter_mut().zip(points) {
            touch.normal = unit_vector(Vector3::from(point) - centre).unwrap_or_default();
            let row = [touch.normal.x, touch.normal.y, touch.normal.z, 1.0];
            let gain = |k: usize| (0..4).map(|j| sphere.covariance[k][j] * row[j]).sum();
            touch.gain = back * Vector3::new(gain(0), gain(1), gain(2));
        }
        self.xyz = back * centre;
        self.radius = sphere.radius;
        self.form = sphere.form();
        Ok(())
    }
}

fn index_of(place: Position, places: &mut Vec<Position>) -> usize {
    places.iter().position(|known| *known == place).unwrap_or_else(|| {
        places.push(place);
        places.len() - 1
    })
}
