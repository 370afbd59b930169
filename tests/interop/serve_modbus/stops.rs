//! A run that is stopped is held, and the service starts no other until an operator has acknowledged.

use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::thread::sleep;
use std::time::Duration;

use super::modbus_client::{ACCEPTED, ModbusClient, PROGRESS, REFUSAL, RUN, STATE};
use crate::support::machine_shop::{MODBUS, MachineShop};

/// The minimum number of touches of the method.
fn short() -> MachineShop {
    let shop = MachineShop::with_serve(MODBUS);
    shop.change("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    shop
}

/// Starts a run and waits until it is well advanced, on a machine in real time.
fn under_way(client: &mut ModbusClient) {
    client.enable();
    client.press(11);
    client.until(|status| status[STATE] == 2 && status[PROGRESS] >= 1);
}

pub fn by_a_coil() {
    let shop = short();
    let daemon = shop.serve("real");
    let mut client = ModbusClient::new(daemon.modbus_port());
    under_way(&mut client);
    assert_eq!(client.ask("coil 3 1"), "ok");
    client.until(|status| status[STATE] == 3);
    assert_eq!(shop.states(), ["held"]);
    assert_eq!(client.ask("coil 3 0"), "ok");
    assert_eq!(client.refused(11), 2);
    // The machine is released for the operator, and `resume` does not report that a daemon uses it.
    let resumed = shop.trued(&["resume", "1"]);
    let told = String::from_utf8_lossy(&resumed.stderr).into_owned();
    assert!(told.contains("the name of the operator who has checked the machine is missing"), "{told}");
    client.press(4);
    client.until(|status| status[STATE] == 1);
    under_way(&mut client);
    let status = client.status();
    assert_eq!((status[RUN], status[ACCEPTED]), (2, 2), "{status:?}");
    drop(client);
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.states(), ["held", "held"]);
}

pub fn by_sigterm() {
    let shop = short();
    let daemon = shop.serve("real");
    let mut client = ModbusClient::new(daemon.modbus_port());
    under_way(&mut client);
    drop(client);
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.states(), ["held"]);
    // The next run waits for an acknowledgement.
    let daemon = shop.serve("fast");
    let mut client = ModbusClient::new(daemon.modbus_port());
    client.enable();
    assert_eq!(client.status()[STATE], 3);
    assert_eq!(client.refused(11), 2);
    client.press(4);
    client.until(|status| status[STATE] == 1);
    drop(client);
    assert_eq!(daemon.terminate(), 0);
    // An acknowledgement remains valid; a kill needs a new one.
    let mut daemon = shop.serve("real");
    let mut client = ModbusClient::new(daemon.modbus_port());
    assert_eq!(client.status()[STATE], 1);
    under_way(&mut client);
    daemon.kill();
    let next = shop.serve("fast");
    let mut client = ModbusClient::new(next.modbus_port());
    assert_eq!((client.status()[STATE], client.status()[REFUSAL]), (3, 0));
}

/// A machine with this fault at the simulated control.
fn faulty(fault: &str) -> MachineShop {
    let shop = short();
    shop.change("[serve]", &format!("[[simulated.fault]]\n{fault}\n[serve]"));
    shop
}

/// Refused before any motion: there is no unfinished run, but an operator must acknowledge.
pub fn by_a_fault() {
    let shop = faulty("kind = \"probe-stuck\"");
    let daemon = shop.serve("fast");
    let mut client = ModbusClient::new(daemon.modbus_port());
    client.enable();
    client.press(11);
    client.until(|status| status[STATE] == 4);
    assert_eq!(shop.states(), ["failed"]);
    assert_eq!(client.refused(11), 3);
    client.press(4);
    client.until(|status| status[STATE] == 1);
    assert!(daemon.log().contains("the probe reads closed"));
}

/// The control restarts during the run: a button cannot confirm that the axes were homed.
pub fn position_lost() {
    let shop = faulty("kind = \"reset\"\nafter_touch = 3");
    let daemon = shop.serve("fast");
    let mut client = ModbusClient::new(daemon.modbus_port());
    client.enable();
    client.press(11);
    client.until(|status| status[STATE] == 3);
    client.press(4);
    let status = client.until(|status| status[REFUSAL] == 13);
    assert_eq!(status.last().unwrap()[STATE], 3);
    assert_eq!(client.refused(11), 2);
}

/// While an operator runs the program directly, the button at the machine is refused.
pub fn elsewhere() {
    let shop = short();
    let daemon = shop.serve("real");
    let mut client = ModbusClient::new(daemon.modbus_port());
    under_way(&mut client);
    client.press(3);
    client.until(|status| status[STATE] == 3);
    let machine = shop.machine();
    let mut run = shop.command(&["run", "self-calibration", "--machine", &machine, "--speed", "real"]);
    let mut run = run.stderr(Stdio::piped()).spawn().unwrap();
    // The run prints its first line when it has locked the machine.
    let mut told = BufReader::new(run.stderr.take().unwrap());
    assert!(told.read_line(&mut String::new()).unwrap() > 0);
    client.press(4);
    let status = client.until(|status| status[REFUSAL] == 14);
    assert_eq!(status.last().unwrap()[STATE], 3);
    run.kill().unwrap();
    run.wait().unwrap();
}

/// A stop at any phase: opening, preparing, proving; and during the run.
pub fn at_once() {
    for ms in [Some(0), Some(30), None] {
        let shop = short();
        let daemon = shop.serve("real");
        let mut client = ModbusClient::new(daemon.modbus_port());
        client.enable();
        assert_eq!(client.ask("coil 11 1"), "ok");
        match ms {
            Some(ms) => sleep(Duration::from_millis(ms)),
            None => drop(client.until(|status| status[RUN] == 1)),
        }
        drop(client);
        let log = daemon.log.clone();
        let ended = (daemon.terminate(), shop.states());
        // Before the run has begun there is nothing to hold.
        let none = ms.is_some() && ended == (0, Vec::new());
        let held = ended == (5, vec!["held".to_owned()]);
        assert!(none || held, "after {ms:?} ms: {ended:?}: {}", log.lock().unwrap());
    }
}
