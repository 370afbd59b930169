//! The stops of the table, the visits of the balls, and the harmonics that the layout does not determine.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};

use super::angle_basis::AngleBasis;
use super::equations::{BallObservation, analyse_equation_rank};
use super::plate::Plate;
use super::settings::BallPlateSettings;
use super::unknowns_layout::{MOTION_COMPONENTS, TableStop, UnknownsLayout};
use crate::MethodRefusal;
use crate::ball_measurement::BallVisit;
use crate::revolution_grid::RevolutionGrid;
use machine::record::plan::Plan;

/// Stops, visits and unknowns of a run.
pub struct PlateDesign {
    /// In measuring order: rising, then, with both directions, falling.
    pub stops: Vec<TableStop>,
    /// Position of each stop, in steps of 360°/M from zero.
    pub stop_angle_steps: Vec<i64>,
    /// One visit per stop, each with all balls.
    pub visits: Vec<BallVisit>,
    /// Without the steps at interruptions, whose number follows from the readings.
    pub layout: UnknownsLayout,
}

impl PlateDesign {
    /// # Errors
    /// The limits of the axis do not allow the revolutions.
    pub fn new(plan: &Plan, settings: &BallPlateSettings, plate: &Plate<'_>) -> Result<Self, MethodRefusal> {
        let numbers = list_stop_angle_steps(plan, settings, plate)?;
        let step = TAU / settings.positions as f64;
        let rising = settings.positions * settings.revolutions;
        let stop = |(i, number): (usize, &i64)| TableStop {
            angle: step * *number as f64,
            approach_sign: if i < rising { 1.0 } else { -1.0 },
        };
        let stops: Vec<TableStop> = numbers.iter().enumerate().map(stop).collect();
        let visit = |stop: &TableStop| {
            let at = plate.rotary_positions_at_zero.clone().with(plate.rotary_axis, stop.angle);
            BallVisit::new(at, (0..plate.balls.balls.len()).collect())
        };
        let layout = UnknownsLayout {
            angle_basis: match settings.value_per_stop {
                true => AngleBasis::ValuePerStop(stops.len()),
                false => AngleBasis::Fourier { order: settings.harmonics, sub_order: settings.sub_harmonics },
            },
            has_reversal: settings.both_directions && !settings.value_per_stop,
            // The values of a stop include the drift up to that stop.
            drift_order: if settings.value_per_stop { 0 } else { settings.drift_order },
            interruption_count: 0,
            measuring_position_count: settings.positions,
            radial_directions: plate.radial_directions.clone(),
            turn_sign: plate.turn_sign,
        };
        let visits = stops.iter().map(visit).collect();
        Ok(Self { stops, stop_angle_steps: numbers, visits, layout })
    }

    /// Checks the rank of the nominal equations before the first motion.
    ///
    /// # Errors
    /// The visits do not separate the error motions; the error proposes a better layout.
    pub fn check_rank(&self, settings: &BallPlateSettings, plate: &Plate<'_>) -> Result<(), MethodRefusal> {
        let observations = self.nominal_observations(settings, plate);
        let survey = analyse_equation_rank(&self.layout, &self.stops, &observations, true)
            .map_err(|error| MethodRefusal::new(error.to_string(), "correct [artefact] and [method.ball-plate]"))?;
        if survey.nullity == 0 {
            return Ok(());
        }
        let lost = undetermined_harmonics(&plate.ball_steps, settings.positions, settings.harmonics);
        let lost = lost.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let cause = match lost.as_str() {
            "" => String::new(),
            lost => format!(
                ": the harmonics {lost} of the error motions are not determined, because they have the same phase \
                for every ball at a measuring position"
            ),
        };
        let better = stagger_balls(plate.ball_steps.len(), settings.positions);
        let degrees = better.iter().map(|step| 360.0 / settings.positions as f64 * *step as f64);
        let degrees = degrees.map(|degrees| format!("{degrees:.1}")).collect::<Vec<_>>().join(", ");
        Err(MethodRefusal::new(
            format!("these visits do not separate {} combinations of the unknowns{cause}", survey.nullity),
            format!("place the balls at {degrees} degrees from the first ball, or lower harmonics"),
        ))
    }

