//! Runs that may be resumed after a stop, and runs that must not.
//!
//! Steps of the built-in machine's cycle: 0–4 locate the part; 5–8 are the references R0 (0°, 90°,
//! 180°, Z); then Tests 1a (9–16), R1 (17–20), 1b (21–28), R2, 1c, R3, 2 (45–52), R4, 3 (57–64), R5.

use std::process::{Output, Stdio};

use serde_json::{Value, json};

use super::stop_signals::send_signal;
use super::{
    MachineShop, assert_stderr_has, machine_toml_with_control, simulated_machine_toml, stderr, successful_json_output,
    toml_with_text_replacements,
};
use crate::support::grbl_control::GrblControl;

/// True position of the C axis of the built-in machine, µm (drift changes it by less than 0.5 µm).
const TRUE_AXIS_POSITION_UM: [(&str, f64); 2] = [("EX0C", 50.0), ("EY0C", -30.0)];

/// Sends the signal to a run on `bench` when it sends `words` (several in order, separated by commas); returns its
/// output.
fn signal_run_and_take_output(
    bench: &GrblControl,
    command: std::process::Command,
    words: &str,
    signal: &str,
) -> Output {
    signal_run_and_take_sent_text(bench, command, words, signal).0
}

/// Like [`signal_run_and_take_output`]; also returns all text that the run has sent.
pub fn signal_run_and_take_sent_text(
    bench: &GrblControl,
    mut command: std::process::Command,
    words: &str,
    signal: &str,
) -> (Output, String) {
    bench.cut_session_at(&words.split(", ").collect::<Vec<_>>());
    let mut run = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    bench.wait_for_session_cut(&mut run);
    send_signal(&run, signal);
    let (ended, heard) = (run.wait_with_output().unwrap(), bench.received_text());
    // A held control stays held until a person resets it; a killed run held nothing.
    bench.reset_and_home();
    (ended, heard)
}

fn shop_with_control(bench: &GrblControl) -> MachineShop {
    MachineShop::with_machine_file(&machine_toml_with_control(
        &simulated_machine_toml(),
        &format!("kind = \"grbl\"\ntcp = \"{}\"", bench.address),
    ))
}

pub fn resume_command(shop: &MachineShop) -> std::process::Command {
    shop.trued_command(&["resume", "1", "--acknowledge", "Ada", "--json"])
}

pub fn resume_run(shop: &MachineShop) -> Output {
    resume_command(shop).output().unwrap()
}

/// Value and expanded uncertainty U of a parameter.
pub fn value_and_expanded_uncertainty(estimate: &Value, symbol: &str) -> (f64, f64) {
    let all = estimate["parameters"].as_array().unwrap();
    let one = all.iter().find(|parameter| parameter["symbol"] == symbol).unwrap();
    (one["value"].as_f64().unwrap(), one["U"].as_f64().unwrap())
}

/// Compares the resumed estimate with the truth and with an uninterrupted run on the same machine.
fn assert_near_truth(resumed: &Value) {
    let whole =
        successful_json_output(&MachineShop::with_machine_file(&simulated_machine_toml()).run_self_calibration());
    for (symbol, truth) in TRUE_AXIS_POSITION_UM {
        let (value, expanded) = value_and_expanded_uncertainty(resumed, symbol);
        let (uninterrupted, u_whole) = value_and_expanded_uncertainty(&whole, symbol);
        // One seed: the error is below three standard uncertainties.
        let most = 1.5 * expanded;
        assert!((value - truth).abs() < most, "{symbol}: {value} ± {expanded}");
        let apart = (value - uninterrupted).abs();
        assert!(apart < most, "{symbol}: {value} and {uninterrupted} ± {expanded}");
        // The fitted step increases U, but not by much.
        assert!(expanded >= u_whole && expanded < 1.6 * u_whole, "{symbol}: {expanded} {u_whole}");
    }
}

