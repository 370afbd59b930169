use super::compare::{CompareError, compare_runs};
use super::history::{draw_series_chart, machine_history};
use super::report::render_report;
use super::run_story::{describe_events_with_times, describe_signatures, may_have_lost_position};
use crate::store::{EstimateSelection, EstimateSignature, Journal, NewRun, RunId, RunState};
use machine::record::estimate::{Estimate, Parameter, ParameterTolerance, Unit};
use machine::record::plan::Plan;

pub fn plan(method: &str, machine: &str) -> Plan {
    serde_json::from_value(serde_json::json!({
        "trued_plan": 1, "method": method, "settings": {},
        "machine": {"name": machine, "topology": "w-C-B-X-F-Z-Y-S-t"},
        "probe": {"ball_radius_mm": 3.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0, 0, 50], "axis": [0, 0, 1], "radius_mm": 45},
    }))
    .unwrap()
}

fn estimate_with_parameters(values: &[(&str, f64, bool)]) -> Estimate {
    let parameter = |(symbol, value, identifiable): &(&str, f64, bool)| Parameter {
        symbol: (*symbol).to_owned(),
        value: *value,
        unit: Unit::Um,
        u: 0.5,
        expanded: 1.0,
        k: 2.0,
        dof: None,
        identifiable: *identifiable,
        u_monte_carlo: None,
        interval_monte_carlo: None,
        budget: Vec::new(),
        judged: None,
    };
    let mut estimate: Estimate = serde_json::from_value(serde_json::json!({
        "trued_estimate": 1, "method": "samba", "parameters": [], "functions": [],
        "covariance": {"symbols": [], "rows": []}, "rank": 1, "unknowns": 1, "condition": 1.0,
        "gauge": [], "not_identifiable": [], "residual_rms_um": 0.3, "degrees_of_freedom": 5,
        "chi2_per_dof": 1.1, "verdict": "none", "warnings": [], "priors": [],
    }))
    .unwrap();
    estimate.parameters = values.iter().map(parameter).collect();
    estimate
}

/// A combination of runs is the last estimate of a run, but no value of its own.
#[test]
fn history_leaves_combinations_out() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let new = NewRun { machine_file_text: String::new(), plan: plan("samba", "mill") };
    let run = journal.begin_run(&new).wait().unwrap();
    let estimate = |value: f64, combined_runs: &[i64]| {
        let provenance = serde_json::from_value(serde_json::json!({
            "program": "", "machine": "mill", "plan_sha256": "", "readings_sha256": "", "probe_sha256": "",
            "artefact_sha256": "", "compensations_active": [], "duration_s": 1.0, "combined_runs": combined_runs,
        }));
        Estimate { provenance: Some(provenance.unwrap()), ..estimate_with_parameters(&[("EX0C", value, true)]) }
    };
    for (value, combined_runs) in [(1.0, &[][..]), (2.0, &[]), (3.0, &[1, 2])] {
        journal.add_estimate(run, &estimate(value, combined_runs)).wait().unwrap();
    }
    journal.set_state(run, RunState::Finished).wait().unwrap();
    assert_eq!(machine_history(&journal, "mill", &[]).unwrap()[0].values[0].value, 2.0);
    let stored = journal.load_run(run).unwrap();
    assert_eq!(stored.own_estimate().unwrap().parameters[0].value, 2.0);
    assert_eq!(stored.estimates.last().unwrap().estimate.combined_runs(), [1, 2]);
    assert_eq!(journal.newest_measured_runs("mill").unwrap().newest_result.unwrap().parameters[0].value, 3.0);
}

