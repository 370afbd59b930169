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
        thermometer::tcp,
        thermometer::rtu,
        thermometer::away,
        thermometer::none,
    ]
    .and(trials![Pool::Waiting, 0;
        words::are_pymodbus_s,
        hazard::of_a_plain_client,
        hazard::not_of_ours_rtu,
        hazard::not_of_ours_tcp,
        hazard::not_even_while_it_is_owed,
        hazard::not_where_nothing_tells_replies_apart,
        faults::each_rtu,
        faults::each_tcp,
        faults::spaces,
        faults::a_hold_overtakes,
        faults::a_server_that_goes_and_comes_back,
        window::lines,
        window::hold,
        sensor::tcp,
        sensor::rtu,
        sensor::spoilt,
        thermometer::checked,
    ])
    // A share of the requests must meet its timeout.
    .and(trials![Pool::Alone, 10;
        schedules::rtu,
        schedules::tcp,
        window::refusals,
        window::heartbeat,
    ])
    .requires(pymodbus::missing)
}