/// Error motions of C that the machine does not have: 8 µm along X in the eighth harmonic, which is at its maximum
/// at all eight positions.
fn eighth_harmonic_prior() -> Value {
    let degrees: Vec<f64> = (0..=72).map(|i| 5.0 * f64::from(i)).collect();
    let values: Vec<f64> = degrees.iter().map(|deg| 8.0 * (8.0 * deg).to_radians().cos()).collect();
    json!({
        "trued_estimate": 1, "method": "ball-plate", "parameters": [],
        "functions": [{
            "symbol": "EXC", "argument": "C", "argument_unit": "deg", "x": degrees, "unit": "um",
            "y": values, "u": vec![0.1; degrees.len()],
        }],
        "covariance": {"symbols": [], "rows": []}, "rank": 1, "unknowns": 1, "condition": 1.0,
        "gauge": [], "not_identifiable": [], "residual_rms_um": 0.0, "degrees_of_freedom": 0,
        "chi2_per_dof": 1.0, "verdict": "none", "warnings": [], "priors": [],
    })
}

/// Known error motions are stored with the run: they are used again by a resumed run and by a new identification.
pub fn resumed_run_keeps_its_priors() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    std::fs::write(shop.path("motions.json"), eighth_harmonic_prior().to_string()).unwrap();
    let mut run = shop.self_calibration_command();
    run.args(["--with", &shop.path_text("motions.json")]);
    signal_run_and_take_output(&bench, run, "N25 G38.3", "INT");
    let resumed = successful_json_output(&resume_run(&shop));
    let again = shop.run_json(&["identify", "self-calibration", "--run", "1", "--json"]);
    for estimate in [&resumed, &again] {
        assert_eq!(estimate["priors"].as_array().unwrap().len(), 1, "{estimate}");
        let (value, expanded) = value_and_expanded_uncertainty(estimate, "EX0C");
        println!("EX0C {value} ± {expanded}");
        assert!((value - (TRUE_AXIS_POSITION_UM[0].1 - 8.0)).abs() < 1.5 * expanded, "{value} ± {expanded}");
    }
}

/// Steps of the probing moves that were sent, in order, without duplicates.
pub fn touched_steps(sent_text: &str) -> Vec<u32> {
    let lines = sent_text.lines().filter(|line| line.contains("G38.3"));
    let steps = lines.filter_map(|line| line.split_once('N')?.1.split(' ').next()?.parse().ok());
    let mut steps: Vec<u32> = steps.collect();
    steps.dedup();
    steps
}

