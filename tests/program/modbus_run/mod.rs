//! Self-calibration through a window of Modbus registers, over TCP and over RTU on a pseudo-terminal, as lines and
//! by a resident program: the real run, with proof and journal, on the simulated control. The reference is the same
//! run over the grbl wire, whose protocol shares nothing with these: the same lines, or the same numbers, must give
//! the same readings.

mod measured_run;
mod seeded_fault_runs;

use crate::support::harness::{Pool, Trials, trials};
use measured_run::MachineUnderTest;
use trued::setup::{self, EarlierSessions, MachineFile, SimulatedMachine, SimulationPace};

/// Name and `[controller]` keys of each Modbus variant of the simulated control.
const CONTROLLER_KEYS: [(&str, &str); 4] = [
    ("Modbus TCP", "speaks = \"modbus\"\nwire = \"tcp\""),
    ("Modbus RTU", "speaks = \"modbus\"\nwire = \"pty\""),
    ("a resident program, TCP", "speaks = \"modbus-program\"\nwire = \"tcp\""),
    ("a resident program, RTU", "speaks = \"modbus-program\"\nwire = \"pty\""),
];

fn estimate_over_modbus_equals_that_over_grbl() {
    let grbl = MachineUnderTest::with_controller("").measure();
    let expected = serde_json::to_string(&grbl.estimate()).unwrap();
    assert!(grbl.readings_of_successful_run().len() > 30);
    std::thread::scope(|scope| {
        for (name, keys) in CONTROLLER_KEYS {
            let (grbl, expected) = (&grbl, &expected);
            scope.spawn(move || {
                let modbus = MachineUnderTest::with_controller(keys).measure();
                assert_eq!(modbus.readings_of_successful_run(), grbl.readings_of_successful_run(), "{name}");
                let found = serde_json::to_string(&modbus.estimate()).unwrap();
                assert_eq!(found, *expected, "{name}");
            });
        }
    });
}

fn reported_controller_keys_open_the_served_control() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    for (name, keys) in CONTROLLER_KEYS {
        runtime.block_on(async {
            let simulated = MachineFile::parse("machine.toml", measured_run::machine_with_controller(keys)).unwrap();
            let served = SimulatedMachine::new(&simulated).unwrap().serve_control(SimulationPace::Immediate).unwrap();
            let text =
                measured_run::machine_with_controller(&served.controller_toml()).replace("kind = \"simulated\"\n", "");
            let file = MachineFile::parse("machine.toml", text).unwrap();
            let devices =
                setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
            let said = devices.open_controller.prepare().await.unwrap().identity;
            assert_eq!(said.contains("resident program 1"), name.contains("resident"), "{said}");
        });
    }
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 30;
        estimate_over_modbus_equals_that_over_grbl,
    ]
    .with_trials(trials![Pool::Computing, 15;
        seeded_fault_runs::line_window_faults_repeat_no_chunk_nor_invent_readings_over_tcp,
        seeded_fault_runs::line_window_faults_repeat_no_chunk_nor_invent_readings_over_rtu,
        seeded_fault_runs::resident_program_faults_repeat_no_chunk_nor_invent_readings_over_tcp,
        seeded_fault_runs::resident_program_faults_repeat_no_chunk_nor_invent_readings_over_rtu,
    ])
    .with_trials(trials![Pool::Waiting, 0;
        reported_controller_keys_open_the_served_control,
    ])
}
