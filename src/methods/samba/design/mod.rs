//! The measuring design: the balls at each indexation, their order, and the check that they suffice.

mod bench;
mod choose;
mod information;
mod paper;
mod survey;

#[cfg(test)]
mod refusal_tests;
#[cfg(test)]
pub mod tests;

use std::collections::BTreeMap;

pub use self::bench::DesignSetup;
use self::choose::{Budget, LEAST_VISITS, choose};
use self::information::CandidateMeasurement;
use super::settings::Design as Kind;
use crate::Refused;
use crate::ball_measurement::{Visit, balls_in_order, describe_position, in_order, indexations};
use machine::record::artefact::Ball;
use machine::{Axis, Position};
use planning::Access;

/// Maximum distance of a stylus from the spindle axis at which it counts as on the axis in the access checks,
/// mm.
const CENTRAL_MM: f64 = 0.1;

/// All measurements that are possible: rotary positions, and the balls accessible at each.
pub struct Candidates {
    pub at: Vec<Position>,
    pub sights: Vec<CandidateMeasurement>,
}

/// The visits in measuring order, with rank and condition checked. `time_s` gives the machine time of visits,
/// s.
///
/// # Errors
/// The errors of [`Candidates::new`]; the budget does not suffice; the machine or artefact does not allow the
/// paper's design; the design does not separate the errors of the machine. The text states the reason.
pub fn design(
    bench: &DesignSetup<'_>,
    time_s: impl Fn(&[Visit]) -> Result<f64, Refused>,
) -> Result<Vec<Visit>, Refused> {
    let access = bench.measurement().access(&bench.plan.artefact)?;
    let candidates = Candidates::new(bench, &access)?;
    let visits = match bench.settings.design {
        // In the order that the definition of the paper's design gives.
        Kind::Paper => {
            balls_in_order(&bench.measurement(), &access, paper::visits(bench, &candidates)?)?
        }
        Kind::Optimal => optimal(bench, (&candidates, &access), time_s)?,
    };
    survey::check(bench, &visits)?;
    Ok(visits)
}

/// The greedy choice, as far as the time limit in minutes allows.
fn optimal(
    bench: &DesignSetup<'_>,
    (candidates, access): (&Candidates, &Access),
    time_s: impl Fn(&[Visit]) -> Result<f64, Refused>,
) -> Result<Vec<Visit>, Refused> {
    let (balls, settings) = (bench.balls.balls.len(), bench.settings);
    let budget = Budget { balls: settings.balls, indexations: settings.indexations };
    let sights = &candidates.sights;
    let chosen = choose(sights, balls, bench.nothing(), budget, settings.criterion)?;
    let first = |count: usize| {
        let some = chosen.sights.get(..count).unwrap_or_default();
        let visits = in_order(&bench.plan.machine, candidates.visits(some));
        balls_in_order(&bench.measurement(), access, visits)
    };
    if settings.minutes == 0.0 {
        return first(chosen.sights.len());
    }
    let limit_s = settings.minutes * 60.0;
    let least_s = time_s(&first(chosen.least)?)?;
    if least_s > limit_s {
        return Err(Refused {
            why: format!(
                "{} minutes do not suffice: to measure every ball at {LEAST_VISITS} indexations takes \
                 {:.1} minutes of machine time",
                settings.minutes,
                least_s / 60.0
            ),
            instead: "raise minutes, choose find = \"once\", or take balls out of [artefact]"
                .to_owned(),
        });
    }
    // Bisection: `fits` is known to fit.
    let (mut fits, mut beyond) = (chosen.least, chosen.sights.len() + 1);
    while beyond - fits > 1 {
        let middle = (fits + beyond) / 2;
        if time_s(&first(middle)?)? <= limit_s { fits = middle } else { beyond = middle }
    }
    first(fits)
}

impl Candidates {
    /// # Errors
    /// An indexation is outside the limits; a ball is accessible at fewer than three indexations.
    pub fn new(bench: &DesignSetup<'_>, access: &Access) -> Result<Self, Refused> {
        let paper;
        let settings = match bench.settings.design {
            Kind::Optimal => bench.settings,
            Kind::Paper => {
                paper = paper::settings(bench.settings);
                &paper
            }
        };
        let positions = settings.positions(bench.oriented);
        let chain = bench.model.chain();
        let at = indexations(crate::samba::NAME, &bench.plan.machine, chain, &positions)?;
        let mut sights = Vec::new();
        for (ball, of) in bench.balls.balls.iter().enumerate() {
            let (mut count, mut why_not) = (0, BTreeMap::<String, &Position>::new());
            for (indexation, free) in free(bench, access, &at, of).into_iter().enumerate() {
                let Some(at) = at.get(indexation) else { continue };
                match free {
                    Ok(()) => {
                        sights.push(bench.sight((indexation, at), (ball, of))?);
                        count += 1;
                    }
                    Err(why) => drop(why_not.entry(why).or_insert(at)),
                }
            }
            if count < LEAST_VISITS {
                return Err(unreachable_ball(&of.id, count, at.len(), &why_not));
            }
        }
        Ok(Self { at, sights })
    }

    /// The chosen sights, grouped by indexation.
    pub fn visits(&self, chosen: &[usize]) -> Vec<Visit> {
        let mut by_place: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for sight in chosen.iter().filter_map(|index| self.sights.get(*index)) {
            by_place.entry(sight.indexation).or_default().push(sight.ball);
        }
        let visit = |(place, balls): (usize, Vec<usize>)| {
            Some(Visit::new(self.at.get(place)?.clone(), balls))
        };
        by_place.into_iter().filter_map(visit).collect()
    }
}

/// Whether a ball can be measured at each indexation, or the reason why not. The check uses the search at the
/// stated position, enlarged by its uncertainty; the ball can then be measured wherever it is found.
fn free(
    bench: &DesignSetup<'_>,
    access: &Access,
    at: &[Position],
    ball: &Ball,
) -> Vec<Result<(), String>> {
    let approach = bench.measurement().search(bench.balls.uncertainty_mm);
    // A stylus on the spindle axis occupies the same space at every spindle angle.
    let central = bench.tip.mm.xy().norm() < CENTRAL_MM;
    let mut last: Option<(Position, Result<(), String>)> = None;
    let mut all = Vec::with_capacity(at.len());
    for place in at {
        let rotary = if central { place.only(|axis| axis != Axis::S) } else { place.clone() };
        let answer = match last.take().filter(|(before, _)| *before == rotary) {
            Some((_, answer)) => answer,
            None => match access.accessible(&bench.measurement().task(ball, place, approach)) {
                Ok(_) => Ok(()),
                Err(why) => Err(why.to_string()),
            },
        };
        all.push(answer.clone());
        last = Some((rotary, answer));
    }
    all
}

fn unreachable_ball(
    id: &str,
    count: usize,
    of: usize,
    why_not: &BTreeMap<String, &Position>,
) -> Refused {
    let reasons: Vec<String> = why_not
        .iter()
        .take(2)
        .map(|(why, at)| format!("at {} {why}", describe_position(at)))
        .collect();
    let reached = match count {
        0 => "cannot be reached at any".to_owned(),
        some => format!("can be reached at {some} only"),
    };
    Refused {
        why: format!(
            "ball {id} {reached} of {of} indexations, where {LEAST_VISITS} are needed: {}",
            reasons.join("; ")
        ),
        instead:
            "set the ball up elsewhere or with another stem, name other positions in tilt_deg and \
                  turn_deg, or take it out of [artefact]"
                .to_owned(),
    }
}