pub fn stopped_run_resumes_with_references_and_gives_the_same_estimate() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    let held = signal_run_and_take_output(&bench, shop.self_calibration_command(), "N25 G38.3", "INT");
    assert_eq!(held.status.code(), Some(5), "{}", stderr(&held));
    assert!(advised_resume_command(&stderr(&held)).ends_with("resume 1"), "{}", stderr(&held));
    assert_eq!(shop.run_states(), ["held"]);
    let listed = shop.run_trued(&["runs"]);
    assert_eq!(
        advised_resume_command(&String::from_utf8_lossy(&listed.stdout)),
        advised_resume_command(&stderr(&held))
    );

    // Without an acknowledgement no byte is sent to the machine.
    let refused = shop.trued_command(&["resume", "1"]).stdin(Stdio::null()).output().unwrap();
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["the run was halted on request", "nothing has moved", "--acknowledge"]);
    assert_eq!((bench.received_text(), shop.exported_reading_steps().len()), (String::new(), 25));

    let resumed = resume_run(&shop);
    assert_near_truth(&successful_json_output(&resumed));
    assert_eq!(shop.run_states(), ["finished"]);
    let rest: Vec<u32> = [17, 18, 19, 20].into_iter().chain(25..69).collect();
    let heard = bench.received_text();
    assert_eq!(touched_steps(&heard), rest);
    // The first approach after the stop is as slow as a search, the next is not; until three directions are
    // confirmed, all motion is slow.
    let lines = |step: &str| -> Vec<&str> {
        heard.lines().filter(|line| line.trim_start_matches('?').starts_with(step)).collect()
    };
    let down = |step: &str| lines(step).into_iter().rfind(|line| line.contains("G38.3 Z")).unwrap().to_owned();
    assert!(down("N17 ").ends_with("F300.000") && down("N18 ").ends_with("F3000.000"));
    let fast = |step: &str| lines(step).iter().any(|line| line.contains(" G0 "));
    assert!(!["N17 ", "N18 ", "N19 "].into_iter().any(fast) && fast("N26 "), "{heard}");
    assert_eq!(shop.exported_reading_steps().len(), 69 + 4);
    let told = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    for words in ["held: the run was halted on request", "confirmed by Ada", "resumed after an interruption at t = "] {
        assert!(told.contains(words), "{words} in {told}");
    }
    // The gap is stored with the plan: the estimate from the journal and from files is the same.
    let again = shop.run_trued(&["identify", "self-calibration", "--run", "1", "--json"]);
    assert_eq!(again.stdout, resumed.stdout, "{}", stderr(&again));
    let file = |name: &str| shop.path_text(&format!("export/run-1-{name}"));
    let (plan, readings, machine) = (file("plan.json"), file("readings.csv"), file("machine.toml"));
    let again = shop.run_trued(&[
        "identify",
        "self-calibration",
        "--json",
        "--plan",
        &plan,
        "--readings",
        &readings,
        "--machine",
        &machine,
    ]);
    assert_eq!(again.stdout, resumed.stdout, "{}", stderr(&again));

    let twice = resume_run(&shop);
    assert_eq!(twice.status.code(), Some(1), "{}", stderr(&twice));
    assert!(stderr(&twice).contains("cannot be resumed"), "{}", stderr(&twice));
}

/// Killed during a test, killed again while the references are measured, stopped during another test.
pub fn run_resumes_after_any_number_of_stops() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    signal_run_and_take_output(&bench, shop.self_calibration_command(), "N12 G38.3", "KILL");
    signal_run_and_take_output(&bench, resume_command(&shop), "N7 G38.3", "KILL");
    assert_eq!(shop.run_states(), ["interrupted"]);
    let held = signal_run_and_take_output(&bench, resume_command(&shop), "N47 G38.3", "TERM");
    assert_eq!(held.status.code(), Some(5), "{}", stderr(&held));
    let resumed = resume_run(&shop);
    assert_near_truth(&successful_json_output(&resumed));
    let warnings = successful_json_output(&resumed)["warnings"].to_string();
    assert_eq!(warnings.matches("a step was fitted").count(), 2, "{warnings}");
    assert!(warnings.contains("2 readings were not used"), "{warnings}");
    // 69 readings of the cycle, two references, then twice four.
    assert_eq!(shop.exported_reading_steps().len(), 69 + 2 + 4 + 4);
    let plan = std::fs::read_to_string(shop.path_text("export/run-1-plan.json")).unwrap();
    let plan: Value = serde_json::from_str(&plan).unwrap();
    assert_eq!(plan["gaps_s"].as_array().unwrap().len(), 3);
}

/// The control is still held: no motion, and the run remains resumable.
pub fn resume_on_held_control_is_refused_and_run_stays_resumable() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    bench.cut_session_at(&["N25 G38.3"]);
    let mut run = shop.self_calibration_command().stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    bench.wait_for_session_cut(&mut run);
    send_signal(&run, "INT");
    run.wait_with_output().unwrap();
    let refused = resume_run(&shop);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["not ready: Hold", "nothing has moved", " resume 1`"]);
    assert_eq!(touched_steps(&bench.received_text()), [] as [u32; 0]);
    assert_eq!(shop.run_states(), ["held"]);
    bench.reset_and_home();
    assert_eq!(resume_run(&shop).status.code(), Some(0));
}