/// Finished runs of this machine only; the last estimate of each, with its identified parameters.
#[test]
fn history_has_the_last_estimate_of_each_finished_run() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = |method: &str, machine: &str, state, estimates: &[Estimate]| -> RunId {
        let new = NewRun { machine_file_text: String::new(), plan: plan(method, machine) };
        let id = journal.begin_run(&new).wait().unwrap();
        estimates.iter().for_each(|it| drop(journal.add_estimate(id, it).wait().unwrap()));
        journal.set_state(id, state).wait().unwrap();
        id
    };
    let finished = RunState::Finished;
    let one = |value| estimate_with_parameters(&[("EX0C", value, true), ("EZ0C", 9.0, false)]);
    let first = run("samba", "mill", finished, &[one(1.0), one(2.0)]);
    run("samba", "lathe", finished, &[one(3.0)]);
    run("samba", "mill", RunState::Held, &[one(4.0)]);
    run("samba", "mill", finished, &[]);
    run("laser-r-test", "mill", finished, &[one(5.0)]);
    let last = run("samba", "mill", finished, &[one(6.0)]);
    let limit = |unit, limit| ParameterTolerance { symbol: "EX0C".to_owned(), unit, limit };
    let tolerance = [limit(Unit::Mm, 0.1), limit(Unit::Um, 7.5)];
    let all = machine_history(&journal, "mill", &tolerance).unwrap();
    assert!(all.iter().all(|series| series.tolerance == Some(7.5)));
    let other = ParameterTolerance { symbol: "EY0C".to_owned(), ..limit(Unit::Um, 7.5) };
    assert!(machine_history(&journal, "mill", &[other]).unwrap().iter().all(|s| s.tolerance.is_none()));
    let told: Vec<String> = all
        .iter()
        .map(|series| {
            let values = series.values.iter().map(|value| format!(" {}:{}", value.run, value.value));
            format!("{} {}{}", series.method, series.symbol, values.collect::<String>())
        })
        .collect();
    let wanted = format!("samba EX0C {first}:2 {last}:6");
    assert_eq!(told, ["laser-r-test EX0C 5:5", wanted.as_str()]);
    // The newest runs of each method, limited in number.
    let mut newest = Vec::new();
    journal
        .visit_finished_run_results("mill", 1, EstimateSelection::Last, |measured| {
            newest.push((measured.method, measured.run))
        })
        .unwrap();
    let laser = RunId(last.0 - 1);
    assert_eq!(newest, [("laser-r-test".to_owned(), laser), ("samba".to_owned(), last)]);
}

/// The newest run was dated by a clock that was set back. It still counts as the newest, both in the limits and
/// in the chart.
#[test]
fn run_with_a_wrong_date_keeps_its_order_of_measurement() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    for number in 0..13 {
        let new = NewRun { machine_file_text: String::new(), plan: plan("samba", "mill") };
        let id = journal.begin_run(&new).wait().unwrap();
        let value = if number == 12 { 400.0 } else { 3.0 + 0.1 * f64::from(number % 3) };
        journal.add_estimate(id, &estimate_with_parameters(&[("EX0C", value, true)])).wait().unwrap();
        journal.set_state(id, RunState::Finished).wait().unwrap();
    }
    let raw = rusqlite::Connection::open(dir.path().join("journal.sqlite")).unwrap();
    raw.execute("UPDATE runs SET started = '1970-01-01T00:01:00Z' WHERE id = 13", []).unwrap();
    let series = machine_history(&journal, "mill", &[]).unwrap().remove(0);
    assert_eq!(series.trend.is_newest_value_outside_limits(), Some(true));
    assert!(series.trend.individuals.unwrap().control_limits()[1] < 10.0, "{:?}", series.trend.individuals);
    let svg = draw_series_chart(&series).unwrap();
    // Not 56 years wide: all runs were measured within this test, and the ticks are times of the day.
    let texts = svg.split('>').map(|part| part.split('<').next().unwrap_or_default());
    assert!(texts.into_iter().any(|text| text.split(':').count() == 3), "{svg}");
}

/// A signature belongs to one estimate: after another identification the run is not signed.
#[test]
fn signature_applies_to_the_signed_estimate_only() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let new = NewRun { machine_file_text: String::new(), plan: plan("samba", "mill") };
    let run = journal.begin_run(&new).wait().unwrap();
    let sign = |who: &str, hash: &str| {
        let signature =
            EstimateSignature { who: who.to_owned(), remark: "as ever".to_owned(), estimate_sha256: hash.to_owned() };
        journal.add_signature(run, &signature).wait().unwrap();
    };
    let by = || journal.runs().unwrap()[0].signed.clone();
    let told = || describe_signatures(&journal.load_run(run).unwrap());
    let first = journal.add_estimate(run, &estimate_with_parameters(&[("EX0C", 1.0, true)])).wait().unwrap();
    assert_eq!((by(), told()), (None, Vec::new()));
    sign("Ada", &first);
    sign("Lise", &first);
    assert_eq!(by().as_deref(), Some("Lise"));
    assert!(told().len() == 2 && told()[0].starts_with("by Ada (as ever) on 20"), "{:?}", told());
    journal.add_estimate(run, &estimate_with_parameters(&[("EX0C", 2.0, true)])).wait().unwrap();
    assert_eq!((by(), told()), (None, Vec::new()));
    let story = describe_events_with_times(&journal.load_run(run).unwrap());
    assert!(story[1].1.starts_with("signed (an earlier estimate) by Lise"), "{story:?}");
    let html = render_report(&journal, run).unwrap();
    assert!(html.contains("Not signed."));
    let raw = rusqlite::Connection::open(dir.path().join("journal.sqlite")).unwrap();
    for statement in ["DELETE FROM signatures", "UPDATE signatures SET who = 'Eve'"] {
        assert!(raw.execute(statement, []).is_err(), "{statement}");
    }
    let ghost = EstimateSignature { who: "Eve".to_owned(), remark: String::new(), estimate_sha256: first };
    assert!(journal.add_signature(RunId(7), &ghost).wait().is_err());
}

