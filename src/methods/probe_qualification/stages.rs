//! Touches of each stage: first the search for the balls, then touches all around one ball, in each orientation of
//! the spindle.

use super::bench::{FIND, QualificationSetup};
use super::settings::Settings;
use crate::{Next, Refused, Source};
use machine::Position;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{REPEAT_AFTER_STOP, Stage, Step, StepKind};
use planning::{Access, Approach, BallTask, Unreachable};

/// Number of search touches per ball.
const OF_A_SEARCH: usize = 5;
/// Elevations of the circle, degrees. The lowest one at which all directions are accessible is used.
const LEVELS_DEG: [f64; 3] = [0.0, 15.0, 30.0];
/// Elevation of the second circle above the first one. Its touches check that the map decreases towards the pole.
const ABOVE_DEG: f64 = 45.0;

pub fn next(
    bench: &QualificationSetup<'_>,
    done: &[Stage],
    source: Source<'_>,
) -> Result<Next, Refused> {
    let ordinary = done.iter().filter(|stage| stage.repeat < REPEAT_AFTER_STOP).count();
    let orientations = bench.orientations_deg();
    match ordinary {
        0 => Ok(Next::new_steps(bench.plan, done, FIND, search(bench)?)),
        _ if ordinary > orientations.len() => Ok(Next::Done),
        number => {
            let index = number - 1;
            let found = bench.found(source)?;
            let steps = Orientation::new(bench, &found, index)?.all_round()?;
            let name = match orientations.len() {
                1 => "all round".to_owned(),
                _ => format!("all round, spindle at {}°", orientations[index]),
            };
            let next = Next::new_steps(bench.plan, done, name, steps);
            let Next::Stage { stage, new_steps } = next else { return Ok(next) };
            let stage = Stage { found: Some(Artefact::Balls(found)), ..stage };
            Ok(Next::Stage { stage, new_steps })
        }
    }
}

fn search(bench: &QualificationSetup<'_>) -> Result<Vec<Step>, Refused> {
    let access = Access::new(bench.plan, &bench.plan.artefact)?;
    let rotary = bench.rotary_at(0);
    let (uncertainty_mm, standoff_mm) = (bench.balls.uncertainty_mm, bench.settings.standoff_mm);
    let approach = Approach::Find { uncertainty_mm, standoff_mm };
    let mut steps = Vec::new();
    for ball in &bench.balls.balls {
        let task = BallTask { ball, rotary: &rotary, approach, touches: OF_A_SEARCH };
        let label = |touch: &str| format!("{FIND}/{}/{touch}", ball.id);
        let new = access.steps(&task, &bench.plan.probe, StepKind::Touch, (0, 0), label);
        steps.extend(new.map_err(|why| refused(ball, &why))?);
    }
    Ok(steps)
}

fn refused(ball: &Ball, why: &Unreachable) -> Refused {
    Refused::new(
        format!("ball {}: {why}", ball.id),
        "state the one ball alone in a machine file of its own, set it up where the probe reaches it all round \
         from above, or lower uncertainty_mm of [artefact]",
    )
}

/// The touches with the spindle in one orientation.
struct Orientation<'a> {
    bench: &'a QualificationSetup<'a>,
    found: &'a Balls,
    access: Access,
    rotary: Position,
    index: usize,
}

impl<'a> Orientation<'a> {
    fn new(
        bench: &'a QualificationSetup<'a>,
        found: &'a Balls,
        index: usize,
    ) -> Result<Self, Refused> {
        let access = Access::new(bench.plan, &Artefact::Balls(found.clone()))?;
        Ok(Self { bench, found, access, rotary: bench.rotary_at(index), index })
    }

    /// Rounds of slow touches. At the first orientation they alternate with rounds of fast ones.
    fn all_round(&self) -> Result<Vec<Step>, Refused> {
        let (ball, level) = self.free_ball()?;
        let mut steps = Vec::new();
        for round in 1..=self.bench.settings.repeats {
            steps.extend(self.slow(ball, level, round)?);
            if self.index == 0 {
                let label = |touch: &str| format!("fast/{}/S0/{touch}/{round}", ball.id);
                let fast = self.along(ball, &self.circle(level), label)?.into_iter();
                let feed_mm_min = self.bench.fast_mm_min();
                steps.extend(fast.map(|step| Step { feed_mm_min, ..step }));
            }
        }
        Ok(steps)
    }

    /// The ball that is accessible all around, and the elevation of its circle.
    fn free_ball(&self) -> Result<(&'a Ball, f64), Refused> {
        let wanted = &self.bench.settings.ball;
        let is_wanted = |ball: &&Ball| wanted.is_empty() || ball.id == *wanted;
        let mut why_not = None;
        for ball in self.found.balls.iter().filter(is_wanted) {
            for level in LEVELS_DEG {
                match self.slow(ball, level, 1) {
                    Ok(_) => return Ok((ball, level)),
                    Err(why) => why_not = why_not.or(Some(why)),
                }
            }
        }
        let none = || format!("[artefact] has no ball `{wanted}`");
        Err(why_not.unwrap_or_else(|| Refused::new(none(), "correct ball of the method")))
    }

    /// Azimuth and elevation of each touch of a circle, degrees.
    fn circle(&self, level: f64) -> Vec<[f64; 2]> {
        let count = self.bench.settings.azimuths;
        let pitch = 360.0 / f64::from(count);
        (0..count).map(|k| [f64::from(k) * pitch, level]).collect()
    }

    /// One round: a circle, half as many touches above it at the first orientation, and the pole.
    fn slow(&self, ball: &Ball, level: f64, round: u32) -> Result<Vec<Step>, Refused> {
        let mut directions = self.circle(level);
        let count = directions.len();
        if self.index == 0 {
            // The azimuths are between those of the lower circle.
            let half = 180.0 / count as f64;
            let every_other = directions.iter().step_by(2);
            let above = every_other.map(|[azimuth, level]| [azimuth + half, level + ABOVE_DEG]);
            directions.extend(above.collect::<Vec<_>>());
        }
        directions.push([0.0, 90.0]);
        let degrees = self.bench.orientations_deg()[self.index];
        let label = |touch: &str| format!("slow/{}/S{degrees}/{touch}/{round}", ball.id);
        let mut steps = self.along(ball, &directions, label)?;
        let last = steps.len() - 1;
        for reference in [0, count / 4, count / 2, count * 3 / 4, last] {
            steps[reference].kind = StepKind::Reference;
        }
        Ok(steps)
    }

    fn along(
        &self,
        ball: &Ball,
        directions: &[[f64; 2]],
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, Refused> {
        let Settings { standoff_mm, search_mm, .. } = *self.bench.settings;
        let approach = Approach::Slow { standoff_mm, search_mm };
        let task = BallTask { ball, rotary: &self.rotary, approach, touches: 0 };
        let probe = &self.bench.plan.probe;
        let steps = self.access.steps_along(&task, directions, probe, label);
        steps.map_err(|why| refused(ball, &why))
    }
}
