//! Self-calibration through a window of Modbus registers, over TCP and over RTU on a pseudo-terminal, as lines and
//! by a resident program: the real run, with proof and journal, on the simulated control. The reference is the same
//! run over the grbl wire, whose protocol shares nothing with these: the same lines, or the same numbers, must give
//! the same readings.

mod bench;
mod schedules;

use crate::support::harness::{Pool, Trials, trials};
use bench::ModbusBench;
use trued::setup::{self, EarlierSessions, MachineFile, SimulatedMachine, SimulationPace};

/// Name and `[controller]` keys of each Modbus variant of the simulated control.
const CONTROLLER_KEYS: [(&str, &str); 4] = [
    ("Modbus TCP", "speaks = \"modbus\"\nwire = \"tcp\""),
    ("Modbus RTU", "speaks = \"modbus\"\nwire = \"pty\""),
    ("a resident program, TCP", "speaks = \"modbus-program\"\nwire = \"tcp\""),
    ("a resident program, RTU", "speaks = \"modbus-program\"\nwire = \"pty\""),
];

fn the_estimate_over_modbus_is_that_over_grbl() {
    let grbl = ModbusBench::with_full_cycle("").measure();
    let expected = serde_json::to_string(&grbl.estimate()).unwrap();
    assert!(grbl.readings().len() > 30);
    std::thread::scope(|scope| {
        for (name, keys) in CONTROLLER_KEYS {
            let (grbl, expected) = (&grbl, &expected);
            scope.spawn(move || {
                let modbus = ModbusBench::with_full_cycle(keys).measure();
                assert_eq!(modbus.readings(), grbl.readings(), "{name}");
                let found = serde_json::to_string(&modbus.estimate()).unwrap();
                assert_eq!(found, *expected, "{name}");
            });
        }
    });
}

fn what_is_served_is_opened_by_the_keys_that_it_tells() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    for (name, keys) in CONTROLLER_KEYS {
        runtime.block_on(async {
            let simulated = MachineFile::parse("machine.toml", bench::machine_with_controller(keys)).unwrap();
            let served = SimulatedMachine::new(&simulated).unwrap().serve(SimulationPace::Fast).unwrap();
            let text = bench::machine_with_controller(&served.controller_toml()).replace("kind = \"simulated\"\n", "");
            let file = MachineFile::parse("machine.toml", text).unwrap();
            let devices = setup::open_devices(&file, SimulationPace::Fast, EarlierSessions::default()).await.unwrap();
            let said = devices.controller.prepare().await.unwrap().identity;
            assert_eq!(said.contains("resident program 1"), name.contains("resident"), "{said}");
        });
    }
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 30;
        the_estimate_over_modbus_is_that_over_grbl,
    ]
    .with(trials![Pool::Computing, 15;
        schedules::whatever_fails_no_line_is_doubled_no_reading_invented_and_nothing_moves_after_it,
        schedules::nor_over_rtu,
        schedules::whatever_fails_no_program_starts_twice_and_no_result_is_taken_twice,
        schedules::no_program_starts_twice_over_rtu,
    ])
    .with(trials![Pool::Waiting, 0;
        what_is_served_is_opened_by_the_keys_that_it_tells,
    ])
}
