//! Simulated faults: of the control, as `[[simulated.fault]]` declares them, and of a bad wire.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use simulator::faulty_wire::{FaultyWire, WireDirection, WireFault};

use super::{MachineShop, machine_toml_with_control, simulated_machine_toml, stderr};

fn shop_with_fault(fault: &str) -> MachineShop {
    MachineShop::with_machine_file(&format!("{}\n[[simulated.fault]]\n{fault}\n", simulated_machine_toml()))
}

pub fn a_hold_pressed_at_the_machine_ends_the_run_with_its_reason() {
    let shop = shop_with_fault("kind = \"hold\"\nat_line = 120\n");
    let run = shop.run_self_calibration();
    assert_eq!(run.status.code(), Some(5), "{}", stderr(&run));
    let told = "error: held at the machine: the control reports Hold:0\n  → the run sends nothing more";
    assert!(stderr(&run).contains(told), "{}", stderr(&run));
    assert_eq!(shop.run_states(), ["held"]);
    let kept = shop.exported_reading_steps();
    assert!(!kept.is_empty() && kept.iter().copied().eq(0..kept.len() as u32), "{kept:?}");
}

pub fn misspelt_fault_is_refused_with_its_line() {
    for (fault, known) in [("kind = \"hodl\"", "hold"), ("kind = \"hold\"\nline = 3", "at_line")] {
        let shop = shop_with_fault(fault);
        let refused = shop.run_self_calibration();
        assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
        let told = stderr(&refused);
        assert!(told.contains("simulated.fault") && told.contains(known), "{told}");
        assert!(told.contains("machine.toml:"), "{told}");
    }
}

/// A seed whose first fault is a cut in the middle of the run, after at least `min_line_index` lines.
fn seed_with_cut_after(min_line_index: u64) -> u64 {
    let first = |seed: u64, direction: WireDirection| {
        FaultyWire::with_few_faults(seed).schedule(direction).next().expect("it never ends")
    };
    let cuts = |seed: &u64| {
        let (to, back) = (first(*seed, WireDirection::ToDevice), first(*seed, WireDirection::FromDevice));
        to.fault == WireFault::Cut
            && (min_line_index..2 * min_line_index).contains(&to.line_index)
            && back.line_index > 20 * min_line_index
    };
    (0..).find(cuts).expect("one of them")
}

pub fn cut_wire_leaves_a_held_run_and_is_logged() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let seed = seed_with_cut_after(60).to_string();
    let mut simulator = Command::new(env!("CARGO_BIN_EXE_trued"))
        .args(["simulate", "--machine", &shop.path_text("machine.toml"), "--faults", &seed])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut path = String::new();
    BufReader::new(simulator.stdout.take().unwrap()).read_line(&mut path).unwrap();
    let control = format!("kind = \"grbl\"\nserial = \"{}\"", path.trim());
    let client = MachineShop::with_machine_file(&machine_toml_with_control(&simulated_machine_toml(), &control));
    let run = client.run_self_calibration();
    simulator.kill().unwrap();
    let told = String::from_utf8(simulator.wait_with_output().unwrap().stderr).unwrap();
    assert_eq!(run.status.code(), Some(5), "{}{told}", stderr(&run));
    assert!(stderr(&run).contains("is lost"), "{}", stderr(&run));
    assert_eq!(client.run_states(), ["held"]);
    assert!(!client.exported_reading_steps().is_empty());
    assert!(told.contains("ToDevice, line ") && told.contains(": Cut"), "{told}");
}
