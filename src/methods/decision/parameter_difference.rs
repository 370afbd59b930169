//! Comparison of two estimates: the difference of each parameter, with its expanded uncertainty and E_n.

use serde::Serialize;

use estimation::coverage::coverage_factor;
use machine::record::estimate::{BudgetLine, Estimate, EvaluationType, Parameter, Provenance, Unit};

/// The object to which a source of uncertainty belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SourceOwner {
    Probe,
    Machine,
    Artefact,
}

/// Sources of type B that have the same value in every run with the same owner. Every other source, including
/// unknown ones, counts as independent; U of a difference is then rather too large.
const PERSISTENT_SOURCES: [(&str, SourceOwner); 7] = [
    ("stylus offset", SourceOwner::Probe),
    ("probe lobing", SourceOwner::Probe),
    ("backlash", SourceOwner::Machine),
    ("error motions of X, Y and Z", SourceOwner::Machine),
    ("squareness of X, Y and Z", SourceOwner::Machine),
    ("error motions of rotary axes", SourceOwner::Machine),
    ("certified length", SourceOwner::Artefact),
];

/// Owner of a persistent source of type B. `None`: it is not known whether the source is the same in several runs.
pub fn source_owner(source: &str) -> Option<SourceOwner> {
    PERSISTENT_SOURCES.iter().find(|(name, _)| *name == source).map(|(_, owner)| *owner)
}

impl SourceOwner {
    /// Field of the provenance that identifies the owner.
    fn provenance_field(self, provenance: &Provenance) -> &str {
        match self {
            Self::Probe => &provenance.probe_sha256,
            Self::Machine => &provenance.machine,
            Self::Artefact => &provenance.artefact_sha256,
        }
    }
}

/// Whether the source of a budget line has the same value in each run with the same machine, probe and artefact.
pub fn is_persistent_source(line: &BudgetLine) -> bool {
    source_owner(&line.source).is_some() && line.evaluation_type == Some(EvaluationType::B)
}

/// Difference of one parameter between two estimates, second minus first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterDifference {
    pub symbol: String,
    pub unit: Unit,
    pub first: f64,
    pub second: f64,
    pub by: f64,
    /// Expanded uncertainty of `by`, coverage probability 95.45 %.
    #[serde(rename = "U")]
    pub expanded: f64,
    /// Normalized error |by|/U (ISO 13528): the results agree up to 1. `null` in JSON: infinite, because U is
    /// 0.
    #[serde(rename = "E_n")]
    pub normalized_error: f64,
    /// Whether the difference is significant: E_n is above 1.
    pub significant: bool,
}

/// Returns |by|/expanded: 0 if both are 0, infinite if only `expanded` is 0.
pub fn normalized_error(by: f64, expanded: f64) -> f64 {
    if by == 0.0 { 0.0 } else { by.abs() / expanded }
}

/// Sources of type B that both budgets contain and that have the same value in both runs. If the provenance
/// is unknown, probe, machine and artefact count as the same.
pub fn common_sources(first: &Estimate, second: &Estimate) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let others: Vec<&BudgetLine> = second.parameters.iter().flat_map(|p| &p.budget).collect();
    for line in first.parameters.iter().flat_map(|parameter| &parameter.budget) {
        let is_type_b = |line: &BudgetLine| line.evaluation_type == Some(EvaluationType::B);
        let is_in_both = others.iter().any(|other| other.source == line.source && is_type_b(other));
        let is_same = source_owner(&line.source).is_some_and(|owner| have_same_owner(owner, first, second));
        if is_type_b(line) && is_in_both && is_same && !names.contains(&line.source) {
            names.push(line.source.clone());
        }
    }
    names
}

/// Whether probe, machine or artefact is the same in both estimates; `true` if a provenance is unknown.
fn have_same_owner(owner: SourceOwner, first: &Estimate, second: &Estimate) -> bool {
    let pair = first.provenance.as_ref().zip(second.provenance.as_ref());
    pair.is_none_or(|(first, second)| owner.provenance_field(first) == owner.provenance_field(second))
}

/// Differences of all parameters that both results identify, in the order of the first. The sources `common`
/// have the same value in both results and the same sign of their effect; all other sources are independent.
pub fn parameter_differences(first: &Estimate, second: &Estimate, common: &[String]) -> Vec<ParameterDifference> {
    let pairs = first.parameters.iter().filter_map(|one| {
        let same = |other: &&Parameter| (&other.symbol, other.unit) == (&one.symbol, one.unit);
        Some((one, second.parameters.iter().find(same)?))
    });
    let known = pairs.filter(|(one, other)| one.identifiable && other.identifiable);
    known.filter_map(|(one, other)| parameter_difference(one, other, common)).collect()
}

