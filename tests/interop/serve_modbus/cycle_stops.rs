//! A run that is stopped is held, and the service starts no other until an operator has acknowledged.

use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::thread::sleep;
use std::time::Duration;

use super::modbus_client::{
    ACCEPTED_COUNT_REGISTER, PROGRESS_REGISTER, PymodbusClient, REFUSAL_REASON_REGISTER, RUN_NUMBER_REGISTER,
    STATE_REGISTER,
};
use crate::support::machine_shop::{MODBUS_SECTION, MachineShop};

/// The minimum number of touches of the method.
fn short_cycle_shop() -> MachineShop {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    shop.replace_in_machine_file("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    shop
}

/// Starts a run, and waits until its progress is at least 1 %, on a machine in real time.
fn start_and_wait_until_measuring(client: &mut PymodbusClient) {
    client.set_enabling_inputs();
    client.press_coil(11);
    client.poll_status_until(|status| status[STATE_REGISTER] == 2 && status[PROGRESS_REGISTER] >= 1);
}

pub fn coil_holds_a_cycle_until_it_is_acknowledged() {
    let shop = short_cycle_shop();
    let daemon = shop.start_daemon("real");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    start_and_wait_until_measuring(&mut client);
    assert_eq!(client.request("coil 3 1"), "ok");
    client.poll_status_until(|status| status[STATE_REGISTER] == 3);
    assert_eq!(shop.run_states(), ["held"]);
    assert_eq!(client.request("coil 3 0"), "ok");
    assert_eq!(client.press_refused_coil(11), 2);
    // The machine is released for the operator, and `resume` does not report that a daemon uses it.
    let resumed = shop.run_trued(&["resume", "1"]);
    let told = String::from_utf8_lossy(&resumed.stderr).into_owned();
    assert!(told.contains("the name of the operator who has checked the machine is missing"), "{told}");
    client.press_coil(4);
    client.poll_status_until(|status| status[STATE_REGISTER] == 1);
    start_and_wait_until_measuring(&mut client);
    let status = client.update_heartbeat_and_read_status();
    assert_eq!((status[RUN_NUMBER_REGISTER], status[ACCEPTED_COUNT_REGISTER]), (2, 2), "{status:?}");
    drop(client);
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.run_states(), ["held", "held"]);
}

pub fn sigterm_holds_a_cycle_until_it_is_acknowledged() {
    let shop = short_cycle_shop();
    let daemon = shop.start_daemon("real");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    start_and_wait_until_measuring(&mut client);
    drop(client);
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.run_states(), ["held"]);
    // The next run waits for an acknowledgement.
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    assert_eq!(client.update_heartbeat_and_read_status()[STATE_REGISTER], 3);
    assert_eq!(client.press_refused_coil(11), 2);
    client.press_coil(4);
    client.poll_status_until(|status| status[STATE_REGISTER] == 1);
    drop(client);
    assert_eq!(daemon.terminate(), 0);
    // An acknowledgement remains valid; a kill needs a new one.
    let mut daemon = shop.start_daemon("real");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    assert_eq!(client.update_heartbeat_and_read_status()[STATE_REGISTER], 1);
    start_and_wait_until_measuring(&mut client);
    daemon.kill();
    let next = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(next.modbus_port());
    assert_eq!(
        (
            client.update_heartbeat_and_read_status()[STATE_REGISTER],
            client.update_heartbeat_and_read_status()[REFUSAL_REASON_REGISTER]
        ),
        (3, 0)
    );
}

/// A machine with this fault at the simulated control.
fn shop_with_fault(fault: &str) -> MachineShop {
    let shop = short_cycle_shop();
    shop.replace_in_machine_file("[serve]", &format!("[[simulated.fault]]\n{fault}\n[serve]"));
    shop
}

/// Refused before any motion: there is no unfinished run, but an operator must acknowledge.
pub fn fault_before_motion_blocks_starts_until_acknowledged() {
    let shop = shop_with_fault("kind = \"probe-stuck\"");
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    client.press_coil(11);
    client.poll_status_until(|status| status[STATE_REGISTER] == 4);
    assert_eq!(shop.run_states(), ["failed"]);
    assert_eq!(client.press_refused_coil(11), 3);
    client.press_coil(4);
    client.poll_status_until(|status| status[STATE_REGISTER] == 1);
    assert!(daemon.log().contains("the probe reads closed"));
}

/// The control restarts during the run: a button cannot confirm that the axes were homed.
pub fn button_does_not_acknowledge_a_lost_position() {
    let shop = shop_with_fault("kind = \"reset\"\nafter_touch = 3");
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    client.press_coil(11);
    client.poll_status_until(|status| status[STATE_REGISTER] == 3);
    client.press_coil(4);
    let status = client.poll_status_until(|status| status[REFUSAL_REASON_REGISTER] == 13);
    assert_eq!(status.last().unwrap()[STATE_REGISTER], 3);
    assert_eq!(client.press_refused_coil(11), 2);
}

/// While an operator runs the program directly, the button at the machine is refused.
pub fn button_is_refused_during_a_run_started_elsewhere() {
    let shop = short_cycle_shop();
    let daemon = shop.start_daemon("real");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    start_and_wait_until_measuring(&mut client);
    client.press_coil(3);
    client.poll_status_until(|status| status[STATE_REGISTER] == 3);
    let machine = shop.machine_path();
    let mut run = shop.trued_command(&["run", "self-calibration", "--machine", &machine, "--speed", "real"]);
    let mut run = run.stderr(Stdio::piped()).spawn().unwrap();
    // The run prints its first line when it has locked the machine.
    let mut told = BufReader::new(run.stderr.take().unwrap());
    assert!(told.read_line(&mut String::new()).unwrap() > 0);
    client.press_coil(4);
    let status = client.poll_status_until(|status| status[REFUSAL_REASON_REGISTER] == 14);
    assert_eq!(status.last().unwrap()[STATE_REGISTER], 3);
    run.kill().unwrap();
    run.wait().unwrap();
}

/// A stop at any phase: opening, preparing, proving; and during the run.
pub fn sigterm_at_any_phase_of_a_start_leaves_no_run_or_a_held_run() {
    for ms in [Some(0), Some(30), None] {
        let shop = short_cycle_shop();
        let daemon = shop.start_daemon("real");
        let mut client = PymodbusClient::new(daemon.modbus_port());
        client.set_enabling_inputs();
        assert_eq!(client.request("coil 11 1"), "ok");
        match ms {
            Some(ms) => sleep(Duration::from_millis(ms)),
            None => drop(client.poll_status_until(|status| status[RUN_NUMBER_REGISTER] == 1)),
        }
        drop(client);
        let log = daemon.log.clone();
        let ended = (daemon.terminate(), shop.run_states());
        // Before the run has begun there is nothing to hold.
        let none = ms.is_some() && ended == (0, Vec::new());
        let held = ended == (5, vec!["held".to_owned()]);
        assert!(none || held, "after {ms:?} ms: {ended:?}: {}", log.lock().unwrap());
    }
}
