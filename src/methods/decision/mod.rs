//! Decision rules, and the evaluation of a machine's history.

pub mod function_difference;
pub mod parameter_difference;
pub mod reference_check;
pub mod reference_shifts;
pub mod repeatability;
pub mod trend;
pub mod undecided;

use estimation::coverage::student_t_cdf;
use machine::record::estimate::{Estimate, LimitVerdict, Parameter, ParameterTolerance, Verdict};

const DECISION_RULE: &str = "guard bands of U on both sides (ISO 14253-1): pass if the whole coverage interval is inside the limit, \
    fail if the whole interval is outside; the verdict is that of the worst parameter";

/// Judges every parameter that has a tolerance. The expanded uncertainty is the guard band on both sides (ISO
/// 14253-1): a parameter passes only if the whole interval lies inside the limits, fails only if it lies
/// outside, and is undecided otherwise. The worst parameter decides. A limit for a parameter that was not
/// estimated, or that has another unit, leaves the verdict undecided unless another parameter fails. Without any limit
/// there is no verdict. A misfit that the identification has found takes precedence over the limits.
pub fn judge_estimate(estimate: &mut Estimate, tolerances: &[ParameterTolerance]) {
    let contradicted = estimate.verdict == Verdict::UndecidedModel;
    let mut verdicts = Vec::new();
    for ParameterTolerance { symbol, unit, limit } in tolerances {
        let mut parameters = estimate.parameters.iter_mut();
        let verdict = match parameters.find(|p| p.symbol == *symbol && p.unit == *unit) {
            Some(parameter) => {
                let judged = judge_parameter(parameter, *limit, contradicted);
                parameter.judged = Some(judged);
                judged.verdict
            }
            None => Verdict::Undecided,
        };
        verdicts.push(verdict);
    }
    let worst_first = [Verdict::Fail, Verdict::Undecided, Verdict::Pass];
    let worst = worst_first.into_iter().find(|verdict| verdicts.contains(verdict)).unwrap_or(Verdict::None);
    estimate.decision_rule = (!verdicts.is_empty()).then(|| DECISION_RULE.to_owned());
    estimate.verdict = if contradicted { Verdict::UndecidedModel } else { worst };
}

/// One text for each tolerance that matches no parameter of the estimate.
pub fn describe_unmatched_tolerances(estimate: &Estimate, tolerances: &[ParameterTolerance]) -> Vec<String> {
    let known = |limit: &&ParameterTolerance| {
        estimate.parameters.iter().any(|p| p.symbol == limit.symbol && p.unit == limit.unit)
    };
    // Backquotes mark a symbol as it is written in the machine file.
    let symbols: Vec<String> = estimate.parameters.iter().map(|p| format!("`{}`", p.symbol)).collect();
    tolerances
        .iter()
        .filter(|limit| !known(limit))
        .map(|limit| {
            format!(
                "the limit for `{}` in {} matches no parameter; the parameters are {}",
                limit.symbol,
                limit.unit.symbol(),
                symbols.join(", ")
            )
        })
        .collect()
}

/// Judges the magnitude of the value against `limit`. The conformance is the probability that the true value is
/// within ±limit.
fn judge_parameter(parameter: &Parameter, limit: f64, is_model_contradicted: bool) -> LimitVerdict {
    let Parameter { value, u, expanded, dof, .. } = *parameter;
    let magnitude = value.abs();
    let is_known = parameter.identifiable && magnitude.is_finite() && expanded.is_finite();
    let verdict = if is_model_contradicted {
        Verdict::UndecidedModel
    } else if !is_known {
        Verdict::Undecided
    } else if magnitude + expanded <= limit {
        Verdict::Pass
    } else if magnitude - expanded > limit {
        Verdict::Fail
    } else {
        Verdict::Undecided
    };
    let below = |bound: f64| student_t_cdf((bound - value) / u, dof.unwrap_or(f64::INFINITY));
    let conformance = (is_known && !is_model_contradicted && u > 0.0).then(|| below(limit) - below(-limit));
    LimitVerdict { limit, verdict, conformance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::Unit;

    fn parameter_with_expanded_u(value: f64, expanded: f64) -> Parameter {
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
            interval_monte_carlo: None,
            budget: Vec::new(),
            judged: None,
        }
    }

    #[test]
    fn guard_band_gives_undecided() {
        let verdict = |parameter: &Parameter| judge_parameter(parameter, 10.0, false).verdict;
        assert_eq!(verdict(&parameter_with_expanded_u(-7.9, 2.0)), Verdict::Pass);
        assert_eq!(verdict(&parameter_with_expanded_u(-8.1, 2.0)), Verdict::Undecided);
        assert_eq!(verdict(&parameter_with_expanded_u(11.9, 2.0)), Verdict::Undecided);
        assert_eq!(verdict(&parameter_with_expanded_u(12.1, 2.0)), Verdict::Fail);
        assert_eq!(verdict(&parameter_with_expanded_u(f64::NAN, 2.0)), Verdict::Undecided);
    }

    /// Values from tables: 84.13 % and 97.72 % of a normal distribution lie below one and two standard
    /// deviations; 95 % of Student's distribution with 5 degrees of freedom lies below 2.015.
    #[test]
    fn conformance_probability_agrees_with_tables() {
        let near = |parameter: &Parameter, expected: f64| {
            let found = judge_parameter(parameter, 10.0, false).conformance.unwrap();
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        };
        near(&parameter_with_expanded_u(9.0, 2.0), 0.8413);
        near(&parameter_with_expanded_u(-8.0, 2.0), 0.9772);
        near(&parameter_with_expanded_u(12.0, 2.0), 0.0228);
        // With a large u both limits count.
        near(&parameter_with_expanded_u(0.0, 20.0), 0.6827);
        near(&Parameter { dof: Some(5.0), ..parameter_with_expanded_u(10.0 - 2.015, 2.0) }, 0.9500);
        assert_eq!(judge_parameter(&parameter_with_expanded_u(f64::NAN, 2.0), 10.0, false).conformance, None);
        let contradicted = judge_parameter(&parameter_with_expanded_u(1.0, 2.0), 10.0, true);
        assert_eq!((contradicted.verdict, contradicted.conformance), (Verdict::UndecidedModel, None));
    }
}
