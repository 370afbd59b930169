//! Where the balls were found so far, by the nominal machine.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::label::{Label, Pass};
use super::setup::MeasurementSetup;
use machine::Position;
use machine::record::plan::{REPEAT_AFTER_STOP, Step};
use machine::record::reading::Reading;
use planning::{BallDoubt, MeasuredBall, measured_ball};

/// What was found of each ball: the visit and the centre, table frame, the newest last.
#[derive(Debug, Default)]
pub struct Known {
    found: Vec<Vec<(usize, Vector3<f64>)>>,
}

/// One measurement of a ball: its steps and the newest readings of them.
pub struct Taken<'a> {
    pub label: Label,
    /// Index of the ball.
    pub ball: usize,
    pub steps: Vec<&'a Step>,
    pub readings: Vec<&'a Reading>,
}

impl Known {
    /// Of the plan's steps and their readings; incomplete measurements do not count.
    pub fn of(setup: &MeasurementSetup<'_>, readings: &[Reading]) -> Self {
        Self::of_taken(setup, &taken(setup, readings))
    }

    pub fn of_taken<'t, 'r: 't>(
        setup: &MeasurementSetup<'_>,
        all: impl IntoIterator<Item = &'t Taken<'r>>,
    ) -> Self {
        let mut found = vec![Vec::new(); setup.balls.balls.len()];
        for taken in all {
            // These repeat a visit; what was found at it stands already.
            if matches!(taken.label.pass, Pass::Reference | Pass::Watch) {
                continue;
            }
            if let (Some(centres), Some(Ok(measured))) =
                (found.get_mut(taken.ball), taken.measured(setup))
            {
                centres.push((taken.label.indexation as usize, measured.centre_mm));
            }
        }
        Self { found }
    }

    /// As if everything in the plan had been found where it is stated.
    pub fn nominal(setup: &MeasurementSetup<'_>) -> Self {
        let mut found = vec![Vec::new(); setup.balls.balls.len()];
        for label in setup.plan.steps.iter().filter_map(|step| step.label.parse::<Label>().ok()) {
            let ball = setup.balls.balls.iter().position(|ball| ball.id == label.ball);
            let Some(ball) = ball else { continue };
            if let (Some(centres), Some(of)) = (found.get_mut(ball), setup.balls.balls.get(ball)) {
                centres.push((label.indexation as usize, Vector3::from(of.centre_mm)));
            }
        }
        Self { found }
    }

    /// Whether every ball was found.
    pub fn all(&self) -> bool {
        self.found.iter().all(|centres| !centres.is_empty())
    }

    /// Where a ball is expected at a visit: as found there, as last found elsewhere. Until all are found,
    /// as stated: ways and proof can look at one artefact only, and that is the stated one then.
    pub fn centre(&self, setup: &MeasurementSetup<'_>, ball: usize, visit: usize) -> Vector3<f64> {
        let found = self.found.get(ball).filter(|_| self.all());
        let there = found.and_then(|all| all.iter().rev().find(|(at, _)| *at == visit));
        let last = there.or_else(|| found.and_then(|all| all.last()));
        let stated = setup.balls.balls.get(ball).map(|ball| Vector3::from(ball.centre_mm));
        last.map(|(_, centre)| *centre).or(stated).unwrap_or_default()
    }

    /// How far from there a ball may be when it is searched for, mm: as far as is stated until all
    /// are found. What was found elsewhere strays by what the nominal machine does not know: twice
    /// the offsets of the rotary axes, and nobody knows these before they are identified. As much
    /// is granted as a slow touch sets out away from the ball, and never more than what is stated.
    pub fn uncertainty_mm(&self, setup: &MeasurementSetup<'_>) -> f64 {
        let stated = setup.balls.uncertainty_mm;
        if self.all() { stated.min(setup.touch.standoff_mm) } else { stated }
    }
}

impl Taken<'_> {
    /// By the nominal machine. `None`: touches are missing.
    pub fn measured(
        &self,
        setup: &MeasurementSetup<'_>,
    ) -> Option<Result<MeasuredBall, BallDoubt>> {
        let touches: Vec<Position> = self.readings.iter().map(|r| r.position.clone()).collect();
        let complete = self.steps.len() == touches.len();
        let (machine, probe) = (&setup.plan.machine, &setup.plan.probe);
        complete.then(|| measured_ball(&self.label.ball, &touches, machine, probe))
    }
}

/// All measurements that the plan's steps name, in their order.
pub fn taken<'a>(setup: &MeasurementSetup<'a>, readings: &'a [Reading]) -> Vec<Taken<'a>> {
    let mut newest: BTreeMap<u32, &Reading> = BTreeMap::new();
    for reading in readings.iter().filter(|reading| reading.repeat < REPEAT_AFTER_STOP) {
        let of_step = newest.entry(reading.step).or_insert(reading);
        if reading.repeat >= of_step.repeat {
            *of_step = reading;
        }
    }
    let mut all: Vec<Taken<'_>> = Vec::new();
    for step in &setup.plan.steps {
        let Ok(label) = step.label.parse::<Label>() else { continue };
        let Some(ball) = setup.balls.balls.iter().position(|ball| ball.id == label.ball) else {
            continue;
        };
        let same = |other: &Label| {
            (other.pass, other.indexation, &other.ball)
                == (label.pass, label.indexation, &label.ball)
        };
        if !all.last().is_some_and(|last| same(&last.label)) {
            all.push(Taken { label, ball, steps: Vec::new(), readings: Vec::new() });
        }
        if let Some(last) = all.last_mut() {
            last.steps.push(step);
            last.readings.extend(newest.get(&step.id).copied());
        }
    }
    all
}
