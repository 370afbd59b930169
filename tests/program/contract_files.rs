//! The file formats of the public contract: their keys, units and signs, key by key, for reading and writing. A
//! change here is a change of contract and needs a note in CHANGELOG.md.

use crate::support::harness::{Pool, Trials, trials};
use std::f64::consts::PI;

use machine::Axis;
use machine::record::artefact::{Artefact, Cylinder};
use machine::record::estimate::{Estimate, FunctionFigureKind, Unit, Verdict};
use machine::record::machine::AxisSense;
use machine::record::plan::{Plan, StepKind};
use machine::record::reading::ReadingFlag;
use serde_json::{Value, json};
use trued::report::readings_csv;

/// A hand-written plan with only the keys of the contract.
fn contract_plan_json() -> Value {
    json!({
        "trued_plan": 1,
        "method": "self-calibration",
        "settings": {"n": 8},
        "machine": {
            "name": "mill",
            "topology": "w-C-B-X-F-Z-Y-S-t",
            "axes": {
                "X": {"positive": "iso", "point_mm": [0.0, 0.0, 0.0],
                      "direction": [1.0, 0.0, 0.0], "min": -250.0, "max": 250.0},
                "C": {"positive": "reversed", "point_mm": [1.0, 2.0, 3.0],
                      "direction": [0.0, 0.0, 1.0], "min": -360.0, "max": 360.0},
            },
            "tool_mm": [0.1, 0.2, -120.5],
        },
        "probe": {"ball_radius_mm": 3.0},
        "keepout": [{"name": "vice", "min_mm": [1.0, 2.0, 3.0], "max_mm": [4.0, 5.0, 6.0]}],
        "artefact": {"kind": "cylinder", "centre_mm": [0.3, 0.1, 50.0], "axis": [0.0, 0.0, 1.0],
                     "radius_mm": 45.0},
        "steps": [{
            "id": 0, "stage": 0, "kind": "touch", "label": "1a/C045",
            "from": {"X": 60.0, "Y": 0.5, "Z": 62.0, "B": 0.0, "C": 45.0, "S": -90.0},
            "to": {"X": 46.0},
            "feed_mm_min": 30.0, "sensor": "probe", "normal": [1.0, 0.0, 0.0],
        }],
    })
}

fn contract_estimate_json() -> Value {
    json!({
        "trued_estimate": 1,
        "method": "self-calibration",
        "parameters": [{"symbol": "EX0C", "value": 49.9, "unit": "um", "u": 0.5, "U": 1.28,
                        "k": 2.57, "dof": 5.0, "identifiable": true}],
        "functions": [{"symbol": "EXC_total", "argument": "C", "argument_unit": "deg",
                       "x": [0.0, 45.0], "unit": "um", "y": [0.0, 1.5], "u": [0.1, 0.2]}],
        "covariance": {"symbols": ["EX0C"], "rows": [[0.25]]},
        "rank": 26, "unknowns": 26, "condition": 21.88,
        "gauge": ["the mean of W is zero"],
        "not_identifiable": ["the common scale of X and Y"],
        "residual_rms_um": 0.3, "degrees_of_freedom": 5, "chi2_per_dof": 1.1,
        "verdict": "undecided",
        "warnings": ["holds at Z = 62 mm only"],
        "priors": ["ba7816bf"],
    })
}

/// Asserts that every key of `given` is in `made` with the same value; `made` may have more keys.
fn assert_json_contains(made: &Value, given: &Value, at: &str) {
    match (made, given) {
        (Value::Object(made), Value::Object(given)) => {
            for (key, value) in given {
                let found = made.get(key).unwrap_or_else(|| panic!("{at}.{key} is missing"));
                assert_json_contains(found, value, &format!("{at}.{key}"));
            }
        }
        (Value::Array(made), Value::Array(given)) => {
            assert_eq!(made.len(), given.len(), "{at}");
            for (n, (made, given)) in made.iter().zip(given).enumerate() {
                assert_json_contains(made, given, &format!("{at}[{n}]"));
            }
        }
        _ => assert_eq!(made, given, "{at}"),
    }
}

fn json_keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<_> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

