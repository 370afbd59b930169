//! Positions of the balls found so far, computed with the nominal machine.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::artefact::ball_index;
use super::setup::MeasurementSetup;
use super::touch_label::{MeasurementPurpose, TouchLabel, touch_steps_with_labels};
use machine::Position;
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Step};
use machine::record::reading::Reading;
use planning::{BallCheckError, MeasuredBall, evaluate_ball};

/// Found positions of each ball: visit and centre, table frame, mm, the newest last.
#[derive(Debug, Default)]
pub struct FoundBalls {
    centres_by_ball: Vec<Vec<(usize, Vector3<f64>)>>,
}

/// One measurement of a ball: its steps and their newest readings.
pub struct BallReadings<'a> {
    /// Label of the first of its touches.
    pub label: TouchLabel,
    /// Index of the ball.
    pub ball_index: usize,
    pub steps: Vec<&'a Step>,
    /// Fewer than `steps` if some are missing; references that are repeated after a stop are not contained.
    pub readings: Vec<&'a Reading>,
}

impl FoundBalls {
    /// Positions from search and slow measurements; references, rest checks and incomplete measurements are ignored.
    pub fn from_measurements<'t, 'r: 't>(
        setup: &MeasurementSetup<'_>,
        all: impl IntoIterator<Item = &'t BallReadings<'r>>,
    ) -> Self {
        // References and the rest check repeat a visit whose result is already stored.
        let is_new = |measurement: &&BallReadings<'_>| {
            matches!(measurement.label.purpose, MeasurementPurpose::Find | MeasurementPurpose::Slow)
        };
        let centre = |measurement: &BallReadings<'_>| {
            let measured = measurement.fit_ball(setup)?.ok()?;
            Some((measurement.ball_index, measurement.label.indexation_index, measured.centre_in_table_mm))
        };
        Self::from_centres(setup, all.into_iter().filter(is_new).filter_map(centre))
    }

    /// Positions as if every ball in the plan had been found at its stated position.
    pub fn from_stated_positions(setup: &MeasurementSetup<'_>) -> Self {
        let centre = |(_, label): (&Step, TouchLabel)| {
            let ball = ball_index(setup.balls, &label.ball)?;
            Some((ball, label.indexation_index, Vector3::from(setup.balls.balls.get(ball)?.centre_mm)))
        };
        Self::from_centres(setup, touch_steps_with_labels(setup.plan).filter_map(centre))
    }

    /// `found`: ball, visit and centre.
    fn from_centres(setup: &MeasurementSetup<'_>, found: impl Iterator<Item = (usize, u32, Vector3<f64>)>) -> Self {
        let mut centres = vec![Vec::new(); setup.balls.balls.len()];
        for (ball, visit, centre) in found {
            centres[ball].push((visit as usize, centre));
        }
        Self { centres_by_ball: centres }
    }

    /// Whether every ball was found.
    pub fn has_all_balls(&self) -> bool {
        self.centres_by_ball.iter().all(|centres| !centres.is_empty())
    }

    /// Expected position of a ball at a visit: the position found at this visit, or else the position found last. Until
    /// all balls are found, the stated position is used, because path planning and collision check use one artefact
    /// with either stated or found positions.
    pub fn expected_centre(&self, setup: &MeasurementSetup<'_>, ball: usize, visit: usize) -> Vector3<f64> {
        let found = self.centres_by_ball.get(ball).filter(|_| self.has_all_balls());
        let there = found.and_then(|all| all.iter().rev().find(|(at, _)| *at == visit));
        let last = there.or_else(|| found.and_then(|all| all.last()));
        let stated = setup.balls.balls.get(ball).map(|ball| Vector3::from(ball.centre_mm));
        last.map(|(_, centre)| *centre).or(stated).unwrap_or_default()
    }

    /// Maximum assumed distance of a ball from [`Self::expected_centre`], mm. Until all balls are found, it is the
    /// stated uncertainty. A position found at another indexation deviates by up to twice the location errors of the
    /// rotary axes, which are not yet identified: the standoff of a slow touch is allowed for them, at most the stated
    /// uncertainty.
    pub fn expected_centre_tolerance_mm(&self, setup: &MeasurementSetup<'_>) -> f64 {
        let stated = setup.balls.uncertainty_mm;
        if self.has_all_balls() { stated.min(setup.touch_settings.standoff_mm) } else { stated }
    }
}

impl BallReadings<'_> {
    /// The ball fitted with the nominal machine. `None`: touches are missing; error: the touches do not fit a ball.
    pub fn fit_ball(&self, setup: &MeasurementSetup<'_>) -> Option<Result<MeasuredBall, BallCheckError>> {
        let touches: Vec<Position> = self.readings.iter().map(|r| r.position.clone()).collect();
        let complete = self.steps.len() == touches.len();
        let (machine, probe) = (&setup.plan.machine, &setup.plan.probe);
        complete.then(|| evaluate_ball(&self.label.ball, &touches, machine, probe))
    }
}

/// Groups the plan's steps and their newest readings by measurement, in the order of the steps. Readings of
/// references repeated after a stop are left out.
pub fn group_readings_by_measurement<'a>(
    setup: &MeasurementSetup<'a>,
    readings: &'a [Reading],
) -> Vec<BallReadings<'a>> {
    let mut newest: BTreeMap<u32, &Reading> = BTreeMap::new();
    for reading in readings.iter().filter(|reading| reading.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP) {
        let of_step = newest.entry(reading.step).or_insert(reading);
        if reading.repeat >= of_step.repeat {
            *of_step = reading;
        }
    }
    let mut all: Vec<BallReadings<'_>> = Vec::new();
    for (step, label) in touch_steps_with_labels(setup.plan) {
        let Some(ball) = ball_index(setup.balls, &label.ball) else { continue };
        let same = |other: &TouchLabel| {
            (other.purpose, other.indexation_index, &other.ball) == (label.purpose, label.indexation_index, &label.ball)
        };
        if !all.last().is_some_and(|last| same(&last.label)) {
            all.push(BallReadings { label, ball_index: ball, steps: Vec::new(), readings: Vec::new() });
        }
        if let Some(last) = all.last_mut() {
            last.steps.push(step);
            last.readings.extend(newest.get(&step.id).copied());
        }
    }
    all
}
