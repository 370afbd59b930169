//! Conversion of readings to observations.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::design::PlateDesign;
use super::equations::BallObservation;
use super::plate::Plate;
use super::settings::BallPlateSettings;
use super::unknowns_layout::MOTION_COMPONENTS;
use crate::ball_measurement::{BallCentre, MeasurementPurpose, ObservedBalls, observe_balls};
use crate::{IdentifyError, MethodRefusal};
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, ErrorShape, KinematicChain, KinematicsError};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Measurements of a run.
pub struct PlateMeasurements {
    /// The slow measurements only, in order of time.
    pub observed_balls: ObservedBalls,
    /// The observation of each of `observed_balls.centres`.
    pub observations: Vec<BallObservation>,
    /// Position of each ball by the nominal machine from its first measurement, table frame, mm.
    pub first_measured_centres_mm: Vec<Vector3<f64>>,
}

/// # Errors
/// The readings do not belong to the plan; a ball was never measured.
pub fn observe_run(
    plan: &Plan,
    settings: &BallPlateSettings,
    plate: &Plate<'_>,
    design: &PlateDesign,
    readings: &[Reading],
) -> Result<PlateMeasurements, IdentifyError> {
    let mut observed = observe_balls(plan, readings)?;
    let stops = design.stops.len();
    observed.centres.retain(|centre| {
        centre.label.purpose == MeasurementPurpose::Slow && (centre.label.indexation_index as usize) < stops
    });
    let chain = KinematicChain::new(&plan.machine).map_err(MethodRefusal::from)?;
    let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    let at_table = |centre: &BallCentre| chain.tip_in_table(&observed.axis_position_at_centre(centre), tip, &[]).mm;
    let first = |ball: usize| {
        let found = observed.centres.iter().find(|centre| centre.ball_index == ball).map(at_table);
        found.ok_or_else(|| unmeasured_ball_refusal(plate, ball))
    };
    let expected: Vec<Vector3<f64>> = (0..plate.balls.balls.len()).map(first).collect::<Result<_, _>>()?;
    let times = || observed.centres.iter().map(|centre| centre.mean_time_s);
    let (begin, end) = times().fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(t), b.max(t)));
    let (middle, half) = ((begin + end) / 2.0, ((end - begin) / 2.0).max(f64::MIN_POSITIVE));
    let interruptions = count_preceding_interruptions(plan, &observed.centres);
    let observation = |(i, centre): (usize, &BallCentre)| -> Result<BallObservation, KinematicsError> {
        let stop = centre.label.indexation_index as usize;
        let position = observed.axis_position_at_centre(centre);
        let axes_from_table = chain.inverse_linear_axes_jacobian(&position, &[])?;
        let errors = MOTION_COMPONENTS.map(|k| ErrorParameter::new(k, plate.rotary_axis, ErrorShape::Location));
        let errors: Vec<ErrorParameter> = errors.into_iter().flatten().collect();
        let columns = chain.error_jacobian(&position, tip, &[], &errors);
        let by = |k: usize| -axes_from_table * columns.get(k).copied().unwrap_or_default();
        let number = design.stop_angle_steps.get(stop).copied().unwrap_or(0);
        Ok(BallObservation {
            stop_index: stop,
            ball_index: centre.ball_index,
            measuring_position_index: plate.measuring_position_index(centre.ball_index, number, settings.positions),
            relative_time: (centre.mean_time_s - middle) / half,
            preceding_interruption_count: interruptions.get(i).copied().unwrap_or(0),
            axis_position_deviation_mm: axes_from_table * (at_table(centre) - expected[centre.ball_index]),
            derivatives_by_error_motion: std::array::from_fn(by),
            derivative_by_ball_position: axes_from_table,
        })
    };
    let observations = observed.centres.iter().enumerate().map(observation).collect::<Result<Vec<_>, _>>();
    let observations = observations.map_err(MethodRefusal::from)?;
    Ok(PlateMeasurements { observed_balls: observed, observations, first_measured_centres_mm: expected })
}

/// Number of interruptions before each measurement. Only interruptions with measurements before and after
/// them count, and several without a measurement between them count as one.
fn count_preceding_interruptions(plan: &Plan, centres: &[BallCentre]) -> Vec<usize> {
    let gaps = |centre: &BallCentre| plan.interruption_times_s.iter().filter(|gap| centre.mean_time_s > **gap).count();
    let counts: Vec<usize> = centres.iter().map(gaps).collect();
    let distinct: BTreeSet<usize> = counts.iter().copied().collect();
    counts.iter().map(|count| distinct.range(..count).count()).collect()
}

fn unmeasured_ball_refusal(plate: &Plate<'_>, ball: usize) -> IdentifyError {
    let id = plate.balls.balls.get(ball).map_or("", |ball| &ball.id);
    let remedy = "resume the run, or remove the ball from [artefact] and make a new plan";
    MethodRefusal::new(format!("ball {id} has no complete measurement"), remedy).into()
}
