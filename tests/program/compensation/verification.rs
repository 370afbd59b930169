//! Verification of a written compensation by stored runs. The tool centre of the control is computed as a plain rotation.

use std::path::Path;

use super::shop::{CompensationShop, store_run_with};
use crate::support::machine_shop::stderr;
use machine::record::event::RunEvent;
use machine::record::reading::{Reading, ReadingFlag};
use machine::record::tool_centre::ToolCentreReading;
use machine::{Axis, Position};
use serde_json::{Value, json};
use trued::compensation::describe_compensation_values;
use trued::setup::MachineFile;
use trued::store::{CompensationState, Journal, RunId};

/// Angles of C of the second run, degrees; the first run has no readings.
const ANGLES_DEG: [f64; 4] = [0.0, 50.0, 140.0, 260.0];
/// C of the control after the compensation, mm.
pub const WRITTEN_C_MM: [f64; 2] = [0.05, -0.03];
const TOOL_MM: [f64; 3] = [60.0, 20.0, 100.0];

/// A run with the error of C, µm, that has read tool centres of a control with C at `c_mm`.
pub fn store_second_run(shop: &CompensationShop, error_um: [f64; 2], c_mm: [f64; 2]) -> RunId {
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    let folder = shop.shop.state_folder();
    store_run_with(&folder, &file, "self-calibration", &[("EX0C", "um", error_um[0]), ("EY0C", "um", error_um[1])]);
    let journal = Journal::open(&folder).unwrap();
    let run = journal.list_runs(Default::default(), 1).unwrap()[0].id;
    for text in describe_compensation_values(&file, &[]) {
        journal.add_event(run, &RunEvent::OperatorMessage { text }).wait().unwrap();
    }
    for (step, angle_deg) in (1..).zip(ANGLES_DEG) {
        let position = Position::from_xyz(TOOL_MM.into()).with(Axis::B, 0.0).with(Axis::C, angle_deg.to_radians());
        journal.add_reading(run, &reading(step, position.clone())).wait().unwrap();
        let reading = ToolCentreReading { position, tool_centre_mm: tool_centre(c_mm, angle_deg) };
        journal.add_event(run, &RunEvent::ToolCentreRead { step, repeat: 0, reading }).wait().unwrap();
    }
    run
}

fn reading(step: u32, position: Position) -> Reading {
    let flag = ReadingFlag::None;
    let temperatures_c = Default::default();
    Reading { step, repeat: 0, position, value_mm: None, sensor: "probe".to_owned(), t_s: 1.0, flag, temperatures_c }
}

/// LinuxCNC turns the table right-handed about Z by C; the tool turns back in the workpiece.
fn tool_centre([c_x, c_y]: [f64; 2], angle_deg: f64) -> [f64; 3] {
    let [x, y, z] = TOOL_MM;
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    [c_x + cos * (x - c_x) + sin * (y - c_y), c_y - sin * (x - c_x) + cos * (y - c_y), z]
}

fn verify(shop: &CompensationShop, run: RunId) -> std::process::Output {
    shop.compensate(&["verify", &run.0.to_string(), "--who", "Ada"])
}

fn written_shop() -> CompensationShop {
    let shop = CompensationShop::new();
    assert!(shop.write(&shop.hash()).status.success());
    shop
}

pub fn second_run_verifies_a_compensation() {
    let shop = written_shop();
    let run = store_second_run(&shop, [50.4, -30.3], WRITTEN_C_MM);
    let json = shop.compensate(&["verify", &run.0.to_string(), "--who", "Ada", "--json"]);
    let result: Value = serde_json::from_slice(&json.stdout).unwrap_or_else(|_| panic!("{}", stderr(&json)));
    assert_eq!(json.status.code(), Some(0), "{result}");
    let deviations = result["deviations"].as_array().unwrap();
    let measured_um: Vec<f64> = deviations.iter().map(|own| own["measured_mm"].as_f64().unwrap() * 1e3).collect();
    assert!((measured_um[0] - 0.4).abs() < 1e-6 && (measured_um[1] + 0.3).abs() < 1e-6, "{result}");
    for own in result["tool_centres"].as_array().unwrap() {
        assert!(own["control_deviation_mm"].as_f64().unwrap() < 1e-9, "{own}");
    }
    // The control takes C to be at (50, -30) um; it is at (50.4, -30.3) um. After 140 degrees the tool is off by
    // 2 sin(70 degrees) times the distance of both.
    let largest = result["tool_centres"][2]["measured_mm"].as_array().unwrap().iter();
    let length = largest.map(|mm| mm.as_f64().unwrap().powi(2)).sum::<f64>().sqrt();
    assert!((length - 0.5e-3 * 2.0 * 70_f64.to_radians().sin()).abs() < 1e-8, "{length}: {result}");
    assert_eq!(shop.state(), Some(CompensationState::Verified));
    let status = String::from_utf8(shop.compensate(&["status"]).stdout).unwrap();
    assert!(status.contains(&format!("verified by Ada with run {run}")), "{status}");
}