/// The built-in machine with its part moved by 20 µm along Y.
fn machine_toml_with_pushed_part() -> String {
    toml_with_text_replacements(
        &simulated_machine_toml(),
        &[("centre_offset_mm = [0.8, -0.5]", "centre_offset_mm = [0.8, -0.48]")],
    )
}

pub fn moved_part_closes_the_run_and_keeps_its_readings() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    signal_run_and_take_output(&bench, shop.self_calibration_command(), "N62 G38.3", "INT");
    bench.replace_true_machine(&machine_toml_with_pushed_part());
    // Killed after the moved reference was read, before it was compared: it is compared all the same.
    signal_run_and_take_output(&bench, resume_command(&shop), "N56 G38.3", "KILL");
    let refused = resume_run(&shop);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["(limit 3.5 µm)", "closed", "`trued identify` with --run"]);
    let told = stderr(&refused);
    let (_, moved) = told.split_once("R4/P090 moved by +").expect("the reference is named");
    let moved: f64 = moved.split(' ').next().unwrap().parse().unwrap();
    assert!((moved - 20.0).abs() < 3.5, "{moved}");
    for innocent in ["P000 moved", "P180 moved", "/Z moved"] {
        assert!(!stderr(&refused).contains(innocent), "{}", stderr(&refused));
    }
    assert_eq!(shop.run_states(), ["closed"]);
    assert_eq!(touched_steps(&bench.received_text()), [53, 54, 55, 56]);
    assert_eq!(shop.exported_reading_steps().len(), 62 + 3 + 4);
    let again = resume_run(&shop);
    assert_eq!(again.status.code(), Some(1), "{}", stderr(&again));
    assert!(stderr(&again).contains("run 1 is closed"), "{}", stderr(&again));

    // Test 3 lacks three touches: the remaining readings are sufficient.
    let identified = shop.run_trued(&["identify", "self-calibration", "--run", "1", "--json"]);
    let known = successful_json_output(&identified);
    for (symbol, truth) in TRUE_AXIS_POSITION_UM {
        let (value, expanded) = value_and_expanded_uncertainty(&known, symbol);
        assert!((value - truth).abs() < expanded && expanded < 3.0, "{value} ± {expanded}");
    }
    let warnings = known["warnings"].to_string();
    assert!(warnings.contains("7 of 69 steps were not measured"), "{warnings}");
    assert_eq!(shop.run_states(), ["closed"]);
}

pub fn unknowns_without_enough_readings_are_named() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    signal_run_and_take_output(&bench, shop.self_calibration_command(), "N25 G38.3", "INT");
    let identified = shop.run_trued(&["identify", "self-calibration", "--run", "1"]);
    assert_eq!(identified.status.code(), Some(1), "{}", stderr(&identified));
    assert_stderr_has(&identified, &["only 17 of 30 unknowns", "EYC_total(90°)", "measure the missing steps"]);
    assert_eq!(shop.run_states(), ["held"]);
}

pub fn resume_closes_a_run_stopped_before_its_references() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    signal_run_and_take_output(&bench, shop.self_calibration_command(), "N3 G38.3", "INT");
    let refused = resume_run(&shop);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["not all references were measured before the stop", "start a new run"]);
    assert_eq!(shop.run_states(), ["closed"]);
    assert_eq!(touched_steps(&bench.received_text()), [] as [u32; 0]);
}

pub fn resume_with_another_machine_file_is_refused() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    signal_run_and_take_output(&bench, shop.self_calibration_command(), "N25 G38.3", "INT");
    std::fs::write(shop.path_text("other.toml"), machine_toml_with_pushed_part()).unwrap();
    let other = shop.path_text("other.toml");
    let refused = shop.run_trued(&["resume", "1", "--acknowledge", "Ada", "--machine", &other]);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("differs from the machine file"), "{}", stderr(&refused));
    assert!(bench.received_text().is_empty());
    assert_eq!(shop.run_states(), ["held"]);
}