fn hand_written_plan_is_read() {
    let plan: Plan = serde_json::from_value(contract_plan_json()).unwrap();
    assert_eq!((plan.trued_plan, plan.method.as_str()), (1, "self-calibration"));
    assert_eq!(plan.settings["n"], 8);
    assert_eq!(plan.machine.topology, "w-C-B-X-F-Z-Y-S-t");
    assert_eq!(plan.machine.axes[&Axis::X].positive, AxisSense::Iso);
    let c = &plan.machine.axes[&Axis::C];
    assert_eq!((c.positive, c.point_mm, c.min), (AxisSense::Reversed, [1.0, 2.0, 3.0], -360.0));
    assert_eq!(plan.machine.tool_mm, [0.1, 0.2, -120.5]);
    assert_eq!(plan.probe.ball_radius_mm, 3.0);
    assert_eq!(plan.keepout[0].max_mm, [4.0, 5.0, 6.0]);
    let is_the_one = matches!(
        plan.artefact,
        Artefact::Cylinder(Cylinder { foot_mm: [0.3, 0.1, 50.0], axis: [0.0, 0.0, 1.0], radius_mm: 45.0, .. })
    );
    assert!(is_the_one, "{:?}", plan.artefact);
    let [step] = plan.steps.as_slice() else { panic!("{:?}", plan.steps) };
    assert_eq!((step.id, step.stage, step.kind), (0, 0, StepKind::Touch));
    assert_eq!((step.label.as_str(), step.first_sensor()), ("1a/C045", "probe"));
    assert_eq!((step.feed_mm_min, step.normal), (30.0, [1.0, 0.0, 0.0]));
    // Internal units: mm and rad.
    assert_eq!(step.from.get(Axis::Z), Some(62.0));
    assert!((step.from.get_or_zero(Axis::C) - PI / 4.0).abs() < 1e-15);
    assert!((step.from.get_or_zero(Axis::S) + PI / 2.0).abs() < 1e-15);
    assert_eq!((step.to.get(Axis::X), step.to.get(Axis::C)), (Some(46.0), None));
}

fn a_plan_is_written_with_the_keys_of_the_contract() {
    let typed: Plan = serde_json::from_value(contract_plan_json()).unwrap();
    let made = serde_json::to_value(&typed).unwrap();
    assert_json_contains(&made, &contract_plan_json(), "plan");
    assert_eq!(json_keys(&made), json_keys(&contract_plan_json()));
    assert_eq!(json_keys(&made["steps"][0]), json_keys(&contract_plan_json()["steps"][0]));
    for (kind, text) in [
        (StepKind::Index, "index"),
        (StepKind::Touch, "touch"),
        (StepKind::Scan, "scan"),
        (StepKind::Reference, "reference"),
        (StepKind::Prompt, "prompt"),
    ] {
        assert_eq!(serde_json::to_value(kind).unwrap(), text);
    }
}

fn hand_written_estimate_is_read() {
    let estimate: Estimate = serde_json::from_value(contract_estimate_json()).unwrap();
    let parameter = &estimate.parameters[0];
    assert_eq!((parameter.symbol.as_str(), parameter.unit), ("EX0C", Unit::Um));
    assert_eq!((parameter.value, parameter.u, parameter.expanded), (49.9, 0.5, 1.28));
    assert_eq!((parameter.k, parameter.dof, parameter.identifiable), (2.57, Some(5.0), true));
    let function = &estimate.functions[0];
    assert_eq!((function.argument.as_str(), function.argument_unit.as_str()), ("C", "deg"));
    assert_eq!((&function.x[..], &function.y[..]), (&[0.0, 45.0][..], &[0.0, 1.5][..]));
    assert_eq!((&function.u[..], function.figure), (&[0.1, 0.2][..], FunctionFigureKind::Curve));
    assert_eq!(estimate.covariance.rows, [[0.25]]);
    assert_eq!((estimate.rank, estimate.unknowns, estimate.condition), (26, 26, 21.88));
    assert_eq!((estimate.residual_rms_um, estimate.chi2_per_dof), (0.3, 1.1));
    assert_eq!((estimate.degrees_of_freedom, estimate.verdict), (5, Verdict::Undecided));
    assert_eq!(estimate.prior_hashes, ["ba7816bf"]);

    let mut endless = self::contract_estimate_json();
    endless["parameters"][0]["dof"] = Value::Null;
    let endless: Estimate = serde_json::from_value(endless).unwrap();
    assert_eq!(endless.parameters[0].dof, None);
}

