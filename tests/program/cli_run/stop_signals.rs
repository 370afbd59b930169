//! A run that is ended early: by Ctrl-C, SIGTERM, kill -9.

use std::process::{Child, Command, Stdio};

use super::recorded_grbl::RecordedGrbl;
use super::{MachineShop, machine_toml_with_control, stderr};
use crate::support::machine_shop::with_quick_approach;

pub fn send_signal(process: &Child, name: &str) {
    let kill = format!("kill -{name} {}", process.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
}

fn quick_approach_machine_toml() -> String {
    with_quick_approach(&super::simulated_machine_toml())
}

/// A run over `control`, in the middle of its second touch: the first reading is acknowledged.
fn start_and_wait_for_touch(control: &mut RecordedGrbl) -> (MachineShop, Child) {
    let address = format!("kind = \"grbl\"\ntcp = \"{}\"", control.address);
    let shop = MachineShop::with_machine_file(&machine_toml_with_control(&quick_approach_machine_toml(), &address));
    let mut run = shop.self_calibration_command();
    let run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    control.wait_for_text("N2 G38.3 Y");
    (shop, run)
}

/// Checks that each sent step follows a durable reading; returns the number of readings.
fn stored_reading_count(shop: &MachineShop, sent: &[u8]) -> u32 {
    let steps = shop.exported_reading_steps();
    let count = steps.len() as u32;
    assert!(count > 0 && steps.iter().copied().eq(0..count), "{steps:?}");
    let sent = String::from_utf8_lossy(sent);
    assert!(!sent.contains(&format!("N{} ", count + 1)), "step {count} was sent, but is not kept");
    count
}

fn check_signal_holds_run(name: &str) {
    let mut control = RecordedGrbl::start(&quick_approach_machine_toml());
    let (shop, run) = start_and_wait_for_touch(&mut control);
    send_signal(&run, name);
    let ended = run.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(5), "{}", stderr(&ended));
    assert!(stderr(&ended).contains("error: the run was halted on request\n  → "), "{}", stderr(&ended));
    assert!(ended.stdout.is_empty(), "an estimate in spite of everything");

    let (bytes, status) = control.wait_for_disconnect();
    assert!(status.contains("<Hold:0"), "the machine says {status}");
    let hold = bytes.iter().position(|byte| *byte == b'!').expect("a feed hold");
    let after: Vec<u8> = bytes[hold..].iter().copied().filter(|b| !b"!?".contains(b)).collect();
    assert!(after.is_empty(), "sent after the hold: {}", String::from_utf8_lossy(&after));

    assert_eq!(shop.run_states(), ["held"]);
    let kept = stored_reading_count(&shop, &bytes);
    let shown = shop.run_trued(&["show", "1"]);
    assert_eq!(shown.status.code(), Some(0), "{}", stderr(&shown));
    assert!(String::from_utf8_lossy(&shown.stdout).contains(&format!("held, {kept} readings")));
}

pub fn sigint_holds_and_keeps_the_readings() {
    check_signal_holds_run("INT");
}

pub fn sigterm_holds_and_keeps_the_readings() {
    check_signal_holds_run("TERM");
}

pub fn a_killed_run_is_interrupted_and_its_readings_kept() {
    let mut control = RecordedGrbl::start(&quick_approach_machine_toml());
    let (shop, mut run) = start_and_wait_for_touch(&mut control);

    // While the process lives, no other process can use the machine.
    let second = shop.run_self_calibration();
    assert_eq!(second.status.code(), Some(1), "{}", stderr(&second));
    let holder = format!("in use by process {}", run.id());
    assert!(stderr(&second).contains(&holder), "{}", stderr(&second));
    assert_eq!(shop.run_states(), ["running"]);

    run.kill().unwrap();
    run.wait().unwrap();
    let (bytes, _) = control.wait_for_disconnect();
    // The next start on the same machine, whatever its result.
    std::fs::write(shop.path_text("machine.toml"), quick_approach_machine_toml()).unwrap();
    let next = shop.run_self_calibration();
    assert_eq!(next.status.code(), Some(0), "{}", stderr(&next));
    assert_eq!(shop.run_states(), ["interrupted", "finished"]);
    stored_reading_count(&shop, &bytes);
}

pub fn sigterm_stops_the_identification_and_keeps_readings() {
    use std::io::{BufRead as _, BufReader, Read as _};
    let endless = quick_approach_machine_toml().replace("trials = 1000\n", "trials = 2000000000\n");
    let shop = MachineShop::with_machine_file(&endless);
    let mut run = shop.self_calibration_command();
    let mut run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut told = BufReader::new(run.stderr.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("computing the estimate from 69 readings") {
        line.clear();
        assert_ne!(told.read_line(&mut line).unwrap(), 0, "ended before it identified");
    }
    send_signal(&run, "TERM");
    let mut rest = String::new();
    told.read_to_string(&mut rest).unwrap();
    assert_eq!(run.wait().unwrap().code(), Some(5), "{rest}");
    assert!(rest.contains(" identify self-calibration --run 1`"), "{rest}");
    assert_eq!(shop.exported_reading_steps().len(), 69);
}

pub fn a_run_continues_when_its_output_is_not_read() {
    let shop = MachineShop::with_machine_file(&quick_approach_machine_toml());
    let mut run = shop.self_calibration_command();
    let mut run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(run.stderr.take());
    assert_eq!(run.wait_with_output().unwrap().status.code(), Some(0));
    assert_eq!(shop.run_states(), ["finished"]);
}
