//! `trued serve` with pymodbus as the client (`tests/peers/pymodbus/install`, or `TRUED_PYMODBUS`).

mod abuse;
mod modbus_client;
mod starts;
mod stops;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::pymodbus;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 50;
        stops::sigterm_stops_a_cycle,
        starts::started_run_is_captured,
        stops::coil_stops_a_cycle,
        starts::coil_starts_a_cycle,
        abuse::abuse_of_all_kinds_stops_no_cycle,
    ]
    .with(trials![Pool::Waiting, 0;
        starts::refused_starts,
        starts::stale_heartbeat_refuses_a_start,
        abuse::abandoned_connections_are_closed,
        abuse::other_addresses_are_refused,
        stops::fault_stops_a_cycle,
        stops::lost_position_is_reported,
        stops::button_is_refused_during_a_run_started_elsewhere,
        stops::stop_at_any_phase_of_a_start,
    ])
    .requires(pymodbus::missing_pymodbus)
}
