use super::history::history;
use crate::record::estimate::{Estimate, Parameter, Unit};
use crate::record::plan::Plan;
use crate::store::{Journal, NewRun, RunId, RunState};

fn plan(method: &str, machine: &str) -> Plan {
    serde_json::from_value(serde_json::json!({
        "trued_plan": 1, "method": method, "settings": {},
        "machine": {"name": machine, "topology": "w-C-B-X-F-Z-Y-S-t"},
        "probe": {"ball_radius_mm": 3.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0, 0, 50], "axis": [0, 0, 1], "radius_mm": 45},
    }))
    .unwrap()
}

fn estimate(values: &[(&str, f64, bool)]) -> Estimate {
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
        budget: Vec::new(),
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

/// Finished runs of this machine alone, of each its last estimate, and of that what was identified.
#[test]
fn a_history_is_what_finished_runs_last_said() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = |method: &str, machine: &str, state, estimates: &[Estimate]| -> RunId {
        let new = NewRun { config: String::new(), plan: plan(method, machine) };
        let id = journal.begin(&new).wait().unwrap();
        estimates.iter().for_each(|it| drop(journal.estimate(id, it).wait().unwrap()));
        journal.set_state(id, state).wait().unwrap();
        id
    };
    let finished = RunState::Finished;
    let one = |value| estimate(&[("EX0C", value, true), ("EZ0C", 9.0, false)]);
    let first = run("samba", "mill", finished, &[one(1.0), one(2.0)]);
    run("samba", "lathe", finished, &[one(3.0)]);
    run("samba", "mill", RunState::Held, &[one(4.0)]);
    run("samba", "mill", finished, &[]);
    run("laser-r-test", "mill", finished, &[one(5.0)]);
    let last = run("samba", "mill", finished, &[one(6.0)]);
    let all = history(&journal, "mill").unwrap();
    let told: Vec<String> = all
        .iter()
        .map(|series| {
            let values =
                series.values.iter().map(|value| format!(" {}:{}", value.run, value.value));
            format!("{} {}{}", series.method, series.symbol, values.collect::<String>())
        })
        .collect();
    let wanted = format!("samba EX0C {first}:2 {last}:6");
    assert_eq!(told, ["laser-r-test EX0C 5:5", wanted.as_str()]);
}
