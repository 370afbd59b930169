//! A run of `ball-plate` that is killed and stopped is resumed; the intervals of its error motions contain the true
//! values.

use serde_json::json;

use super::resume::{resume_command, resume_run, signal_run_and_take_sent_text, value_and_expanded_uncertainty};
use super::{
    MachineShop, assert_stderr_has, machine_toml_with_control, stderr, successful_json_output,
    toml_with_text_replacements,
};
use crate::support::grbl_control::GrblControl;

/// Error motions of `config/ball-plate.toml`, µm and µrad.
const TRUE_PARAMETERS: [(&str, f64); 5] =
    [("EXC_c2", 1.2), ("EYC_s3", 0.8), ("EZC_c1", -0.7), ("EAC_c2", 3.0), ("ECC_c1", 6.0)];

/// Amplitudes of harmonics: symbol, order, hypot of cosine and sine part.
const SPECTRUM_AMPLITUDES: [(&str, usize, f64); 3] =
    [("EXC_spectrum", 2, 1.264_911), ("EYC_spectrum", 3, 1.0), ("ECC_spectrum", 1, 6.708_204)];

/// One revolution, with fewer harmonics than the built-in machine.
fn single_revolution_machine_toml() -> String {
    let file = include_str!("../../../config/ball-plate.toml");
    let short = [
        ("both_directions = true", "both_directions = false\nmonte_carlo_trials = 100"),
        ("drift_um_per_h = 5.0", "drift_um_per_h = 0.5"),
    ];
    toml_with_text_replacements(file, &short)
}

/// Maximum of U, in µm or µrad: the step that is fitted at an interruption increases U only slightly.
const MAX_EXPANDED_UNCERTAINTY: f64 = 3.0;

pub fn killed_and_stopped_ball_plate_run_finds_true_values() {
    let bench = GrblControl::start(&single_revolution_machine_toml());
    let control = format!("kind = \"grbl\"\ntcp = \"{}\"", bench.address);
    let shop = MachineShop::with_machine_file(&machine_toml_with_control(&single_revolution_machine_toml(), &control));
    let run = shop.trued_command(&["run", "ball-plate", "--json", "--machine", &shop.machine_path()]);
    // The search has 30 touches, the reference 5, each stop 30.
    signal_run_and_take_sent_text(&bench, run, "N210 G38.3", "KILL");
    let (held, _) = signal_run_and_take_sent_text(&bench, resume_command(&shop), "N700 G38.3", "INT");
    assert_eq!(held.status.code(), Some(5), "{}", stderr(&held));
    assert_stderr_has(&held, &["the run was halted on request", " resume 1`"]);
    let estimate = successful_json_output(&resume_run(&shop));
    for (symbol, truth) in TRUE_PARAMETERS {
        let (value, expanded) = value_and_expanded_uncertainty(&estimate, symbol);
        println!("{symbol} {value:.3} ± {expanded:.3}, truly {truth}");
        // One of five seeds: the error is below three standard uncertainties.
        assert!((value - truth).abs() < 1.5 * expanded, "{symbol} {value} ± {expanded}, {truth}");
        assert!(expanded < MAX_EXPANDED_UNCERTAINTY, "{symbol} {value} ± {expanded}");
    }
    assert!(estimate["parameters"][0]["symbol"] == "EXC_range");
    for (symbol, order, truth) in SPECTRUM_AMPLITUDES {
        let functions = estimate["functions"].as_array().unwrap();
        let spectrum = functions.iter().find(|f| f["symbol"] == symbol).unwrap();
        assert_eq!((&spectrum["figure"], &spectrum["x"][order - 1]), (&json!("spectrum"), &json!(order as f64)));
        let [value, u] = ["y", "u"].map(|name| spectrum[name][order - 1].as_f64().unwrap());
        println!("{symbol} {order} {value:.3} ± {:.3}, truly {truth:.3}", 2.0 * u);
        assert!((value - truth).abs() < 3.0 * u && u > 0.0, "{symbol} {order} {value}, u {u}");
    }
    assert_eq!(shop.run_states(), ["finished"]);
}