/// The values are not restored without a person.
pub fn contradicting_run_leaves_the_values_to_a_person() {
    for (error_um, c_mm, expected) in [
        ([80.0, -30.3], WRITTEN_C_MM, "outside"),
        // The kinematics do not apply the values.
        ([50.4, -30.3], [0.0, 0.0], "did not apply the values as they are"),
    ] {
        let shop = written_shop();
        let output = verify(&shop, store_second_run(&shop, error_um, c_mm));
        let text = String::from_utf8(output.stdout.clone()).unwrap();
        assert!(output.status.code() == Some(3) && text.contains(expected), "{text}{}", stderr(&output));
        assert!(shop.is_corrected() && shop.state() == Some(CompensationState::NotConfirmed));
        let undone = shop.compensate(&["undo", "--who", "Bob"]);
        assert!(undone.status.success() && shop.is_as_before(), "{}", stderr(&undone));
    }
}

pub fn verification_by_another_state_of_the_machine_is_refused() {
    let shop = CompensationShop::new();
    shop.assert_refused(&verify(&shop, RunId(1)), "no compensation of `linuxcnc-sim5` is written");
    let before = store_second_run(&shop, [50.4, -30.3], WRITTEN_C_MM);
    assert!(shop.write(&shop.hash()).status.success());
    shop.assert_refused(&verify(&shop, RunId(1)), "run 1 cannot verify compensation 1: only run 2 or a later run can");
    shop.assert_refused(&verify(&shop, before), "does not say that the control held the values of compensation 1");
    // Its readings are at the same positions as those of the run of the compensation.
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    for (step, angle_deg) in (1..).zip(ANGLES_DEG) {
        let position = Position::new().with(Axis::B, 0.0).with(Axis::C, (angle_deg + 0.5).to_radians());
        journal.add_reading(RunId(1), &reading(step, position)).wait().unwrap();
    }
    drop(journal);
    let run = store_second_run(&shop, [50.4, -30.3], WRITTEN_C_MM);
    shop.assert_refused(&verify(&shop, run), "at only 0 rotary positions at which run 1 did not measure");
    shop.replace_pins("0.05 xyzbc-trt-kins.x-rot-point", "0.06 xyzbc-trt-kins.x-rot-point");
    shop.assert_refused(&verify(&shop, run), "x-rot-point of the control is 0.06 mm; compensation 1 wrote 0.05 mm");
    assert_eq!(shop.state(), Some(CompensationState::Written));
}

/// Adds an estimate to the run: the last one with changes.
fn change_estimate(shop: &CompensationShop, run: RunId, change: impl FnOnce(&mut Value)) {
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    let last = journal.load_run(run).unwrap().estimates.pop().unwrap().estimate;
    let mut value = serde_json::to_value(last).unwrap();
    change(&mut value);
    journal.add_estimate(run, &serde_json::from_value(value).unwrap()).wait().unwrap();
}

/// A second run with too large a U, or without a changed position, shows nothing. Its combination with the first run is not
/// independent of the first.
pub fn verification_without_evidence_is_refused() {
    let shop = written_shop();
    let run = store_second_run(&shop, [50.4, -30.3], WRITTEN_C_MM);
    change_estimate(&shop, run, |estimate| {
        for index in 0..2 {
            estimate["covariance"]["rows"][index][index] = json!(2500.0);
            (estimate["parameters"][index]["u"], estimate["parameters"][index]["U"]) = (json!(50.0), json!(100.0));
        }
    });
    shop.assert_refused(&verify(&shop, run), "cannot show whether the largest change of 50.0 µm is right");
    let run = store_second_run(&shop, [50.4, -30.3], WRITTEN_C_MM);
    change_estimate(&shop, run, |estimate| {
        estimate["parameters"].as_array_mut().unwrap().pop();
        estimate["covariance"] = json!({"symbols": ["EX0C"], "rows": [[0.25]]});
    });
    shop.assert_refused(&verify(&shop, run), "does not determine the position of C in Y");
    let run = store_second_run(&shop, [80.0, -30.3], WRITTEN_C_MM);
    change_estimate(&shop, run, |estimate| {
        estimate["parameters"][0]["value"] = json!(50.0);
        estimate["provenance"] = json!({"program": "", "machine": "", "plan_sha256": "", "readings_sha256": "",
            "probe_sha256": "", "artefact_sha256": "", "compensations_active": [], "duration_s": 1.0,
            "combined_runs": [1, run.0]});
    });
    assert_eq!(verify(&shop, run).status.code(), Some(3), "the estimate of the run alone counts");
}