fn an_estimate_is_written_with_the_keys_of_the_contract() {
    let typed: Estimate = serde_json::from_value(contract_estimate_json()).unwrap();
    let made = serde_json::to_value(&typed).unwrap();
    assert_json_contains(&made, &contract_estimate_json(), "estimate");
    assert_eq!(json_keys(&made), json_keys(&contract_estimate_json()));
    assert_eq!(json_keys(&made["parameters"][0]), json_keys(&contract_estimate_json()["parameters"][0]));
    assert_eq!(json_keys(&made["covariance"]), ["rows", "symbols"]);
    let text = |value: Value| value.as_str().unwrap().to_owned();
    let units = [Unit::Um, Unit::Urad, Unit::UmPerM, Unit::Mm];
    let units = units.map(|unit| text(serde_json::to_value(unit).unwrap()));
    assert_eq!(units, ["um", "urad", "um/m", "mm"]);
    let verdicts = [Verdict::Pass, Verdict::Fail, Verdict::Undecided, Verdict::UndecidedModel, Verdict::None];
    let verdicts = verdicts.map(|verdict| text(serde_json::to_value(verdict).unwrap()));
    assert_eq!(verdicts, ["pass", "fail", "undecided", "undecided (model)", "none"]);
}

/// A number that was written as JSON text is read as the identical number.
fn estimate_numbers_are_read_bit_for_bit() {
    let mut random = estimation::random::seeded_stream(3, &[]);
    for _ in 0..1000 {
        let value: f64 = rand::RngExt::random_range(&mut random, -1e3..1e3);
        let mut given = contract_estimate_json();
        given["parameters"][0]["value"] = value.into();
        let read: Estimate = serde_json::from_str(&given.to_string()).unwrap();
        assert_eq!(read.parameters[0].value.to_bits(), value.to_bits());
    }
}

fn hand_written_readings_are_read() {
    let file = "# trued-readings 1\n# mill, by hand\n\
        step,repeat,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,s_deg,value_mm,sensor,t_s,flag,temp_table_c\n\
        0,0,48.001,0.5,62,,0,45,-90,,probe,12.5,,20.25\n\
        1,2,1,2,3,,,180,,-0.125,laser,13,saturated,\n";
    let readings = readings_csv::read_readings(file.as_bytes()).unwrap();
    let [touch, sample] = readings.as_slice() else { panic!("{readings:?}") };
    assert_eq!((touch.step, touch.repeat, touch.value_mm), (0, 0, None));
    assert_eq!((touch.position.get(Axis::X), touch.position.get(Axis::A)), (Some(48.001), None));
    assert!((touch.position.get_or_zero(Axis::C) - PI / 4.0).abs() < 1e-15);
    assert!((touch.position.get_or_zero(Axis::S) + PI / 2.0).abs() < 1e-15);
    assert_eq!((touch.sensor.as_str(), touch.t_s, touch.flag), ("probe", 12.5, ReadingFlag::None));
    assert_eq!(touch.temperatures_c.get("table"), Some(20.25));
    assert_eq!((sample.repeat, sample.value_mm), (2, Some(-0.125)));
    assert_eq!((sample.flag, sample.temperatures_c.iter().count()), (ReadingFlag::Saturated, 0));

    let mut written = Vec::new();
    readings_csv::write_readings(&readings, &["mill, by hand".to_owned()], &mut written).unwrap();
    assert_eq!(String::from_utf8(written).unwrap(), file);
    let flags = ReadingFlag::ALL.map(ReadingFlag::as_str);
    assert_eq!(flags, ["", "range", "saturated", "stale", "gap", "excluded"]);
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        hand_written_plan_is_read,
        a_plan_is_written_with_the_keys_of_the_contract,
        hand_written_estimate_is_read,
        an_estimate_is_written_with_the_keys_of_the_contract,
        estimate_numbers_are_read_bit_for_bit,
        hand_written_readings_are_read,
    ]
}