    /// Observations as if every ball were at its stated position, with the machine frame parallel to the table
    /// frame.
    fn nominal_observations(&self, settings: &BallPlateSettings, plate: &Plate<'_>) -> Vec<BallObservation> {
        let count = self.stops.len().max(2) as f64;
        let mut observations = Vec::new();
        for (i, (stop, number)) in self.stops.iter().zip(&self.stop_angle_steps).enumerate() {
            let angle = plate.turn_sign * stop.angle;
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), angle).into_inner();
            for (ball, radial) in plate.radial_directions.iter().enumerate() {
                let at = turned * radial * plate.circle_radius_mm + Vector3::z() * plate.mean_ball_height_mm();
                observations.push(BallObservation {
                    stop_index: i,
                    ball_index: ball,
                    measuring_position_index: plate.measuring_position_index(ball, *number, settings.positions),
                    relative_time: 2.0 * i as f64 / (count - 1.0) - 1.0,
                    preceding_interruption_count: 0,
                    axis_position_deviation_mm: Vector3::zeros(),
                    derivatives_by_error_motion: rigid_motion_derivatives(at),
                    derivative_by_ball_position: turned,
                });
            }
        }
        observations
    }
}

/// Displacement of a point by each error motion, mm per mm or rad. `from_axis`: vector to the point from the
/// point about which the table tilts, mm.
pub fn rigid_motion_derivatives(from_axis: Vector3<f64>) -> [Vector3<f64>; 6] {
    MOTION_COMPONENTS.map(|component| match component.is_linear() {
        true => component.nominal_direction(),
        false => component.nominal_direction().cross(&from_axis),
    })
}

/// Positions of the stops in steps from zero: rising, then falling.
fn list_stop_angle_steps(
    plan: &Plan,
    settings: &BallPlateSettings,
    plate: &Plate<'_>,
) -> Result<Vec<i64>, MethodRefusal> {
    let BallPlateSettings { positions, revolutions, .. } = *settings;
    let steps = RevolutionGrid { positions_per_revolution: positions, revolutions, lead_positions_per_end: 0 }
        .position_index_range_within_limits(plan, plate.rotary_axis)?;
    let (first, last) = (*steps.start(), *steps.end());
    let rising = first..last;
    // The return begins one step beyond the last stop and ends one step after the first.
    let falling = (first + 1..=last).rev().filter(|_| settings.both_directions);
    Ok(rising.chain(falling).collect())
}

/// Harmonics up to `order` at which all balls arrive at each measuring position with the same phase.
pub fn undetermined_harmonics(steps: &[usize], position_count: usize, order: usize) -> Vec<usize> {
    let first = steps.first().copied().unwrap_or(0);
    let is_lost =
        |k: &usize| steps.iter().all(|step| (k * (step + position_count - first)).is_multiple_of(position_count));
    (1..=order).filter(is_lost).collect()
}

/// Positions of `ball_count` balls, in steps, nearly evenly spaced, that determine every harmonic well. Each candidate
/// shifts each ball further than the ball before it; the candidate with the best worst harmonic is chosen.
pub fn stagger_balls(ball_count: usize, position_count: usize) -> Vec<usize> {
    let width = (position_count / ball_count.max(1)).max(1);
    let candidate = |shift: usize| -> Vec<usize> {
        let place = |j: usize| (j * position_count / ball_count + (j * (j + 1) / 2 * shift) % width) % position_count;
        (0..ball_count).map(place).collect()
    };
    let worst = |steps: &Vec<usize>| -> f64 {
        let phase = |k: usize, step: usize| (TAU * (k * step) as f64 / position_count as f64).sin_cos();
        let coherence = |k: usize| {
            let sums = steps.iter().map(|step| phase(k, *step));
            let (sin, cos) = sums.fold((0.0, 0.0), |sum, term| (sum.0 + term.0, sum.1 + term.1));
            sin.hypot(cos) / ball_count.max(1) as f64
        };
        (1..=position_count / 2).map(coherence).fold(0.0, f64::max)
    };
    let all = (0..width).map(candidate);
    all.min_by(|a, b| worst(a).total_cmp(&worst(b))).unwrap_or_default()
}
