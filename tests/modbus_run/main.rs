//! Self-calibration through a window of Modbus registers, over TCP and over RTU on a pseudo-terminal:
//! the real run, with proof and journal, against the simulated control. The reference is the same run
//! over the grbl wire, whose protocol shares nothing with this one: what the control makes of the same
//! lines must come back the same.

mod bench;
mod schedules;

use bench::Bench;

/// `[controller]` of the built-in machine.
const CONTROLS: [(&str, &str); 2] = [
    ("Modbus TCP", "speaks = \"modbus\"\nwire = \"tcp\""),
    ("Modbus RTU", "speaks = \"modbus\"\nwire = \"pty\""),
];

#[test]
fn the_estimate_over_modbus_is_that_over_grbl() {
    let grbl = Bench::whole("").measure();
    let expected = serde_json::to_string(&grbl.estimate()).unwrap();
    assert!(grbl.readings().len() > 30);
    std::thread::scope(|scope| {
        for (name, keys) in CONTROLS {
            let (grbl, expected) = (&grbl, &expected);
            scope.spawn(move || {
                let modbus = Bench::whole(keys).measure();
                assert_eq!(modbus.readings(), grbl.readings(), "{name}");
                let found = serde_json::to_string(&modbus.estimate()).unwrap();
                assert_eq!(found, *expected, "{name}");
            });
        }
    });
}
