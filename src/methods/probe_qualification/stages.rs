//! Touches of each stage: first the search for the balls, then touches all around one ball, in each orientation of
//! the spindle.

use super::settings::ProbeQualificationSettings;
use super::setup::{QualificationSetup, SEARCH_LABEL_PREFIX};
use crate::{MethodRefusal, NextStage, ObjectPositionSource};
use machine::Position;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Stage, Step, StepKind};
use planning::{BallAccessError, BallMeasurementRequest, BallTouchMode, TouchAccess};

/// Number of search touches per ball.
const SEARCH_TOUCHES_PER_BALL: usize = 5;
/// Candidate elevations of the circle, degrees. The lowest elevation at which all directions are accessible is used.
const CANDIDATE_CIRCLE_ELEVATIONS_DEG: [f64; 3] = [0.0, 15.0, 30.0];
/// Elevation of the second circle above the first one. The touches on the second circle check that the pre-travel map
/// of the probe decreases towards the pole.
const SECOND_CIRCLE_ELEVATION_OFFSET_DEG: f64 = 45.0;

/// Stage of the search for all balls, then one stage for each orientation of the spindle.
pub fn next_stage(
    setup: &QualificationSetup<'_>,
    done: &[Stage],
    source: ObjectPositionSource<'_>,
) -> Result<NextStage, MethodRefusal> {
    let ordinary = done.iter().filter(|stage| stage.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP).count();
    let orientations = setup.spindle_orientations_deg();
    match ordinary {
        0 => Ok(NextStage::from_new_steps(setup.plan, done, SEARCH_LABEL_PREFIX, search_steps(setup)?)),
        _ if ordinary > orientations.len() => Ok(NextStage::NoFurtherStage),
        number => {
            let index = number - 1;
            let found = setup.measured_balls(source)?;
            let steps = OrientationPlan::new(setup, &found, index)?.measuring_steps()?;
            let name = match orientations.len() {
                1 => "touches around the ball".to_owned(),
                _ => format!("touches around the ball, spindle at {}°", orientations[index]),
            };
            let next = NextStage::from_new_steps(setup.plan, done, name, steps);
            let NextStage::Stage { stage, new_steps } = next else { return Ok(next) };
            let stage = Stage { found: Some(Artefact::Balls(found)), ..stage };
            Ok(NextStage::Stage { stage, new_steps })
        }
    }
}

/// Search touches of all balls, with the spindle in its first orientation. Error: one of the balls is not accessible,
/// even if the setting `ball` selects another one.
fn search_steps(setup: &QualificationSetup<'_>) -> Result<Vec<Step>, MethodRefusal> {
    let access = TouchAccess::new(setup.plan, &setup.plan.artefact)?;
    let rotary = setup.rotary_positions(0);
    let (uncertainty_mm, standoff_mm) = (setup.balls.uncertainty_mm, setup.settings.standoff_mm);
    let mode = BallTouchMode::Search { uncertainty_mm, standoff_mm };
    let mut steps = Vec::new();
    for ball in &setup.balls.balls {
        let request =
            BallMeasurementRequest { ball, rotary: &rotary, touch_mode: mode, touch_count: SEARCH_TOUCHES_PER_BALL };
        let label = |touch: &str| format!("{SEARCH_LABEL_PREFIX}/{}/{touch}", ball.id);
        let new = access.touch_steps(&request, &setup.plan.probe, StepKind::Touch, label);
        steps.extend(new.map_err(|reason| unreachable_refusal(ball, &reason))?);
    }
    Ok(steps)
}

fn unreachable_refusal(ball: &Ball, reason: &BallAccessError) -> MethodRefusal {
    MethodRefusal::new(
        format!("ball {}: {reason}", ball.id),
        "describe only this ball in a separate machine file, place the ball where the probe can touch it \
        all around and from above, or lower uncertainty_mm of [artefact]",
    )
}

/// The touches with the spindle in one orientation.
struct OrientationPlan<'a> {
    setup: &'a QualificationSetup<'a>,
    /// The balls at their measured positions.
    found_balls: &'a Balls,
    access: TouchAccess,
    rotary_positions: Position,
    orientation_index: usize,
}

impl<'a> OrientationPlan<'a> {
    fn new(
        setup: &'a QualificationSetup<'a>,
        found_balls: &'a Balls,
        orientation_index: usize,
    ) -> Result<Self, MethodRefusal> {
        let access = TouchAccess::new(setup.plan, &Artefact::Balls(found_balls.clone()))?;
        Ok(Self {
            setup,
            found_balls,
            access,
            rotary_positions: setup.rotary_positions(orientation_index),
            orientation_index,
        })
    }

