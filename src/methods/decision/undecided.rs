//! What decides an undecided result: more repeats of the run, or smaller systematic sources.

use machine::record::estimate::{EvaluationType, Parameter, Verdict};

/// Maximum number of repeats that is proposed.
const MAX_PROPOSED_REPEATS: u32 = 100;

/// What would decide an undecided parameter if its value stays the same.
#[derive(Debug, Clone, PartialEq)]
pub enum DecidingChange {
    /// The mean of this number of runs has a U below the distance from the value to the limit.
    Repeats(u32),
    /// No number of repeats suffices, because the sources that are the same in each run are too large.
    SmallerSources {
        /// U by these sources alone, in the unit of the parameter.
        expanded: f64,
        /// Name of the largest of them.
        largest: String,
    },
}

/// Change that would decide `parameter`; `None` if it is decided already, or if its value equals the limit.
///
/// Sources of type A (JCGM 100, 4.2) decrease with the square root of the number of runs, sources of type B (4.3) do
/// not decrease.
pub fn deciding_change(parameter: &Parameter) -> Option<DecidingChange> {
    let judged = parameter.judged.filter(|judged| judged.verdict == Verdict::Undecided)?;
    let distance = (parameter.value.abs() - judged.limit).abs();
    if !parameter.identifiable || parameter.k <= 0.0 || !(distance > 0.0 && distance.is_finite()) {
        return None;
    }
    let variance = |kind| -> f64 {
        let lines = parameter.budget.iter().filter(|line| line.evaluation_type == Some(kind));
        lines.map(|line| line.u.powi(2)).sum()
    };
    let (random, systematic) = (variance(EvaluationType::A), variance(EvaluationType::B));
    let repeats = random / ((distance / parameter.k).powi(2) - systematic);
    if repeats > 0.0 && repeats <= f64::from(MAX_PROPOSED_REPEATS) {
        return Some(DecidingChange::Repeats((repeats.floor() as u32 + 1).max(2)));
    }
    let systematic_lines = parameter.budget.iter().filter(|line| line.evaluation_type == Some(EvaluationType::B));
    let largest = systematic_lines.max_by(|one, other| one.u.total_cmp(&other.u))?;
    let expanded = parameter.k * systematic.sqrt();
    Some(DecidingChange::SmallerSources { expanded, largest: largest.source.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::{BudgetLine, LimitVerdict, Unit};

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
    fn repeats_decrease_the_random_part_alone() {
        assert_eq!(deciding_change(&undecided(-9.0, 1.5, 0.0)), Some(DecidingChange::Repeats(10)));
        // 2·√(1.5²/n + 0.3²) < 1 for n > 14.06.
        assert_eq!(deciding_change(&undecided(11.0, 1.5, 0.3)), Some(DecidingChange::Repeats(15)));
    }

    #[test]
    fn large_systematic_sources_are_named() {
        let smaller = |expanded| Some(DecidingChange::SmallerSources { expanded, largest: "stylus offset".to_owned() });
        assert_eq!(deciding_change(&undecided(9.0, 1.5, 0.6)), smaller(1.2));
        assert_eq!(deciding_change(&undecided(9.999, 1.5, 0.0)), smaller(0.0), "more repeats than are proposed");
    }

    #[test]
    fn decided_results_need_nothing() {
        let mut decided = undecided(1.0, 0.1, 0.1);
        decided.judged = decided.judged.map(|judged| LimitVerdict { verdict: Verdict::Pass, ..judged });
        assert_eq!(deciding_change(&decided), None);
        assert_eq!(deciding_change(&undecided(10.0, 1.0, 1.0)), None, "no distance");
    }
}
