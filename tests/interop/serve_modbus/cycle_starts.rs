//! Tests that a coil starts a cycle, and that a start is refused with its reason.

use std::thread::sleep;
use std::time::Duration;

use serde_json::Value;

use super::modbus_client::{
    ACCEPTED_COUNT_REGISTER, PROGRESS_REGISTER, PymodbusClient, REFUSAL_REASON_REGISTER, RUN_NUMBER_REGISTER,
    STATE_REGISTER, VERDICT_REGISTER,
};
use crate::support::machine_shop::{MODBUS_SECTION, MachineShop};

/// Output of `trued show`.
fn stored_estimate(shop: &MachineShop, run: u16) -> Value {
    shop.run_json(&["show", &run.to_string(), "--json"])
}

/// Finds `parameters` anywhere in the value.
fn find_parameters(value: &Value) -> Option<&Vec<Value>> {
    match value {
        Value::Object(map) => match map.get("parameters") {
            Some(Value::Array(found)) => Some(found),
            _ => map.values().find_map(find_parameters),
        },
        Value::Array(list) => list.iter().find_map(find_parameters),
        _ => None,
    }
}

pub fn coil_starts_a_cycle() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    let before = client.update_heartbeat_and_read_status();
    assert_eq!(
        (before[STATE_REGISTER], before[VERDICT_REGISTER], before[RUN_NUMBER_REGISTER]),
        (1, 0, 0),
        "{before:?}"
    );
    assert_eq!(client.request("coil 11 1"), "ok");
    let started = client.update_heartbeat_and_read_status();
    assert_eq!((started[STATE_REGISTER], started[ACCEPTED_COUNT_REGISTER]), (2, 1), "{started:?}");
    // Released and pressed again while the run is active.
    client.press_coil(11);
    assert_eq!(client.press_refused_coil(11), 1);
    assert_eq!(client.request("coil 11 1"), "ok");
    let seen = client.poll_status_until(|status| status[STATE_REGISTER] != 2);
    let ended = seen.last().unwrap();
    assert_eq!(
        (ended[STATE_REGISTER], ended[VERDICT_REGISTER], ended[RUN_NUMBER_REGISTER], ended[PROGRESS_REGISTER]),
        (1, 1, 1, 100)
    );
    let progress: Vec<u16> = seen.iter().map(|status| status[PROGRESS_REGISTER]).collect();
    assert!(progress.is_sorted() && progress.iter().any(|p| (1..100).contains(p)), "{progress:?}");
    // The coil is still high.
    sleep(Duration::from_millis(300));
    assert_eq!(client.update_heartbeat_and_read_status()[ACCEPTED_COUNT_REGISTER], 1);
    assert_eq!(shop.run_states(), ["finished"]);
    check_parameter_registers(&mut client, &shop);
    // A second cycle.
    client.set_enabling_inputs();
    client.press_coil(11);
    client.poll_status_until(|status| status[STATE_REGISTER] == 1 && status[RUN_NUMBER_REGISTER] == 2);
    drop(client);
    assert_eq!(daemon.terminate(), 0);
    assert_eq!(shop.run_states(), ["finished", "finished"]);
}

/// Checks that the registers contain the values of the journal.
fn check_parameter_registers(client: &mut PymodbusClient, shop: &MachineShop) {
    let run = stored_estimate(shop, 1);
    let parameters = find_parameters(&run).expect("parameters");
    assert_eq!(usize::from(client.update_heartbeat_and_read_status()[15]), parameters.len().min(12));
    for (place, parameter) in parameters.iter().take(12).enumerate() {
        let record = client.request_registers(&format!("input {} 10", 100 + 10 * place));
        let bytes: Vec<u8> = record[..4].iter().flat_map(|word| word.to_be_bytes()).collect();
        let symbol = String::from_utf8(bytes).unwrap();
        let expected: String = parameter["symbol"].as_str().unwrap().chars().take(8).collect();
        assert_eq!(symbol.trim_end_matches('\0'), expected);
        let unit = ["um", "urad", "um/m", "mm"][usize::from(record[4]) - 1];
        assert_eq!(unit, parameter["unit"].as_str().unwrap());
        let number = |at: usize| f64::from((i32::from(record[at] as i16) << 16) | i32::from(record[at + 1]));
        for (at, key) in [(5, "value"), (7, "U")] {
            let exact = parameter[key].as_f64().unwrap() * 1000.0;
            assert!((number(at) - exact).abs() <= 0.5, "{symbol} {key}: {} {exact}", number(at));
        }
    }
}