#[test]
fn runs_are_compared_in_common_parameters() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = |method: &str, config: &str, value: Option<f64>| -> RunId {
        let new = NewRun { machine_file_text: config.to_owned(), plan: plan(method, "mill") };
        let id = journal.begin_run(&new).wait().unwrap();
        if let Some(value) = value {
            let estimate = estimate_with_parameters(&[("EX0C", value, true), ("EY0C", 3.0, true)]);
            journal.add_estimate(id, &estimate).wait().unwrap();
        }
        id
    };
    let (one, other) = (run("samba", "a", Some(1.0)), run("samba", "b", Some(4.0)));
    let (laser, none) = (run("laser-r-test", "a", Some(1.0)), run("samba", "a", None));
    let found = compare_runs(&journal, one, other).unwrap();
    let changed: Vec<_> = found.differences.iter().map(|d| (d.by, d.significant)).collect();
    assert_eq!(changed, [(3.0, true), (0.0, false)]);
    assert_eq!(found.other_differences, ["the machine file was changed between the runs"]);
    let methods = compare_runs(&journal, one, laser).unwrap();
    assert_eq!(methods.differences.len(), 2);
    assert_eq!(methods.other_differences, ["the runs have different methods"]);
    let add = |estimate: &Estimate| -> RunId {
        let new = NewRun { machine_file_text: "a".to_owned(), plan: plan("samba", "mill") };
        let id = journal.begin_run(&new).wait().unwrap();
        journal.add_estimate(id, estimate).wait().unwrap();
        id
    };
    let nothing = add(&estimate_with_parameters(&[("EA0B", 1.0, true)]));
    assert!(matches!(compare_runs(&journal, one, nothing), Err(CompareError::NothingInCommon(..))));
    let mut mm = estimate_with_parameters(&[("EX0C", 1.0, true)]);
    mm.parameters[0].unit = Unit::Mm;
    let units = compare_runs(&journal, one, add(&mm)).unwrap_err();
    assert!(units.to_string().ends_with("have different units: EX0C"), "{units}");
    mm.parameters.push(estimate_with_parameters(&[("EY0C", 3.0, true)]).parameters.remove(0));
    let some = compare_runs(&journal, one, add(&mm)).unwrap();
    assert_eq!(some.differences.len(), 1);
    assert_eq!(some.other_differences, ["the two runs have different units for EX0C"]);
    assert!(matches!(compare_runs(&journal, one, none), Err(CompareError::NoEstimate(_))));
    assert!(matches!(compare_runs(&journal, one, RunId(9)), Err(CompareError::Store(_))));
}

/// A control that was switched off meanwhile reports 0 at any position of such an axis.
#[test]
fn axis_without_homing_switch_may_lose_its_zero_at_any_stop() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let lost = |homing: &str| {
        let axis = serde_json::json!({"min": -360.0, "max": 360.0, "rapid_per_min": 1.0,
            "acceleration_per_s2": 1.0, "homing": homing});
        let mut plan = plan("samba", "mill");
        plan.machine.axes.insert(machine::Axis::C, serde_json::from_value(axis).unwrap());
        let id = journal.begin_run(&NewRun { machine_file_text: String::new(), plan }).wait().unwrap();
        may_have_lost_position(&journal.load_run(id).unwrap())
    };
    assert_eq!([lost("none"), lost("switch")], [true, false]);
}
