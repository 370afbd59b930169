//! `trued predict`, and the points of a run in the workpiece frame.

use serde_json::json;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, built_in_machine_text, stderr};

/// C is 100 µm off along X, with U = 2 µm; measured over a part of the travel.
fn estimate_json_with_c_axis_offset() -> String {
    json!({
        "trued_estimate": 1, "method": "samba", "functions": [], "rank": 1, "unknowns": 1,
        "parameters": [{"symbol": "EX0C", "value": 100.0, "unit": "um", "u": 2.0, "U": 4.0, "k": 2.0,
            "dof": null, "identifiable": true}],
        "covariance": {"symbols": ["EX0C"], "rows": [[4.0]]}, "condition": 1.0, "gauge": [],
        "not_identifiable": [], "residual_rms_um": 0.0, "degrees_of_freedom": 0, "chi2_per_dof": 1.0,
        "verdict": "none", "warnings": [], "priors": [],
        "measured": {"X": [-200.0, 200.0], "Z": [300.0, 500.0], "C": [0.0, 270.0]},
    })
    .to_string()
}

/// At C = 180° a point of the table is 200 µm off from the work zero set at C = 0, computed by hand.
fn predicted_tip_error_equals_the_hand_calculation() {
    let shop = MachineShop::with_machine_file(&built_in_machine_text());
    let (file, poses) = (shop.path_text("est.json"), shop.path_text("poses.csv"));
    std::fs::write(&file, estimate_json_with_c_axis_offset()).unwrap();
    std::fs::write(&poses, "# poses\nz_mm,c_deg\n400,0\n 400, 180\n").unwrap();
    let output = shop.run_trued(&["predict", &file, "--at", &poses]);
    let (said, told) = (String::from_utf8(output.stdout.clone()).unwrap(), stderr(&output));
    assert_eq!(output.status.code(), Some(0), "{told}");
    let rows: Vec<&str> = said.lines().collect();
    assert!(rows[0].starts_with("z_mm,c_deg,ex_um,ey_um,ez_um,u_ex_um"), "{said}");
    assert!(rows[1].starts_with("400,0,0.000,0.000,0.000,0.000"), "{said}");
    let off: Vec<f64> = rows[2].split(',').map(|cell| cell.parse().unwrap()).collect();
    assert!((off[2].abs() - 200.0).abs() < 1e-3 && (off[5] - 4.0).abs() < 1e-3, "{said}");
    assert!(told.contains("largest (200.0 ±") && told.contains("at Z400.000 C180.000"), "{told}");
    let whole = shop.run_trued(&["predict", &file, "--corrected", "EX0C"]);
    let told = stderr(&whole);
    assert!(told.contains("largest (200.0 ±"), "{told}");
    // Twice its U remains.
    assert!(told.contains("after a correction of EX0C: largest below 8."), "{told}");
    let anew = shop.run_trued(&["predict", &file, "--at", &poses, "--without-tool-centre-control"]);
    assert!(stderr(&anew).contains("largest (0.0 ± 0.0) µm"), "{}", stderr(&anew));
}

fn invalid_predict_inputs_are_refused_with_their_cause() {
    let shop = MachineShop::with_machine_file(&built_in_machine_text());
    let (file, poses) = (shop.path_text("est.json"), shop.path_text("poses.csv"));
    std::fs::write(&file, estimate_json_with_c_axis_offset()).unwrap();
    let refused = |text: &str, more: &[&str], words: &str| {
        std::fs::write(&poses, text).unwrap();
        let output = shop.run_trued(&[&["predict", &file, "--at", &poses], more].concat());
        assert!(matches!(output.status.code(), Some(1 | 2)) && output.stdout.is_empty());
        assert!(stderr(&output).contains(words), "{}", stderr(&output));
    };
    refused("x_mm,z_mm\n0,400\n250,400\n", &[], "line 3: X 250.000 is outside -200.000 to 200.000");
    refused("x_mm\n0\n", &[], "line 2: Z 0.000 is outside 300.000 to 500.000");
    refused("x_mm,q\n0,0\n", &[], "the column `q` is not known");
    refused("x_mm\nnan\n", &[], "line 2: `nan` is not a position of X");
    refused("x_mm,y_mm\n1\n", &[], "line 2");
    refused("x_mm\n0\n", &["--zero", "X0 half"], "`half` is not an axis position");
    std::fs::write(&poses, "x_mm\n250\n").unwrap();
    let asked = shop.run_trued(&["predict", &file, "--at", &poses, "--extrapolate"]);
    assert_eq!(asked.status.code(), Some(0), "{}", stderr(&asked));
    std::fs::write(&file, estimate_json_with_c_axis_offset().replace("EX0C", "form")).unwrap();
    refused("x_mm\n0\n", &[], "has no errors of this machine's axes");
}

/// The touches of a round part, converted with the nominal machine.
fn a_run_is_exported_as_points_of_the_workpiece() {
    let shop = MachineShop::with_machine_file(&built_in_machine_text());
    assert_eq!(shop.run_self_calibration().status.code(), Some(0));
    let folder = shop.path_text("out");
    let exported = shop.run_trued(&["export", "1", "--to", &folder, "--frame", "workpiece"]);
    assert_eq!(exported.status.code(), Some(0), "{}", stderr(&exported));
    let points = std::fs::read_to_string(shop.path("out/run-1-points.csv")).unwrap();
    let readings = std::fs::read_to_string(shop.path("out/run-1-readings.csv")).unwrap();
    let rows = readings.lines().filter(|line| !line.starts_with('#')).count();
    assert_eq!(points.lines().count(), rows);
    assert!(points.starts_with("step,label,repeat,sensor,x_mm,y_mm,z_mm,u_x_mm,u_y_mm,u_z_mm\n"));
    let with = shop.run_trued(&["export", "1", "--to", &folder, "--with", "none.json"]);
    assert_eq!(with.status.code(), Some(2), "{}", stderr(&with));
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        predicted_tip_error_equals_the_hand_calculation,
        invalid_predict_inputs_are_refused_with_their_cause,
        a_run_is_exported_as_points_of_the_workpiece,
    ]
}
