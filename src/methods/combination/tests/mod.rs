mod compatibility;
mod consistency;

use nalgebra::{DMatrix, DVector};
use rand_distr::{Distribution, StandardNormal};
use serde_json::json;

use super::*;
use estimation::random::seeded_stream;
use machine::Axis;
use machine::record::estimate::{BudgetLine, Parameter};

/// A run with parameters in µm, built from its values, its own covariance and its shareable sources.
#[derive(Clone)]
struct TestRun {
    number: i64,
    plan: Plan,
    estimate: Estimate,
}

fn plan(method: &str) -> Plan {
    serde_json::from_value(json!({
        "trued_plan": 1, "method": method, "settings": {},
        "machine": {"name": "mill", "topology": "w-C-B-X-F-Z-Y-S-t"},
        "probe": {"ball_radius_mm": 3.0, "stylus": "no. 12"},
        "artefact": {"kind": "cylinder", "centre_mm": [0, 0, 50], "axis": [0, 0, 1], "radius_mm": 45},
    }))
    .unwrap()
}

fn parameter(symbol: &str, value: f64, u: f64) -> Parameter {
    serde_json::from_value(json!({
        "symbol": symbol, "value": value, "unit": "um", "u": u, "U": 2.0 * u, "k": 2.0, "dof": null,
        "identifiable": true,
    }))
    .unwrap()
}

impl TestRun {
    fn new(number: i64, symbols: &[&str], values: &[f64], own_covariance: &DMatrix<f64>) -> Self {
        let mut estimate: Estimate = serde_json::from_value(json!({
            "trued_estimate": 1, "method": "samba", "parameters": [], "functions": [],
            "covariance": {"symbols": symbols, "rows": []}, "rank": 1, "unknowns": 1, "condition": 1.0,
            "gauge": ["relative to C = 0"], "not_identifiable": [], "residual_rms_um": 0.3,
            "degrees_of_freedom": 5, "chi2_per_dof": 1.1, "verdict": "none", "warnings": [], "priors": [],
            "provenance": {"program": "", "machine": "mill", "plan_sha256": "", "readings_sha256": "",
                "probe_sha256": "", "artefact_sha256": "", "compensations_active": [], "duration_s": 0.0},
        }))
        .unwrap();
        let row = |i: usize| own_covariance.row(i).iter().copied().collect();
        estimate.covariance.rows = (0..symbols.len()).map(row).collect();
        let u = |i: usize| own_covariance[(i, i)].sqrt();
        estimate.parameters = (0..symbols.len()).map(|i| parameter(symbols[i], values[i], u(i))).collect();
        Self { number, plan: plan("samba"), estimate }
    }

    /// A run of EX0C alone.
    fn of_one_parameter(number: i64, value: f64, own_u: f64) -> Self {
        Self::new(number, &["EX0C"], &[value], &DMatrix::from_element(1, 1, own_u * own_u))
    }

    /// Adds a source. `draws`: the change of each parameter by each draw.
    fn with_source(mut self, source: &str, draws: &[&[f64]]) -> Self {
        let rows = &mut self.estimate.covariance.rows;
        for draw in draws {
            for (i, row) in rows.iter_mut().enumerate() {
                row.iter_mut().enumerate().for_each(|(j, entry)| *entry += draw[i] * draw[j]);
            }
        }
        for (i, row) in rows.iter().enumerate() {
            self.estimate.parameters[i].u = row[i].sqrt();
        }
        let changes_by_draw = draws.iter().map(|draw| draw.to_vec()).collect();
        self.estimate.source_effects.push(SourceEffect { source: source.to_owned(), changes_by_draw });
        self
    }

    fn measured(&self) -> MeasuredRun<'_> {
        let Self { number, plan, estimate } = self;
        MeasuredRun { number: *number, plan, estimate, source_effects: &estimate.source_effects }
    }
}

fn combine(runs: &[TestRun]) -> Result<Combination, CombinationRefusal> {
    combine_runs(&runs.iter().map(TestRun::measured).collect::<Vec<_>>())
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9 * expected.abs().max(1.0), "{found} {expected}");
}

const SYMBOLS: [&str; 3] = ["EX0C", "EY0C", "EA0C"];

