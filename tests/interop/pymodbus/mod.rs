//! Tests against pymodbus (`tests/peers/pymodbus/install` puts it below the target directory; or `TRUED_PYMODBUS`
//! names a python that has it). Without it the trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1`
//! they fail.

mod fault_schedules;
mod late_replies;
mod line_window;
mod link_faults;
mod number_encoding;
mod sensor;
mod server;
mod thermometer;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::pymodbus;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 60;
        thermometer::readings_contain_the_temperature_over_tcp,
        thermometer::readings_contain_the_temperature_over_rtu,
        thermometer::readings_have_no_temperature_while_the_thermometer_is_lost,
        thermometer::silent_thermometer_changes_no_touch,
    ]
    .with_trials(trials![Pool::Waiting, 0;
        number_encoding::number_types_agree_with_pymodbus,
        late_replies::plain_client_accepts_a_late_reply,
        late_replies::own_client_rejects_a_late_reply_over_rtu,
        late_replies::own_client_rejects_a_late_reply_over_tcp,
        late_replies::late_replies_are_rejected_without_a_pause_over_rtu,
        late_replies::indistinguishable_late_reply_is_rejected,
        link_faults::each_fault_gives_the_expected_error_over_rtu,
        link_faults::each_fault_gives_the_expected_error_over_tcp,
        link_faults::coils_discretes_and_holding_registers_return_their_values,
        link_faults::hold_overtakes_pending_requests,
        link_faults::ended_server_is_reported,
        line_window::touches_over_the_line_window_equal_those_in_the_world,
        line_window::line_window_hold_is_as_documented,
        sensor::each_measurement_is_read_once_or_counted_missing_over_tcp,
        sensor::each_measurement_is_read_once_or_counted_missing_over_rtu,
        sensor::corrupted_replies_give_one_stale_sample_each,
        thermometer::thermometer_read_gives_the_value_or_its_error,
    ])
    // A share of the requests must meet its timeout.
    .with_trials(trials![Pool::Alone, 10;
        fault_schedules::no_stale_value_or_double_write_in_fault_schedules_over_rtu,
        fault_schedules::no_stale_value_or_double_write_in_fault_schedules_over_tcp,
        line_window::line_window_refusals_are_as_documented,
        line_window::line_window_heartbeat_is_as_documented,
    ])
    .requires_peer(pymodbus::missing_pymodbus_reason)
}
