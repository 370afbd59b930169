//! Conversion of readings to sightings.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::design::Design;
use super::equations::BallObservation;
use super::layout::COMPONENTS;
use super::plate::Plate;
use super::settings::Settings;
use crate::ball_measurement::{BallCentre, Observed, Pass, observe};
use crate::{IdentifyError, Refused};
use machine::frame::Point;
use machine::kinematics::{Chain, ErrorParameter, KinematicsError, Shape};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Measurements of a run.
pub struct Measured {
    /// The slow measurements only, in order of time.
    pub observed: Observed,
    /// The sighting of each of `observed.centres`.
    pub sightings: Vec<BallObservation>,
    /// Position of each ball from its first measurement with the nominal machine, table frame, mm.
    pub expected: Vec<Vector3<f64>>,
}

/// # Errors
/// The readings do not belong to the plan; a ball was never measured.
pub fn measured(
    plan: &Plan,
    settings: &Settings,
    plate: &Plate<'_>,
    design: &Design,
    readings: &[Reading],
) -> Result<Measured, IdentifyError> {
    let mut observed = observe(plan, readings)?;
    let stops = design.stops.len();
    observed.centres.retain(|centre| {
        centre.label.pass == Pass::Slow && (centre.label.indexation as usize) < stops
    });
    let chain = Chain::new(&plan.machine).map_err(Refused::from)?;
    let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    let at_table = |centre: &BallCentre| {
        let position =
            observed.places[centre.place].updated_by(&machine::Position::from_xyz(centre.xyz));
        chain.tip_in_table(&position, tip, &[]).mm
    };
    let first = |ball: usize| {
        let found = observed.centres.iter().find(|centre| centre.ball == ball).map(at_table);
        found.ok_or_else(|| never_measured(plate, ball))
    };
    let expected: Vec<Vector3<f64>> =
        (0..plate.balls.balls.len()).map(first).collect::<Result<_, _>>()?;
    let times = || observed.centres.iter().map(|centre| centre.t_s);
    let (begin, end) = times().fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(t), b.max(t)));
    let (middle, half) = ((begin + end) / 2.0, ((end - begin) / 2.0).max(f64::MIN_POSITIVE));
    let segments = segments(plan, &observed.centres);
    let sighting = |(i, centre): (usize, &BallCentre)| -> Result<BallObservation, KinematicsError> {
        let stop = centre.label.indexation as usize;
        let position =
            observed.places[centre.place].updated_by(&machine::Position::from_xyz(centre.xyz));
        let axes_from_table = chain.linear_inverse(&position, &[])?;
        let errors = COMPONENTS.map(|k| ErrorParameter::new(k, plate.axis, Shape::Location));
        let errors: Vec<ErrorParameter> = errors.into_iter().flatten().collect();
        let columns = chain.jacobian(&position, tip, &[], &errors);
        let by = |k: usize| -axes_from_table * columns.get(k).copied().unwrap_or_default();
        let number = design.numbers.get(stop).copied().unwrap_or(0);
        Ok(BallObservation {
            stop,
            ball: centre.ball,
            place: plate.place(centre.ball, number, settings.positions),
            time: (centre.t_s - middle) / half,
            segment: segments.get(i).copied().unwrap_or(0),
            deviation: axes_from_table * (at_table(centre) - expected[centre.ball]),
            by_motion: std::array::from_fn(by),
            by_ball: axes_from_table,
        })
    };
    let sightings =
        observed.centres.iter().enumerate().map(sighting).collect::<Result<Vec<_>, _>>();
    let sightings = sightings.map_err(Refused::from)?;
    Ok(Measured { observed, sightings, expected })
}

/// Number of interruptions before each measurement. Only interruptions with measurements before and after
/// them count.
fn segments(plan: &Plan, centres: &[BallCentre]) -> Vec<usize> {
    let gaps = |centre: &BallCentre| plan.gaps_s.iter().filter(|gap| centre.t_s > **gap).count();
    let counts: Vec<usize> = centres.iter().map(gaps).collect();
    let distinct: BTreeSet<usize> = counts.iter().copied().collect();
    counts.iter().map(|count| distinct.range(..count).count()).collect()
}

fn never_measured(plate: &Plate<'_>, ball: usize) -> IdentifyError {
    let id = plate.balls.balls.get(ball).map_or("", |ball| &ball.id);
    Refused {
        why: format!("ball {id} has no complete measurement"),
        instead: "resume the run, or take the ball out of [artefact] and plan anew".to_owned(),
    }
    .into()
}