    /// Steps of all repeats of the slow touches. At the first orientation, repeats of slow and fast touches alternate.
    fn measuring_steps(&self) -> Result<Vec<Step>, MethodRefusal> {
        let (ball, level) = self.accessible_ball_and_elevation()?;
        let mut steps = Vec::new();
        for repeat in 1..=self.setup.settings.repeats {
            steps.extend(self.slow_repeat_steps(ball, level, repeat)?);
            if self.orientation_index == 0 {
                let label = |touch: &str| format!("fast/{}/S0/{touch}/{repeat}", ball.id);
                let fast = self
                    .touch_steps_in_directions(ball, &self.circle_azimuths_and_elevations(level), label)?
                    .into_iter();
                let feed_mm_min = self.setup.fast_feed_mm_min();
                steps.extend(fast.map(|step| Step { feed_mm_min, ..step }));
            }
        }
        Ok(steps)
    }

    /// The first selected ball whose touches in this orientation are all accessible, and the lowest candidate elevation
    /// of its circle at which they are. Error: the first reason for which a selected ball is not accessible, or no ball
    /// has the selected id.
    fn accessible_ball_and_elevation(&self) -> Result<(&'a Ball, f64), MethodRefusal> {
        let ball_id = &self.setup.settings.ball;
        let is_selected = |ball: &&Ball| ball_id.is_empty() || ball.id == *ball_id;
        let mut first_refusal = None;
        for ball in self.found_balls.balls.iter().filter(is_selected) {
            for level in CANDIDATE_CIRCLE_ELEVATIONS_DEG {
                match self.slow_repeat_steps(ball, level, 1) {
                    Ok(_) => return Ok((ball, level)),
                    Err(reason) => first_refusal = first_refusal.or(Some(reason)),
                }
            }
        }
        let none = || format!("[artefact] has no ball `{ball_id}`");
        Err(first_refusal
            .unwrap_or_else(|| MethodRefusal::new(none(), "correct `ball` in [method.probe-qualification]")))
    }

    /// Azimuth and elevation of each touch of the circle at `elevation_deg`, degrees.
    fn circle_azimuths_and_elevations(&self, elevation_deg: f64) -> Vec<[f64; 2]> {
        let count = self.setup.settings.azimuths;
        let pitch = 360.0 / f64::from(count);
        (0..count).map(|k| [f64::from(k) * pitch, elevation_deg]).collect()
    }

    /// Steps of one repeat at the measuring feed: a circle, a second circle above it with half as many touches (first
    /// orientation only), and the pole. Four touches of the circle and the pole are references.
    fn slow_repeat_steps(&self, ball: &Ball, elevation_deg: f64, repeat: u32) -> Result<Vec<Step>, MethodRefusal> {
        let mut directions = self.circle_azimuths_and_elevations(elevation_deg);
        let count = directions.len();
        if self.orientation_index == 0 {
            // The azimuths are between those of the lower circle.
            let half = 180.0 / count as f64;
            let every_other = directions.iter().step_by(2);
            let above =
                every_other.map(|[azimuth, level]| [azimuth + half, level + SECOND_CIRCLE_ELEVATION_OFFSET_DEG]);
            directions.extend(above.collect::<Vec<_>>());
        }
        directions.push([0.0, 90.0]);
        let degrees = self.setup.spindle_orientations_deg()[self.orientation_index];
        let label = |touch: &str| format!("slow/{}/S{degrees}/{touch}/{repeat}", ball.id);
        let mut steps = self.touch_steps_in_directions(ball, &directions, label)?;
        let last = steps.len() - 1;
        for reference in [0, count / 4, count / 2, count * 3 / 4, last] {
            steps[reference].kind = StepKind::Reference;
        }
        Ok(steps)
    }

    fn touch_steps_in_directions(
        &self,
        ball: &Ball,
        directions: &[[f64; 2]],
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, MethodRefusal> {
        let ProbeQualificationSettings { standoff_mm, search_mm, .. } = *self.setup.settings;
        let mode = BallTouchMode::Measure { standoff_mm, search_mm };
        let request = BallMeasurementRequest { ball, rotary: &self.rotary_positions, touch_mode: mode, touch_count: 0 };
        let probe = &self.setup.plan.probe;
        let steps = self.access.touch_steps_along(&request, directions, probe, label);
        steps.map_err(|reason| unreachable_refusal(ball, &reason))
    }
}
