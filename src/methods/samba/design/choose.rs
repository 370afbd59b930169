//! Greedy design: ball measurements are added one by one, each time the one with the most information about
//! the machine per time.

use std::collections::BTreeSet;

use super::information::{CandidateMeasurement, Information};
use crate::Refused;
use crate::samba::settings::Criterion;

/// Minimum number of measurements of a ball. An uncalibrated ball adds three unknowns; with fewer
/// measurements it gives hardly any information about the machine.
pub const LEAST_VISITS: usize = 3;

/// Additional time for a new indexation, in units of the time of a ball measurement: the rotation and the
/// path to it.
const OPENING: f64 = 0.25;

/// Maximum size of the design.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    pub balls: usize,
    pub indexations: usize,
}

/// Indices of the sights in the order in which they were chosen.
pub struct Chosen {
    pub sights: Vec<usize>,
    /// Number of sights after which each ball has [`LEAST_VISITS`] indexations.
    pub least: usize,
}

/// State of the greedy choice.
struct Choice<'a> {
    sights: &'a [CandidateMeasurement],
    budget: Budget,
    criterion: Criterion,
    information: Information,
    taken: Vec<usize>,
    opened: BTreeSet<usize>,
    /// Number of visits of each ball.
    visits: Vec<usize>,
}

/// Chooses sights. `nothing` holds the information of the lengths only.
///
/// First an indexation with most balls is chosen, then indexations for the remaining balls, then every ball
/// at [`LEAST_VISITS`] indexations, then the sights with the most information.
///
/// # Errors
/// The budget does not suffice for [`LEAST_VISITS`] of each ball.
pub fn choose(
    sights: &[CandidateMeasurement],
    balls: usize,
    nothing: Information,
    budget: Budget,
    criterion: Criterion,
) -> Result<Chosen, Refused> {
    let mut choice = Choice {
        sights,
        budget,
        criterion,
        information: nothing,
        taken: Vec::new(),
        opened: BTreeSet::new(),
        visits: vec![0; balls],
    };
    while choice.show_more() {}
    while choice.visits.iter().any(|visits| *visits < LEAST_VISITS) {
        if !choice.take_best(true) {
            return Err(choice.too_small());
        }
    }
    let least = choice.taken.len();
    while choice.take_best(false) {}
    Ok(Chosen { sights: choice.taken, least })
}

impl Choice<'_> {
    /// Adds all balls of the indexation with the most balls not measured yet.
    fn show_more(&mut self) -> bool {
        let new = |sight: &&CandidateMeasurement| self.visits.get(sight.ball) == Some(&0);
        let indexations = self.sights.iter().map(|sight| sight.indexation);
        let count =
            |at: usize| self.sights.iter().filter(|s| s.indexation == at).filter(new).count();
        let candidates: BTreeSet<usize> = indexations.collect();
        // The first of equal indexations.
        let best = candidates.into_iter().rev().max_by_key(|at| count(*at));
        let Some(best) = best.filter(|at| count(*at) > 0) else { return false };
        let there = |(_, sight): &(usize, &CandidateMeasurement)| {
            sight.indexation == best && (new(sight) || self.taken.is_empty())
        };
        let found: Vec<usize> =
            self.sights.iter().enumerate().filter(there).map(|(index, _)| index).collect();
        let allowed: Vec<usize> = found.into_iter().filter(|index| self.allows(*index)).collect();
        allowed.iter().for_each(|index| self.take(*index));
        !allowed.is_empty()
    }

    /// Adds the sight with the most information per time within the budget; with `wanting` only of balls that
    /// need more visits.
    fn take_best(&mut self, wanting: bool) -> bool {
        let wants = |sight: &CandidateMeasurement| {
            !wanting || self.visits.get(sight.ball).is_some_and(|visits| *visits < LEAST_VISITS)
        };
        let mut best: Option<(f64, usize)> = None;
        for (index, sight) in self.sights.iter().enumerate() {
            if wants(sight) && self.allows(index) {
                let score = self.information.gain(sight, self.criterion) / self.time_for(sight);
                if best.is_none_or(|(highest, _)| score > highest) {
                    best = Some((score, index));
                }
            }
        }
        if let Some((_, index)) = best {
            self.take(index);
        }
        best.is_some()
    }

    fn allows(&self, index: usize) -> bool {
        let Some(sight) = self.sights.get(index) else { return false };
        let room = self.opened.len() < self.budget.indexations;
        !self.taken.contains(&index)
            && self.taken.len() < self.budget.balls
            && (room || self.opened.contains(&sight.indexation))
    }

    /// Time in units of a ball measurement.
    fn time_for(&self, sight: &CandidateMeasurement) -> f64 {
        if self.opened.contains(&sight.indexation) { 1.0 } else { 1.0 + OPENING }
    }

    fn take(&mut self, index: usize) {
        let Some(sight) = self.sights.get(index) else { return };
        self.information.add(sight);
        self.taken.push(index);
        self.opened.insert(sight.indexation);
        if let Some(visits) = self.visits.get_mut(sight.ball) {
            *visits += 1;
        }
    }

    fn too_small(&self) -> Refused {
        let least = LEAST_VISITS * self.visits.len();
        Refused {
            why: format!(
                "the budget of {} ball measurements at {} indexations does not suffice: every \
                 ball must be measured at {LEAST_VISITS} indexations or more, {least} measurements",
                self.budget.balls, self.budget.indexations
            ),
            instead: "raise balls and indexations in [method.samba], or take balls out of \
                      [artefact]"
                .to_owned(),
        }
    }
}