/// Two linear models with unit weights: the combination of their solutions is the solution of all readings together,
/// and χ² is the increase of the sum of squares (Gauss–Markov).
#[test]
fn combination_equals_one_fit_of_all_readings() {
    let mut rng = seeded_stream(3, &[1]);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    let designs = [12, 7].map(|rows| DMatrix::from_fn(rows, 3, |_, _| draw()));
    let readings = [12, 7].map(|rows| DVector::from_fn(rows, |_, _| draw()));
    let fit = |a: &DMatrix<f64>, y: &DVector<f64>| {
        let inverse = a.tr_mul(a).try_inverse().unwrap();
        let x = &inverse * a.tr_mul(y);
        let squares = (y - a * &x).norm_squared();
        (x, inverse, squares)
    };
    let own: Vec<_> = designs.iter().zip(&readings).map(|(a, y)| fit(a, y)).collect();
    let runs: Vec<TestRun> = (1..)
        .zip(&own)
        .map(|(number, (x, inverse, _))| TestRun::new(number, &SYMBOLS, x.as_slice(), inverse))
        .collect();
    let all_rows = DMatrix::from_fn(19, 3, |i, j| if i < 12 { designs[0][(i, j)] } else { designs[1][(i - 12, j)] });
    let all_readings = DVector::from_fn(19, |i, _| if i < 12 { readings[0][i] } else { readings[1][i - 12] });
    let (x, inverse, squares) = fit(&all_rows, &all_readings);
    let combined = combine(&runs).unwrap();
    for (i, own) in combined.estimate.parameters.iter().enumerate() {
        near(own.value, x[i]);
        near(own.u, inverse[(i, i)].sqrt());
        near(own.expanded, 2.0 * own.u);
        near(combined.estimate.covariance.rows[i][(i + 1) % 3], inverse[(i, (i + 1) % 3)]);
    }
    near(combined.consistency.chi2, squares - own[0].2 - own[1].2);
    assert_eq!(combined.consistency.degrees_of_freedom, 3);
    assert_eq!(combined.estimate.provenance.unwrap().combined_runs, [1, 2]);
}

/// With n runs of own u 1 and a common source of 3: u² = 1/n + 3², whether or not the correlation is known.
#[test]
fn shared_source_does_not_average_out() {
    for source in ["stylus offset", "linearity of the sensor"] {
        for count in [2, 4, 9] {
            let run = |number: i64| TestRun::of_one_parameter(number, 5.0, 1.0).with_source(source, &[&[3.0]]);
            let combined = combine(&(1..=count).map(run).collect::<Vec<_>>()).unwrap();
            let own = &combined.estimate.parameters[0];
            near(own.u.powi(2), 1.0 / count as f64 + 9.0);
            let lines: f64 = own.budget.iter().map(|line| line.u.powi(2)).sum();
            near(lines, own.u.powi(2));
            let BudgetLine { source: name, u, .. } = &own.budget[1];
            near(*u, 3.0);
            assert_eq!(name, source);
            assert_eq!(combined.shared_sources.len(), 1);
            assert_eq!(combined.shared_sources[0].has_known_correlation, source == "stylus offset");
        }
    }
}

/// A reversal: the effect has the opposite sign in the second run and cancels in the mean.
#[test]
fn opposite_effects_of_a_shared_source_cancel() {
    let run = |number, value, effect| {
        TestRun::of_one_parameter(number, value, 1.0).with_source("stylus offset", &[&[effect]])
    };
    let combined = combine(&[run(1, 14.0, 3.0), run(2, 6.0, -3.0)]).unwrap();
    near(combined.estimate.parameters[0].value, 10.0);
    near(combined.estimate.parameters[0].u, 0.5f64.sqrt());
    // The difference contains the source twice: u² = 1 + 1 + 6².
    near(combined.consistency.deviations[0].expanded, 2.0 * 38f64.sqrt());
    // If the sign is not known, nothing cancels: u² = 1/2 + 3².
    let run =
        |number, effect| TestRun::of_one_parameter(number, 10.0, 1.0).with_source("form of the sphere", &[&[effect]]);
    near(combine(&[run(1, 3.0), run(2, -3.0)]).unwrap().estimate.parameters[0].u.powi(2), 9.5);
}

