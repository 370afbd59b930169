//! Decision rules, and what a machine's history says.

pub mod difference;
pub mod function_difference;
pub mod references;
pub mod revisit;
pub mod trend;

use machine::record::estimate::{Estimate, Limit, Parameter, Verdict};

/// Judge every parameter that has a tolerance, with the expanded uncertainty as guard band on both
/// sides (ISO 14253-1): pass only if the whole interval lies inside, fail only if it lies outside,
/// otherwise undecided. The worst parameter decides; a limit for something that was not estimated, or
/// in another unit, leaves it undecided; without any limit there is no verdict. A misfit that the
/// identification has found stands, whatever the limits.
pub fn judge(estimate: &Estimate, limits: &[Limit]) -> Verdict {
    if estimate.verdict == Verdict::UndecidedModel {
        return Verdict::UndecidedModel;
    }
    let verdicts: Vec<Verdict> = limits
        .iter()
        .map(|limit| {
            let matches = |p: &&Parameter| p.symbol == limit.symbol && p.unit == limit.unit;
            match estimate.parameters.iter().find(matches) {
                Some(parameter) => judge_one(parameter, limit.limit),
                None => Verdict::Undecided,
            }
        })
        .collect();
    let any = |wanted| verdicts.contains(&wanted);
    if verdicts.is_empty() {
        Verdict::None
    } else if any(Verdict::Fail) {
        Verdict::Fail
    } else if any(Verdict::Undecided) {
        Verdict::Undecided
    } else {
        Verdict::Pass
    }
}

/// Limits that no parameter of the estimate answers to, in words.
pub fn unmatched(estimate: &Estimate, limits: &[Limit]) -> Vec<String> {
    let known = |limit: &&Limit| {
        estimate.parameters.iter().any(|p| p.symbol == limit.symbol && p.unit == limit.unit)
    };
    let symbols: Vec<&str> = estimate.parameters.iter().map(|p| p.symbol.as_str()).collect();
    limits
        .iter()
        .filter(|limit| !known(limit))
        .map(|limit| {
            format!(
                "the limit for {} in {} matches no parameter; there are {}",
                limit.symbol,
                limit.unit.symbol(),
                symbols.join(", ")
            )
        })
        .collect()
}

fn judge_one(parameter: &Parameter, limit: f64) -> Verdict {
    let magnitude = parameter.value.abs();
    if !parameter.identifiable || !magnitude.is_finite() || !parameter.expanded.is_finite() {
        Verdict::Undecided
    } else if magnitude + parameter.expanded <= limit {
        Verdict::Pass
    } else if magnitude - parameter.expanded > limit {
        Verdict::Fail
    } else {
        Verdict::Undecided
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::Unit;

    fn one(value: f64, expanded: f64) -> Parameter {
        Parameter {
            symbol: "EX0C".to_owned(),
            value,
            unit: Unit::Um,
            u: expanded / 2.0,
            expanded,
            k: 2.0,
            dof: None,
            identifiable: true,
            u_monte_carlo: None,
            budget: Vec::new(),
        }
    }

    #[test]
    fn the_guard_band_makes_a_third_state() {
        assert_eq!(judge_one(&one(-7.9, 2.0), 10.0), Verdict::Pass);
        assert_eq!(judge_one(&one(-8.1, 2.0), 10.0), Verdict::Undecided);
        assert_eq!(judge_one(&one(11.9, 2.0), 10.0), Verdict::Undecided);
        assert_eq!(judge_one(&one(12.1, 2.0), 10.0), Verdict::Fail);
        assert_eq!(judge_one(&one(f64::NAN, 2.0), 10.0), Verdict::Undecided);
    }
}
