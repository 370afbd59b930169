//! The change that would decide an undecided result: more runs, or smaller systematic sources.

use super::parameter_difference::is_persistent_source;
use machine::record::estimate::{Parameter, Verdict};

/// Maximum number of runs that is proposed.
const MAX_PROPOSED_RUNS: u32 = 100;

/// What would decide an undecided parameter if its value stays the same.
#[derive(Debug, Clone, PartialEq)]
pub enum DecidingChange {
    /// Number of equal runs whose mean has a U below the distance from the value to the limit.
    Runs(u32),
    /// More than [`MAX_PROPOSED_RUNS`] runs: the value is too close to the limit.
    TooManyRuns,
    /// No number of runs suffices, because the sources that have the same value in each run are too large.
    SmallerSources {
        /// U from the sources with the same value in each run alone, in the unit of the parameter.
        expanded: f64,
        /// Name of the largest source with the same value in each run.
        largest: String,
    },
}

/// Change that would decide `parameter`; `None` if it is decided already, has no budget, or equals the limit.
///
/// Sources with the same value in each run, see [`is_persistent_source`], do not decrease in the mean of several runs;
/// the variance of all others is divided by the number of runs. The coverage factor stays the same.
pub fn deciding_change(parameter: &Parameter) -> Option<DecidingChange> {
    let judged = parameter.judged.filter(|judged| judged.verdict == Verdict::Undecided)?;
    let distance = (parameter.value.abs() - judged.limit).abs();
    if !parameter.identifiable
        || parameter.budget.is_empty()
        || parameter.k <= 0.0
        || !(distance > 0.0 && distance.is_finite())
    {
        return None;
    }
    let persistent = || parameter.budget.iter().filter(|line| is_persistent_source(line));
    let systematic: f64 = persistent().map(|line| line.u.powi(2)).sum();
    let random = (parameter.u.powi(2) - systematic).max(0.0);
    let allowed = (distance / parameter.k).powi(2) - systematic;
    if allowed <= 0.0 {
        let largest = persistent().max_by(|one, other| one.u.total_cmp(&other.u))?;
        let expanded = parameter.k * systematic.sqrt();
        return Some(DecidingChange::SmallerSources { expanded, largest: largest.source.clone() });
    }
    match (random / allowed).floor() + 1.0 {
        runs if runs <= f64::from(MAX_PROPOSED_RUNS) => Some(DecidingChange::Runs(runs as u32)),
        _ => Some(DecidingChange::TooManyRuns),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::{BudgetLine, EvaluationType, LimitVerdict, Unit};

    /// A parameter with limit 10 and k = 2.
    fn undecided(value: f64, u_a: f64, u_b: f64) -> Parameter {
        let line = |source: &str, kind, u| BudgetLine {
            source: source.to_owned(),
            evaluation_type: Some(kind),
            u,
            ..BudgetLine::default()
        };
        let u = u_a.hypot(u_b);
        Parameter {
            symbol: "EX0C".to_owned(),
            value,
            unit: Unit::Um,
            u,
            expanded: 2.0 * u,
            k: 2.0,
            dof: None,
            identifiable: true,
            u_monte_carlo: None,
            interval_monte_carlo: None,
            budget: vec![line("scatter", EvaluationType::A, u_a), line("stylus offset", EvaluationType::B, u_b)],
            judged: Some(LimitVerdict { limit: 10.0, verdict: Verdict::Undecided, conformance: None }),
        }
    }

    /// With u_A = 1.5 and a distance of 1: 2·1.5/√n < 1 for n > 9.
    #[test]
    fn runs_decrease_the_random_part_alone() {
        assert_eq!(deciding_change(&undecided(-9.0, 1.5, 0.0)), Some(DecidingChange::Runs(10)));
        // 2·√(1.5²/n + 0.3²) < 1 for n > 14.06.
        assert_eq!(deciding_change(&undecided(11.0, 1.5, 0.3)), Some(DecidingChange::Runs(15)));
    }

    #[test]
    fn large_systematic_sources_are_named() {
        let smaller = |expanded| Some(DecidingChange::SmallerSources { expanded, largest: "stylus offset".to_owned() });
        assert_eq!(deciding_change(&undecided(9.0, 1.5, 0.6)), smaller(1.2));
    }

    #[test]
    fn value_too_close_to_the_limit_needs_too_many_runs() {
        assert_eq!(deciding_change(&undecided(9.999, 1.5, 0.0)), Some(DecidingChange::TooManyRuns));
    }

    /// Drift is of type B, but differs from run to run.
    #[test]
    fn sources_of_type_b_that_vary_decrease_with_the_number_of_runs() {
        let mut drifting = undecided(-9.0, 0.0, 1.5);
        drifting.budget[1].source = "thermal drift".to_owned();
        assert_eq!(deciding_change(&drifting), Some(DecidingChange::Runs(10)));
    }

    #[test]
    fn decided_results_need_nothing() {
        let mut decided = undecided(1.0, 0.1, 0.1);
        decided.judged = decided.judged.map(|judged| LimitVerdict { verdict: Verdict::Pass, ..judged });
        assert_eq!(deciding_change(&decided), None);
        assert_eq!(deciding_change(&undecided(10.0, 1.0, 1.0)), None, "no distance");
        let without_budget = Parameter { budget: Vec::new(), ..undecided(9.0, 1.5, 0.0) };
        assert_eq!(deciding_change(&without_budget), None, "its sources are unknown");
    }
}
