//! Tests against pymodbus (`tests/peers/pymodbus/install` puts it below the target directory; or `TRUED_PYMODBUS`
//! names a python that has it). Without it the trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1`
//! they fail.

mod faults;
mod hazard;
mod schedules;
mod sensor;
mod server;
mod thermometer;
mod window;
mod words;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::pymodbus;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 60;
        thermometer::thermometer_over_tcp,
        thermometer::thermometer_over_rtu,
        thermometer::thermometer_lost_during_a_run,
        thermometer::silent_thermometer_delays_no_touch,
    ]
    .with(trials![Pool::Waiting, 0;
        words::number_types_agree_with_pymodbus,
        hazard::plain_client_takes_a_late_reply,
        hazard::own_client_rejects_a_late_reply_over_rtu,
        hazard::own_client_rejects_a_late_reply_over_tcp,
        hazard::not_even_while_it_is_owed,
        hazard::indistinguishable_late_reply_is_rejected,
        faults::each_fault_over_rtu,
        faults::each_fault_over_tcp,
        faults::address_spaces_are_separate,
        faults::hold_overtakes_pending_requests,
        faults::ended_server_is_reported,
        window::line_window_executes_lines,
        window::line_window_hold,
        sensor::sensor_over_tcp,
        sensor::sensor_over_rtu,
        sensor::corrupted_replies_are_rejected,
        thermometer::check_reads_the_thermometer,
    ])
    // A share of the requests must meet its timeout.
    .with(trials![Pool::Alone, 10;
        schedules::schedules_over_rtu,
        schedules::schedules_over_tcp,
        window::line_window_refusals,
        window::line_window_heartbeat,
    ])
    .requires(pymodbus::missing_pymodbus)
}