/// Difference of one parameter. `None`: the difference or its uncertainty is not finite.
fn parameter_difference(one: &Parameter, other: &Parameter, common: &[String]) -> Option<ParameterDifference> {
    let independent = one.u.powi(2) + other.u.powi(2);
    let shared = |source: &String| u_from_source(one, source) * u_from_source(other, source);
    let covariance: f64 = common.iter().map(shared).sum();
    // If all budget lines are common, rounding may give a negative variance.
    let variance = (independent - 2.0 * covariance).max(0.0);
    let by = other.value - one.value;
    let expanded = coverage_factor(effective_dof([one, other], variance)) * variance.sqrt();
    let normalized = normalized_error(by, expanded);
    let difference = ParameterDifference {
        symbol: one.symbol.clone(),
        unit: one.unit,
        first: one.value,
        second: other.value,
        by,
        expanded,
        normalized_error: normalized,
        significant: normalized > 1.0,
    };
    (by.is_finite() && expanded.is_finite()).then_some(difference)
}

/// Standard uncertainty of the parameter from one source.
fn u_from_source(parameter: &Parameter, source: &String) -> f64 {
    let lines = parameter.budget.iter().filter(|line| line.source == *source);
    lines.map(|line| line.u.powi(2)).sum::<f64>().sqrt()
}

