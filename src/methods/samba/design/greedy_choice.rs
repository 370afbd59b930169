//! Greedy design: ball measurements are added one by one, each time the measurement with the most information about the
//! machine per unit of time.

use std::collections::BTreeSet;

use super::machine_information::{CandidateMeasurement, MachineInformation};
use crate::MethodRefusal;
use crate::samba::settings::SambaSettings;

/// Minimum number of measurements of a ball. An uncalibrated ball adds three unknowns. With fewer measurements, the
/// ball gives hardly any information about the machine.
pub const MIN_VISITS_PER_BALL: usize = 3;

/// Additional time for a new indexation, in units of the time of a ball measurement: the rotation and the
/// path to it.
const NEW_INDEXATION_COST: f64 = 0.25;

/// Indices of the candidates in the order in which they were chosen.
pub struct ChosenMeasurements {
    /// All chosen candidates, in the order of the choice; not the measuring order.
    pub candidate_indices: Vec<usize>,
    /// Number of candidates after which each ball has [`MIN_VISITS_PER_BALL`] indexations.
    pub count_with_min_visits: usize,
}

/// State of the greedy choice.
struct GreedyChoice<'a> {
    candidates: &'a [CandidateMeasurement],
    settings: &'a SambaSettings,
    /// Information from the certified lengths and the chosen candidates.
    information: MachineInformation,
    /// Indices of the chosen candidates, in the order of the choice.
    chosen_indices: Vec<usize>,
    /// Indexations of the chosen candidates.
    chosen_indexations: BTreeSet<usize>,
    /// Number of visits of each ball.
    visit_counts: Vec<usize>,
}

/// Chooses candidates. `lengths` is the information from the certified lengths alone.
///
/// First an indexation with most balls is chosen, then indexations for the remaining balls, then every ball
/// at [`MIN_VISITS_PER_BALL`] indexations, then the candidates with the most information.
///
/// # Errors
/// The budget does not suffice for [`MIN_VISITS_PER_BALL`] of each ball.
pub fn choose_measurements(
    candidates: &[CandidateMeasurement],
    ball_count: usize,
    lengths: MachineInformation,
    settings: &SambaSettings,
) -> Result<ChosenMeasurements, MethodRefusal> {
    let mut choice = GreedyChoice {
        candidates,
        settings,
        information: lengths,
        chosen_indices: Vec::new(),
        chosen_indexations: BTreeSet::new(),
        visit_counts: vec![0; ball_count],
    };
    while choice.add_indexation_with_most_new_balls() {}
    while choice.visit_counts.iter().any(|visits| *visits < MIN_VISITS_PER_BALL) {
        if !choice.add_best_candidate(true) {
            return Err(choice.budget_refusal());
        }
    }
    let min_count = choice.chosen_indices.len();
    while choice.add_best_candidate(false) {}
    Ok(ChosenMeasurements { candidate_indices: choice.chosen_indices, count_with_min_visits: min_count })
}

impl GreedyChoice<'_> {
    /// Adds, within the limits, the balls not measured yet at the indexation that has the most of them. False: no ball
    /// was added.
    fn add_indexation_with_most_new_balls(&mut self) -> bool {
        let is_new = |candidate: &&CandidateMeasurement| self.visit_counts.get(candidate.ball_index) == Some(&0);
        let indexations = self.candidates.iter().map(|candidate| candidate.indexation_index);
        let count = |at: usize| self.candidates.iter().filter(|s| s.indexation_index == at).filter(is_new).count();
        let indexation_set: BTreeSet<usize> = indexations.collect();
        // Of indexations with equal counts, the first one is chosen.
        let best = indexation_set.into_iter().rev().max_by_key(|at| count(*at));
        let Some(best) = best.filter(|at| count(*at) > 0) else { return false };
        let is_there = |(_, candidate): &(usize, &CandidateMeasurement)| {
            candidate.indexation_index == best && (is_new(candidate) || self.chosen_indices.is_empty())
        };
        let found: Vec<usize> = self.candidates.iter().enumerate().filter(is_there).map(|(index, _)| index).collect();
        let allowed: Vec<usize> = found.into_iter().filter(|index| self.fits_size_limits(*index)).collect();
        allowed.iter().for_each(|index| self.add_candidate(*index));
        !allowed.is_empty()
    }

    /// Adds the candidate with the most information per time within the budget; with `only_below_min_visits` only of
    /// balls that need more visits. False: no candidate was added.
    fn add_best_candidate(&mut self, only_below_min_visits: bool) -> bool {
        let is_eligible = |candidate: &CandidateMeasurement| {
            !only_below_min_visits
                || self.visit_counts.get(candidate.ball_index).is_some_and(|visits| *visits < MIN_VISITS_PER_BALL)
        };
        let mut best: Option<(f64, usize)> = None;
        for (index, candidate) in self.candidates.iter().enumerate() {
            if is_eligible(candidate) && self.fits_size_limits(index) {
                let gain = self.information.information_gain(candidate, self.settings.criterion);
                let score = gain / self.relative_cost(candidate);
                if best.is_none_or(|(highest, _)| score > highest) {
                    best = Some((score, index));
                }
            }
        }
        if let Some((_, index)) = best {
            self.add_candidate(index);
        }
        best.is_some()
    }

    /// Whether the candidate is not chosen yet and fits into the limits of measurements and indexations.
    fn fits_size_limits(&self, index: usize) -> bool {
        let Some(candidate) = self.candidates.get(index) else { return false };
        let has_room = self.chosen_indexations.len() < self.settings.indexations;
        !self.chosen_indices.contains(&index)
            && self.chosen_indices.len() < self.settings.max_ball_measurements
            && (has_room || self.chosen_indexations.contains(&candidate.indexation_index))
    }

    /// Time in units of a ball measurement.
    fn relative_cost(&self, candidate: &CandidateMeasurement) -> f64 {
        if self.chosen_indexations.contains(&candidate.indexation_index) { 1.0 } else { 1.0 + NEW_INDEXATION_COST }
    }

    fn add_candidate(&mut self, index: usize) {
        let Some(candidate) = self.candidates.get(index) else { return };
        self.information.add_measurement(candidate);
        self.chosen_indices.push(index);
        self.chosen_indexations.insert(candidate.indexation_index);
        if let Some(visits) = self.visit_counts.get_mut(candidate.ball_index) {
            *visits += 1;
        }
    }

    fn budget_refusal(&self) -> MethodRefusal {
        let min_measurements = MIN_VISITS_PER_BALL * self.visit_counts.len();
        MethodRefusal::new(
            format!(
                "the budget of {} ball measurements at {} indexations is too small: every ball must be measured at \
                {MIN_VISITS_PER_BALL} indexations or more, which needs {min_measurements} measurements",
                self.settings.max_ball_measurements, self.settings.indexations
            ),
            "increase balls and indexations in [method.samba], or remove balls from [artefact]",
        )
    }
}
