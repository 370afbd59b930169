//! `trued run multiprobe`: an operator at the terminal, mountings of the artefact, stops during and between
//! mountings.

use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Command, Output, Stdio};

use super::resume::{resume_command, value_and_expanded_uncertainty};
use super::stop_signals::send_signal;
use super::{MachineShop, stderr, successful_json_output, toml_with_text_replacements};
use crate::support::terminal_operator;

/// Error motions of `config/multiprobe.toml`, µm and µrad.
const TRUE_PARAMETERS: [(&str, f64); 5] =
    [("EXC_c2", 1.2), ("EXC_s2", -0.4), ("EYC_s3", 0.8), ("EZC_c1", -0.7), ("EBC_s3", 4.0)];

/// Four mountings, few stops.
fn small_multiprobe_machine_toml() -> String {
    let file = include_str!("../../../config/multiprobe.toml");
    let short = [
        ("indexes = 10", "indexes = 4\nmonte_carlo_trials = 100"),
        ("revolutions = 2", "revolutions = 1"),
        ("positions = 90", "positions = 30"),
        ("harmonics = 20", "harmonics = 6"),
        ("samples = 4", "samples = 1"),
        ("drift_um_per_h = 2.0", "drift_um_per_h = 0.1"),
    ];
    toml_with_text_replacements(file, &short)
}

/// Sends the signal to the run after it has printed each of `messages` in order.
fn signal_run_after_output(mut command: Command, messages: &[&str], signal: &str) -> Output {
    let command =
        terminal_operator::confirm_prompts_with_enter(&mut command).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut run = command.spawn().unwrap();
    let mut told = BufReader::new(run.stderr.take().unwrap());
    let mut heard = String::new();
    for word in messages {
        let before = heard.len();
        while !heard[before..].contains(word) {
            assert_ne!(told.read_line(&mut heard).unwrap(), 0, "ended before {word}: {heard}");
        }
    }
    send_signal(&run, signal);
    told.read_to_string(&mut heard).unwrap();
    let mut output = run.wait_with_output().unwrap();
    output.stderr = heard.into_bytes();
    output
}

pub fn killed_and_stopped_multiprobe_run_finds_true_values() {
    let shop = MachineShop::with_machine_file(&small_multiprobe_machine_toml());
    let run = ["run", "multiprobe", "--json", "--machine", &shop.machine_path()];
    drop(signal_run_after_output(shop.trued_command(&run), &["mounting 2 of 4", "collision check passed"], "KILL"));
    let resumed = signal_run_after_output(resume_command(&shop), &["mounting 3 of 4", "Turn the artefact"], "INT");
    assert_eq!(resumed.status.code(), Some(5), "{}", stderr(&resumed));
    let compared = ["the references agree", "remounted after the last reading"];
    assert!(compared.iter().any(|words| stderr(&resumed).contains(words)), "{}", stderr(&resumed));
    let mut last = resume_command(&shop);
    let last = terminal_operator::confirm_prompts_with_enter(&mut last).output().unwrap();
    let estimate = successful_json_output(&last);
    for (symbol, truth) in TRUE_PARAMETERS {
        let (value, expanded) = value_and_expanded_uncertainty(&estimate, symbol);
        println!("{symbol} {value:.3} ± {expanded:.3}, truly {truth}");
        // One of five seeds: the error is below three standard uncertainties.
        assert!((value - truth).abs() < 1.5 * expanded, "{symbol} {value} ± {expanded}, {truth}");
    }
    assert_eq!(shop.run_states(), ["finished"]);
}

pub fn off_centre_artefact_must_be_centred_first() {
    let far = toml_with_text_replacements(
        &small_multiprobe_machine_toml(),
        &[("centre_offset_mm = [0.008, -0.005]", "centre_offset_mm = [0.120, 0.050]")],
    );
    let shop = MachineShop::with_machine_file(&far);
    let run = ["run", "multiprobe", "--json", "--machine", &shop.machine_path()];
    let run = signal_run_after_output(shop.trued_command(&run), &["centring, once more", "Centre the artefact"], "INT");
    assert_eq!(run.status.code(), Some(5), "{}", stderr(&run));
    let told = stderr(&run);
    // The live values of the sensors are not written to a log.
    assert!(!told.contains("to go"), "{told}");
    // The correction is opposite to the artefact's offset, with the table as after whole revolutions.
    for words in ["section 1 by X -12", "µm, Y -4", "Limit 20 µm"] {
        assert!(told.contains(words), "{words}: {told}");
    }
}