/// Effective degrees of freedom of the difference (GUM, G.2b). The common sources have infinitely many.
fn effective_dof(parameters: [&Parameter; 2], variance: f64) -> f64 {
    let part = |p: &Parameter| p.dof.map_or(0.0, |dof| p.u.powi(4) / dof);
    let spread = part(parameters[0]) + part(parameters[1]);
    if spread > 0.0 { variance.powi(2) / spread } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use estimation::random::seeded_stream;

    fn parameter(value: f64, u: f64, dof: Option<f64>) -> Parameter {
        serde_json::from_value(serde_json::json!({
            "symbol": "EX0C", "value": value, "unit": "um", "u": u, "U": 2.0 * u, "k": 2.0,
            "dof": dof, "identifiable": true,
        }))
        .unwrap()
    }

    fn empty_estimate() -> Estimate {
        serde_json::from_value(serde_json::json!({
            "trued_estimate": 1, "method": "samba", "parameters": [], "functions": [],
            "covariance": {"symbols": [], "rows": []}, "rank": 1, "unknowns": 1, "condition": 1.0,
            "gauge": [], "not_identifiable": [], "residual_rms_um": 0.3, "degrees_of_freedom": 5,
            "chi2_per_dof": 1.1, "verdict": "none", "warnings": [], "priors": [],
        }))
        .unwrap()
    }

    /// GUM, G.4.1 and table G.2: u of 2 and 1 with 4 and 8 degrees of freedom gives 25/(16/4 + 1/8) = 6.06
    /// effective degrees of freedom, truncated to 6: t(95.45 %) = 2.52.
    #[test]
    fn uncertainty_of_a_difference_combines_both_runs() {
        let found = parameter_difference(&parameter(1.0, 2.0, Some(4.0)), &parameter(7.0, 1.0, Some(8.0)), &[]);
        let found = found.unwrap();
        assert!((found.by - 6.0).abs() < 1e-12 && found.significant);
        let k = found.expanded / 5f64.sqrt();
        assert!((2.50..2.53).contains(&k), "{k}");
        let many = parameter_difference(&parameter(1.0, 3.0, None), &parameter(10.0, 4.0, None), &[]).unwrap();
        assert!((many.expanded - 10.0).abs() < 0.05 && !many.significant, "{}", many.expanded);
    }

    /// For machines that have not changed, 4.6 of 100 differences are significant.
    #[test]
    fn unchanged_machines_differ_significantly_at_the_stated_rate() {
        let mut rng = seeded_stream(5, &[1]);
        let mut draw = |u: f64| -> f64 { u * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
        let significant = (0..4000).filter(|_| {
            let (one, other) = (parameter(draw(0.6), 0.6, None), parameter(draw(0.8), 0.8, None));
            parameter_difference(&one, &other, &[]).unwrap().significant
        });
        // 182 expected, standard deviation 13.
        let significant_count = significant.count();
        assert!((142..=222).contains(&significant_count), "{significant_count}");
    }

    #[test]
    fn parameters_not_comparable_between_two_runs_are_omitted() {
        let mut estimate = empty_estimate();
        let lost = Parameter { identifiable: false, ..parameter(1.0, 1.0, None) };
        let other = Parameter { symbol: "EY0C".to_owned(), ..parameter(1.0, 1.0, None) };
        let unit = Parameter { unit: Unit::Mm, ..other.clone() };
        estimate.parameters = vec![parameter(1.0, 1.0, None), other];
        let mut second = estimate.clone();
        assert_eq!(parameter_differences(&estimate, &second, &[]).len(), 2);
        second.parameters = vec![lost, unit];
        assert_eq!(parameter_differences(&estimate, &second, &[]), []);
    }

    fn parameter_with_budget_lines(value: f64, lines: &[(&str, EvaluationType, f64)]) -> Parameter {
        let line = |(source, evaluation, u): &(&str, EvaluationType, f64)| BudgetLine {
            source: (*source).to_owned(),
            evaluation_type: Some(*evaluation),
            u: *u,
            ..BudgetLine::default()
        };
        let u = lines.iter().map(|(.., u)| u * u).sum::<f64>().sqrt();
        Parameter { budget: lines.iter().map(line).collect(), ..parameter(value, u, None) }
    }

    fn provenance_with_probe_sha256(probe: &str) -> Provenance {
        Provenance {
            program: String::new(),
            machine: "mill".to_owned(),
            plan_sha256: String::new(),
            readings_sha256: String::new(),
            probe_sha256: probe.to_owned(),
            artefact_sha256: String::new(),
            compensations_active: Vec::new(),
            duration_s: 0.0,
            temperatures_c: Default::default(),
            combined_runs: Vec::new(),
        }
    }

    /// u² = 1 + 3² + 0.5² and 1.2² + 2² + 0.5². The probe contributes 3 and 2 and is common to both results:
    /// the variance of the difference is 1 + 1.44 + 2·0.25 + (3 − 2)² = 3.94.
    #[test]
    fn common_sources_cancel_in_the_difference() {
        use EvaluationType::{A, B};
        let one =
            parameter_with_budget_lines(10.0, &[("touches", A, 1.0), ("probe lobing", B, 3.0), ("resolution", B, 0.5)]);
        let other =
            parameter_with_budget_lines(13.0, &[("touches", A, 1.2), ("probe lobing", B, 2.0), ("resolution", B, 0.5)]);
        let [first, second] = [&one, &other].map(|it| Estimate { parameters: vec![it.clone()], ..empty_estimate() });
        let common = common_sources(&first, &second);
        assert_eq!(common, ["probe lobing"]);
        let with = |estimate: &Estimate, probe: &str| Estimate {
            provenance: Some(provenance_with_probe_sha256(probe)),
            ..estimate.clone()
        };
        assert_eq!(common_sources(&with(&first, "a"), &with(&second, "a")), ["probe lobing"]);
        assert!(common_sources(&with(&first, "a"), &with(&second, "b")).is_empty());
        let found = &parameter_differences(&first, &second, &common)[0];
        assert!((found.expanded - 2.0 * 3.94f64.sqrt()).abs() < 1e-9, "{}", found.expanded);
        assert!((found.normalized_error - 3.0 / (2.0 * 3.94f64.sqrt())).abs() < 1e-9);
        assert!(!found.significant);
        let independent = &parameter_differences(&first, &second, &[])[0];
        assert!((independent.expanded - 2.0 * 15.94f64.sqrt()).abs() < 1e-9);
        // 3.94²/(5.69²/ν) = 2 effective degrees of freedom; GUM, table G.2: t(95.45 %) = 4.53.
        let few = Parameter { dof: Some(2.0 * (5.69f64 / 3.94).powi(2)), ..other.clone() };
        let found = parameter_difference(&one, &few, &common).unwrap();
        assert!((found.expanded / 3.94f64.sqrt() - 4.53).abs() < 0.005, "{}", found.expanded);
        // With a common source only, equal values agree and different values do not.
        let whole = |value| parameter_with_budget_lines(value, &[("probe lobing", B, 3.0)]);
        let found = parameter_difference(&whole(1.0), &whole(1.0), &common).unwrap();
        assert_eq!((found.expanded, found.normalized_error, found.significant), (0.0, 0.0, false));
        let found = parameter_difference(&whole(1.0), &whole(2.0), &common).unwrap();
        assert!(found.normalized_error.is_infinite() && found.significant);
    }
}
