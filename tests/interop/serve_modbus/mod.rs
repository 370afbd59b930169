//! `trued serve` with pymodbus as the client (`tests/peers/pymodbus/install`, or `TRUED_PYMODBUS`).

mod abusive_clients;
mod cycle_starts;
mod cycle_stops;
mod modbus_client;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::pymodbus;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 50;
        cycle_stops::sigterm_holds_a_cycle_until_it_is_acknowledged,
        cycle_starts::each_run_is_captured_in_a_replayable_file_of_its_own,
        cycle_stops::coil_holds_a_cycle_until_it_is_acknowledged,
        cycle_starts::coil_starts_a_cycle,
        abusive_clients::abusive_clients_do_not_change_the_result_of_a_cycle,
    ]
    .with_trials(trials![Pool::Waiting, 0;
        cycle_starts::refused_starts_give_their_reason_codes,
        cycle_starts::stale_heartbeat_refuses_a_start,
        abusive_clients::abandoned_connections_are_closed,
        abusive_clients::clients_from_other_addresses_are_refused,
        cycle_stops::fault_before_motion_blocks_starts_until_acknowledged,
        cycle_stops::button_does_not_acknowledge_a_lost_position,
        cycle_stops::button_is_refused_during_a_run_started_elsewhere,
        cycle_stops::sigterm_at_any_phase_of_a_start_leaves_no_run_or_a_held_run,
    ])
    .requires_peer(pymodbus::missing_pymodbus_reason)
}
