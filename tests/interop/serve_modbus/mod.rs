//! `trued serve` with pymodbus as the client (`tests/peers/pymodbus/install`, or `TRUED_PYMODBUS`).

mod abuse;
mod modbus_client;
mod starts;
mod stops;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::pymodbus;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 50;
        stops::by_sigterm,
        starts::captures,
        stops::by_a_coil,
        starts::a_cycle,
        abuse::of_all_kinds,
    ]
    .and(trials![Pool::Waiting, 0;
        starts::refusals,
        starts::stale,
        abuse::left_behind,
        abuse::strangers,
        stops::by_a_fault,
        stops::position_lost,
        stops::elsewhere,
        stops::at_once,
    ])
    .requires(pymodbus::missing)
}
