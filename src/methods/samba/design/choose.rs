//! The greedy choice: one measurement of a ball after the other, each time the one that tells most of
//! the machine for its time.

use std::collections::BTreeSet;

use super::information::{Information, Sight};
use crate::methods::Refused;
use crate::methods::samba::settings::Criterion;

/// A ball that nobody has calibrated brings three unknowns along: below three measurements it tells
/// hardly anything of the machine.
pub const LEAST_VISITS: usize = 3;

/// What may be spent at most.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    pub balls: usize,
    pub indexations: usize,
    pub seconds: f64,
}

/// What things take, s.
#[derive(Debug, Clone, Copy)]
pub struct Cost {
    pub ball_s: f64,
    pub indexation_s: f64,
}

/// What is chosen so far.
struct Choice<'a> {
    sights: &'a [Sight],
    budget: Budget,
    cost: Cost,
    criterion: Criterion,
    information: Information,
    taken: BTreeSet<usize>,
    opened: BTreeSet<usize>,
    /// Of each ball.
    visits: Vec<usize>,
    seconds: f64,
}

/// Indices of the chosen sights, ascending. `nothing` holds the lengths only.
///
/// First an indexation that sees most balls, then what shows the rest of them, then every ball at
/// [`LEAST_VISITS`] indexations, then whatever tells most.
///
/// # Errors
/// A budget that does not suffice for [`LEAST_VISITS`] of each ball.
pub fn choose(
    sights: &[Sight],
    balls: usize,
    nothing: Information,
    (budget, cost): (Budget, Cost),
    criterion: Criterion,
) -> Result<Vec<usize>, Refused> {
    let mut choice = Choice {
        sights,
        budget,
        cost,
        criterion,
        information: nothing,
        taken: BTreeSet::new(),
        opened: BTreeSet::new(),
        visits: vec![0; balls],
        seconds: 0.0,
    };
    while choice.show_more() {}
    while choice.visits.iter().any(|visits| *visits < LEAST_VISITS) {
        if !choice.take_best(true) {
            return Err(choice.too_small());
        }
    }
    while choice.take_best(false) {}
    Ok(choice.taken.into_iter().collect())
}

impl Choice<'_> {
    /// All balls of the indexation that sees most of those not seen yet.
    fn show_more(&mut self) -> bool {
        let new = |sight: &&Sight| self.visits.get(sight.ball) == Some(&0);
        let indexations = self.sights.iter().map(|sight| sight.indexation);
        let count =
            |at: usize| self.sights.iter().filter(|s| s.indexation == at).filter(new).count();
        let candidates: BTreeSet<usize> = indexations.collect();
        // The first of equals.
        let best = candidates.into_iter().rev().max_by_key(|at| count(*at));
        let Some(best) = best.filter(|at| count(*at) > 0) else { return false };
        let there = |(_, sight): &(usize, &Sight)| {
            sight.indexation == best && (new(&sight) || self.taken.is_empty())
        };
        let found: Vec<usize> =
            self.sights.iter().enumerate().filter(there).map(|(index, _)| index).collect();
        let allowed: Vec<usize> = found.into_iter().filter(|index| self.allows(*index)).collect();
        allowed.iter().for_each(|index| self.take(*index));
        !allowed.is_empty()
    }

    /// Of all that the budget allows, what tells most a second; with `wanting` only balls that want
    /// visits.
    fn take_best(&mut self, wanting: bool) -> bool {
        let wants = |sight: &Sight| {
            !wanting || self.visits.get(sight.ball).is_some_and(|visits| *visits < LEAST_VISITS)
        };
        let mut best: Option<(f64, usize)> = None;
        for (index, sight) in self.sights.iter().enumerate() {
            if wants(sight) && self.allows(index) {
                let score = self.information.gain(sight, self.criterion) / self.seconds_for(sight);
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
            && self.seconds + self.seconds_for(sight) <= self.budget.seconds
    }

    fn seconds_for(&self, sight: &Sight) -> f64 {
        let opens = !self.opened.contains(&sight.indexation);
        self.cost.ball_s + if opens { self.cost.indexation_s } else { 0.0 }
    }

    fn take(&mut self, index: usize) {
        let Some(sight) = self.sights.get(index) else { return };
        self.seconds += self.seconds_for(sight);
        self.information.add(sight);
        self.taken.insert(index);
        self.opened.insert(sight.indexation);
        if let Some(visits) = self.visits.get_mut(sight.ball) {
            *visits += 1;
        }
    }

    fn too_small(&self) -> Refused {
        let least = LEAST_VISITS * self.visits.len();
        let minutes = match self.budget.seconds.is_finite() {
            true => format!(", {:.1} minutes", self.budget.seconds / 60.0),
            false => String::new(),
        };
        Refused {
            why: format!(
                "the budget of {} ball measurements at {} indexations{minutes} does not suffice: every \
                 ball must be measured at {LEAST_VISITS} indexations or more, {least} measurements",
                self.budget.balls, self.budget.indexations
            ),
            instead: "raise balls, indexations or minutes in [method.samba], or take balls out of \
                      [artefact]"
                .to_owned(),
        }
    }
}
