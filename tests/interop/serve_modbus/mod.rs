//! `trued serve` with pymodbus as the client (`tests/peers/pymodbus/install`, or `TRUED_PYMODBUS`).

mod abuse;
mod modbus_client;
mod starts;
mod stops;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::pymodbus;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        starts::a_cycle,
        starts::captures,
        starts::refusals,
        starts::stale,
        abuse::of_all_kinds,
        abuse::left_behind,
        abuse::strangers,
        stops::by_a_coil,
        stops::by_a_fault,
        stops::position_lost,
        stops::elsewhere,
        stops::at_once,
        stops::by_sigterm,
    ]
    .requires(pymodbus::missing)
}