pub fn refused_starts_give_their_reason_codes() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    shop.replace_in_machine_file("min_interval_s = 0.0", "min_interval_s = 3600.0");
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    assert_eq!(client.press_refused_coil(12), 4, "no cycle 2");
    for (coil, why) in [(0, 5), (1, 6), (2, 7)] {
        assert_eq!(client.request(&format!("coil {coil} 0")), "ok");
        assert_eq!(client.press_refused_coil(11), why);
        assert_eq!(client.request(&format!("coil {coil} 1")), "ok");
    }
    assert_eq!(client.request("coil 3 1"), "ok");
    assert_eq!(client.press_refused_coil(11), 10, "stop is held down");
    assert_eq!(client.request("coil 3 0"), "ok");
    assert_eq!(client.request("coils 11 1 1"), "ok");
    assert_eq!(client.update_heartbeat_and_read_status()[REFUSAL_REASON_REGISTER], 11, "two at once");
    assert_eq!(client.request("coils 11 0 0"), "ok");
    client.press_coil(4);
    assert_eq!(client.update_heartbeat_and_read_status()[REFUSAL_REASON_REGISTER], 15, "nothing to acknowledge");
    // No run has begun so far.
    assert_eq!(client.update_heartbeat_and_read_status()[ACCEPTED_COUNT_REGISTER], 0);
    client.press_coil(11);
    client.poll_status_until(|status| status[STATE_REGISTER] == 1 && status[RUN_NUMBER_REGISTER] == 1);
    assert_eq!(client.press_refused_coil(11), 9, "too soon");
    let log = daemon.log().clone();
    for words in ["the external start is not enabled", "a guard is open", "less than `min_interval_s` ago"] {
        assert!(log.contains(words), "{words} in {log}");
    }
}

pub fn stale_heartbeat_refuses_a_start() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    sleep(Duration::from_millis(1100));
    // The heartbeat with the press is the first one after a pause.
    assert_eq!(client.request("coil 11 1"), "ok");
    let status = client.request_registers("input 0 16");
    assert_eq!((status[ACCEPTED_COUNT_REGISTER], status[REFUSAL_REASON_REGISTER], status[10]), (0, 8, 0), "{status:?}");
    // The heartbeat is back; a coil that rose meanwhile starts nothing.
    client.poll_status_until(|status| status[10] == 0b1111);
    sleep(Duration::from_millis(100));
    assert_eq!(client.update_heartbeat_and_read_status()[ACCEPTED_COUNT_REGISTER], 0);
    // The heartbeat continues at two counts per second or more.
    let beat = client.update_heartbeat_and_read_status()[0];
    sleep(Duration::from_millis(1000));
    assert!(client.update_heartbeat_and_read_status()[0].wrapping_sub(beat) >= 2);
}

/// Each run is captured in a separate file, from which it can be replayed.
pub fn each_run_is_captured_in_a_replayable_file_of_its_own() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    let daemon = shop.start_daemon_with_arguments(&["--capture", &shop.path_text("talk.capture")]);
    let mut client = PymodbusClient::new(daemon.modbus_port());
    client.set_enabling_inputs();
    for run in 1..3 {
        client.press_coil(11);
        client.poll_status_until(|status| status[STATE_REGISTER] == 1 && status[RUN_NUMBER_REGISTER] == run);
    }
    drop(client);
    assert_eq!(daemon.terminate(), 0);
    assert!(!std::path::Path::new(&shop.path_text("talk-begun.capture")).exists());
    for run in ["1", "2"] {
        let capture = shop.path_text(&format!("talk-{run}.capture"));
        let method = "self-calibration";
        let replay = ["run", method, "--json", "--machine", &shop.machine_path(), "--replay", &capture];
        let (replayed, measured) = (shop.run_json(&replay), shop.run_json(&["show", run, "--json"]));
        assert_eq!(
            Some(&replayed["parameters"]),
            find_parameters(&measured).map(|list| Value::from(list.clone())).as_ref()
        );
    }
}