/// The cycle is measured twice; the second pass is interrupted. The steps of the second pass are distinguished
/// from those of the first pass, and from the references after the stop.
pub fn run_resumes_in_a_later_pass() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    let mut run = shop.self_calibration_command();
    run.args(["--repeat", "2"]);
    signal_run_and_take_output(&bench, run, "N68 G38.3, N25 G38.3", "INT");
    let resumed = resume_run(&shop);
    let known = successful_json_output(&resumed);
    for (symbol, truth) in TRUE_AXIS_POSITION_UM {
        let (value, expanded) = value_and_expanded_uncertainty(&known, symbol);
        assert!((value - truth).abs() < expanded, "{symbol}: {value} ± {expanded}");
    }
    let rest: Vec<u32> = [17, 18, 19, 20].into_iter().chain(25..69).collect();
    assert_eq!(touched_steps(&bench.received_text()), rest);
    // Locating once, the cycle twice, then the references.
    assert_eq!(shop.exported_reading_steps().len(), 5 + 2 * 64 + 4);
}

/// X and Z were measured, Y was not: a part that moved along Y would not be detected.
pub fn resume_needs_all_references() {
    let bench = GrblControl::start(&simulated_machine_toml());
    let shop = shop_with_control(&bench);
    signal_run_and_take_output(&bench, shop.self_calibration_command(), "N6 G38.3", "INT");
    let refused = resume_run(&shop);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("not all references were measured"), "{}", stderr(&refused));
    assert_eq!(shop.run_states(), ["closed"]);
}

/// The repeatability is not declared, and only one reference was touched twice before the stop: the references are
/// touched twice after it, and a shift of 20 µm is still detected.
pub fn references_estimate_their_own_repeatability() {
    let unknown = |file: &str| toml_with_text_replacements(file, &[("repeatability_um = 0.5", "")]);
    for (after, state, readings) in
        [(simulated_machine_toml(), "finished", 69 + 8), (machine_toml_with_pushed_part(), "closed", 18 + 8)]
    {
        let bench = GrblControl::start(&simulated_machine_toml());
        let control = format!("kind = \"grbl\"\ntcp = \"{}\"", bench.address);
        let shop =
            MachineShop::with_machine_file(&machine_toml_with_control(&unknown(&simulated_machine_toml()), &control));
        signal_run_and_take_output(&bench, shop.self_calibration_command(), "N18 G38.3", "INT");
        bench.replace_true_machine(&after);
        let resumed = resume_run(&shop);
        assert_eq!(shop.run_states(), [state], "{}", stderr(&resumed));
        assert_eq!(shop.exported_reading_steps().len(), readings);
    }
}

/// The `resume` command that the message quotes.
fn advised_resume_command(told: &str) -> String {
    let mut quoted = told.split('`').skip(1).step_by(2);
    quoted.find(|quoted| quoted.contains("resume")).unwrap_or_else(|| panic!("{told}")).to_owned()
}

pub fn lost_position_requires_homing() {
    let fault = "\n[[simulated.fault]]\nkind = \"alarm\"\ncode = 1\nat_line = 150\n";
    let shop = MachineShop::with_machine_file(&(simulated_machine_toml() + fault));
    let ended = shop.run_self_calibration();
    assert_eq!(ended.status.code(), Some(5));
    let refused = resume_run(&shop);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["the position is lost", "the confirmation that all axes are homed is missing"]);
    assert_eq!(advised_resume_command(&stderr(&ended)), advised_resume_command(&stderr(&refused)));
    let listed = shop.run_trued(&["runs"]);
    assert_eq!(
        advised_resume_command(&String::from_utf8_lossy(&listed.stdout)),
        advised_resume_command(&stderr(&refused))
    );
    // Run the printed command in a shell.
    let command = advised_resume_command(&stderr(&refused)).replacen("trued", env!("CARGO_BIN_EXE_trued"), 1);
    let pasted = std::process::Command::new("sh").args(["-c", &command]).output().unwrap();
    let shown = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    assert!(shown.contains("confirmed by YOUR_NAME"), "{command}: {}", stderr(&pasted));
}