/// The probe of the second run has another stylus qualification radius, so its source is independent: u² = (1 + 3²)/2.
#[test]
fn sources_do_not_average_out_where_the_statements_differ() {
    for (source, change) in [
        ("stylus offset", (|plan| plan.probe.feed_mm_min = 61.0) as fn(&mut Plan)),
        ("probe lobing", |plan| plan.probe.ball_radius_mm = 2.0),
        ("certified length", |plan| plan.artefact = machine::record::artefact::Artefact::None),
        ("backlash", |plan| plan.machine.drift_um_per_h = 9.0),
    ] {
        let run = |number| TestRun::of_one_parameter(number, 5.0, 1.0).with_source(source, &[&[3.0]]);
        let mut runs = [run(1), run(2)];
        change(&mut runs[1].plan);
        let combined = combine(&runs).unwrap();
        // 9 is the variance of the source, 1/2 that of the rest.
        near(combined.estimate.parameters[0].u.powi(2), 9.5);
        assert_eq!(combined.shared_sources[0].runs, [1, 2]);
    }
}

#[test]
fn draws_match_only_where_both_runs_state_the_same() {
    let is_known = |source: &str, effects: [f64; 2], change: fn(&mut Plan)| {
        let run = |number, effect| TestRun::of_one_parameter(number, 5.0, 1.0).with_source(source, &[&[effect]]);
        let mut runs = [run(1, effects[0]), run(2, effects[1])];
        change(&mut runs[1].plan);
        combine(&runs).unwrap().shared_sources[0].has_known_correlation
    };
    assert!(is_known("probe lobing", [3.0, 2.0], |_| ()));
    assert!(!is_known("probe lobing", [3.0, 3.0], |plan| plan.probe.lobing_um = 9.0), "other declared size");
    assert!(!is_known("backlash", [3.0, 3.0], |plan| plan.machine.drift_um_per_h = 9.0), "other machine file");
    let motions = "error motions of X, Y and Z";
    assert!(is_known(motions, [3.0, 3.01], |_| ()));
    assert!(!is_known(motions, [3.0, -3.0], |_| ()), "other points");
}

/// Not more than the run with the fewest has.
#[test]
fn degrees_of_freedom_are_the_smallest_of_the_runs() {
    let run = |number, dof| {
        let mut run = TestRun::of_one_parameter(number, 5.0, 1.0).with_source("stylus offset", &[&[0.5]]);
        run.estimate.parameters[0].dof = dof;
        run
    };
    let dof = |runs: &[TestRun]| combine(runs).unwrap().estimate.parameters[0].dof;
    assert_eq!(dof(&[run(1, Some(9.0)), run(2, Some(4.0))]), Some(4.0));
    assert_eq!(dof(&[run(1, None), run(2, Some(7.0))]), Some(7.0));
    assert_eq!(dof(&[run(1, None), run(2, None)]), None);
}

/// The balls of the older run were at other places: they have no influence.
#[test]
fn set_up_is_that_of_the_newest_run() {
    let run = |number, ball| TestRun::new(number, &["EX0C", "ball_1_x"], &[5.0, ball], &DMatrix::identity(2, 2));
    let combined = combine(&[run(2, 100.0), run(1, 900.0)]).unwrap();
    near(combined.estimate.parameters[1].value, 100.0);
    assert_eq!(combined.parameters[1].values, [None, Some(100.0)]);
    assert!(combined.consistency.is_consistent());
}

#[test]
fn measured_ranges_cover_those_of_all_runs() {
    let mut runs = [1, 2].map(|number| TestRun::of_one_parameter(number, 5.0, 1.0));
    runs[0].estimate.measured_ranges = [(Axis::X, [-100.0, 50.0]), (Axis::Y, [0.0, 1.0]), (Axis::Z, [0.0, 9.0])].into();
    runs[1].estimate.measured_ranges = [(Axis::X, [-20.0, 80.0]), (Axis::Y, [5.0, 9.0])].into();
    let expected = [(Axis::X, [-100.0, 80.0]), (Axis::Y, [5.0, 9.0]), (Axis::Z, [0.0, 9.0])].into();
    assert_eq!(combine(&runs).unwrap().estimate.measured_ranges, expected);
}

/// A source that is declared as zero has no draws.
#[test]
fn source_without_draws_has_no_effect() {
    let run = |number| TestRun::of_one_parameter(number, 5.0, 1.0).with_source("form of the sphere", &[]);
    let combined = combine(&[run(1), run(2)]).unwrap();
    near(combined.estimate.parameters[0].u.powi(2), 0.5);
    assert!(combined.shared_sources.is_empty());
}
