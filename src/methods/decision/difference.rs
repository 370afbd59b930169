//! Two results beside each other: what differs by more than both can be in doubt.

use serde::Serialize;

use estimation::coverage::{coverage_factor, effective_dof};
use machine::record::estimate::{Estimate, Parameter, Unit};

/// Of one value, the second result less the first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    pub symbol: String,
    pub unit: Unit,
    pub first: f64,
    pub second: f64,
    pub by: f64,
    /// Expanded uncertainty of `by`. Both results count as independent: what they share (one artefact, one
    /// probe) is counted twice, so that a difference is rather missed than made up.
    #[serde(rename = "U")]
    pub expanded: f64,
    /// Whether `by` is beyond its uncertainty.
    pub significant: bool,
}

/// Of all values that both have identified, in the order of the first.
pub fn differences(first: &Estimate, second: &Estimate) -> Vec<Difference> {
    let pairs = first.parameters.iter().filter_map(|one| {
        let same = |other: &&Parameter| (&other.symbol, other.unit) == (&one.symbol, one.unit);
        Some((one, second.parameters.iter().find(same)?))
    });
    let known = pairs.filter(|(one, other)| one.identifiable && other.identifiable);
    known.filter_map(|(one, other)| difference(one, other)).collect()
}

/// `None` where a number is missing.
fn difference(one: &Parameter, other: &Parameter) -> Option<Difference> {
    let part = |p: &Parameter| (p.u.powi(2), p.dof.unwrap_or(f64::INFINITY));
    let parts = [part(one), part(other)];
    let u = (parts[0].0 + parts[1].0).sqrt();
    let by = other.value - one.value;
    let expanded = coverage_factor(effective_dof(&parts)) * u;
    let difference = Difference {
        symbol: one.symbol.clone(),
        unit: one.unit,
        first: one.value,
        second: other.value,
        by,
        expanded,
        significant: by.abs() > expanded,
    };
    (by.is_finite() && expanded.is_finite()).then_some(difference)
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use estimation::random::stream;

    fn parameter(value: f64, u: f64, dof: Option<f64>) -> Parameter {
        serde_json::from_value(serde_json::json!({
            "symbol": "EX0C", "value": value, "unit": "um", "u": u, "U": 2.0 * u, "k": 2.0,
            "dof": dof, "identifiable": true,
        }))
        .unwrap()
    }

    /// GUM, G.4.1 and table G.2: u of 2 and 1 with 4 and 8 degrees of freedom have 25/(16/4 + 1/8) = 6.06
    /// effective ones, cut to 6: t(95.45 %) = 2.52.
    #[test]
    fn its_uncertainty_is_that_of_both() {
        let found = difference(&parameter(1.0, 2.0, Some(4.0)), &parameter(7.0, 1.0, Some(8.0)));
        let found = found.unwrap();
        assert!((found.by - 6.0).abs() < 1e-12 && found.significant);
        let k = found.expanded / 5f64.sqrt();
        assert!((2.50..2.53).contains(&k), "{k}");
        let many = difference(&parameter(1.0, 3.0, None), &parameter(10.0, 4.0, None)).unwrap();
        assert!((many.expanded - 10.0).abs() < 0.05 && !many.significant, "{}", many.expanded);
    }

    /// Machines that have not changed: a difference is told in 4.6 of 100.
    #[test]
    fn false_alarms_come_as_often_as_said() {
        let mut rng = stream(5, &[1]);
        let mut draw =
            |u: f64| -> f64 { u * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
        let told = (0..4000).filter(|_| {
            let (one, other) = (parameter(draw(0.6), 0.6, None), parameter(draw(0.8), 0.8, None));
            difference(&one, &other).unwrap().significant
        });
        // 182 expected, standard deviation 13.
        let told = told.count();
        assert!((142..=222).contains(&told), "{told}");
    }

    #[test]
    fn what_one_of_them_does_not_know_is_left_out() {
        let mut estimate: Estimate = serde_json::from_value(serde_json::json!({
            "trued_estimate": 1, "method": "samba", "parameters": [], "functions": [],
            "covariance": {"symbols": [], "rows": []}, "rank": 1, "unknowns": 1, "condition": 1.0,
            "gauge": [], "not_identifiable": [], "residual_rms_um": 0.3, "degrees_of_freedom": 5,
            "chi2_per_dof": 1.1, "verdict": "none", "warnings": [], "priors": [],
        }))
        .unwrap();
        let lost = Parameter { identifiable: false, ..parameter(1.0, 1.0, None) };
        let other = Parameter { symbol: "EY0C".to_owned(), ..parameter(1.0, 1.0, None) };
        let unit = Parameter { unit: Unit::Mm, ..other.clone() };
        estimate.parameters = vec![parameter(1.0, 1.0, None), other];
        let mut second = estimate.clone();
        assert_eq!(differences(&estimate, &second).len(), 2);
        second.parameters = vec![lost, unit];
        assert_eq!(differences(&estimate, &second), []);
    }
}
