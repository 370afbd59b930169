//! Against pymodbus (`tests/peers/pymodbus/install` puts it below the target directory; or
//! `TRUED_PYMODBUS` names a python that has it). Without it the trials are skipped, with the reason;
//! with `TRUED_REQUIRE_PEERS=1` they fail.

mod faults;
mod hazard;
#[path = "../support/pymodbus.rs"]
mod pymodbus;
mod schedules;
mod sensor;
mod server;
mod thermometer;
#[path = "../support/waiting.rs"]
#[allow(dead_code, reason = "shared with trials that use the rest of it")]
mod waiting;
mod window;
mod words;

use libtest_mimic::{Completion, Failed, Trial};
use pymodbus::{MISSING, python};

fn trial(name: &str, run: fn() -> Result<(), Failed>) -> Trial {
    let own = name.to_owned();
    Trial::ignorable_test(name, move || match python() {
        Some(_) => waiting::watched(own, run).map(|()| Completion::Completed),
        None if std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1") => {
            Err(MISSING.into())
        }
        None => Ok(Completion::ignored_with(MISSING)),
    })
}

fn main() {
    let trials = vec![
        // The longest first.
        trial("pymodbus_fault_schedules_rtu", schedules::rtu),
        trial("pymodbus_fault_schedules_tcp", schedules::tcp),
        trial("pymodbus_word_orders", words::are_pymodbus_s),
        trial("pymodbus_late_reply_is_a_hazard_without_us", hazard::of_a_plain_client),
        trial("pymodbus_late_reply_rtu", hazard::not_of_ours_rtu),
        trial("pymodbus_late_reply_tcp", hazard::not_of_ours_tcp),
        trial("pymodbus_late_reply_that_is_still_to_come", hazard::not_even_while_it_is_owed),
        trial("pymodbus_late_reply_of_one_register", hazard::not_where_nothing_tells_replies_apart),
        trial("pymodbus_each_fault_rtu", faults::each_rtu),
        trial("pymodbus_each_fault_tcp", faults::each_tcp),
        trial("pymodbus_spaces", faults::spaces),
        trial("pymodbus_hold_overtakes", faults::a_hold_overtakes),
        trial("pymodbus_lost_server", faults::a_server_that_goes_and_comes_back),
        trial("pymodbus_plays_the_line_window", window::lines),
        trial("pymodbus_is_refused_what_the_window_refuses", window::refusals),
        trial("pymodbus_holds_through_the_window", window::hold),
        trial("pymodbus_whose_heart_stops_is_held", window::heartbeat),
        trial("pymodbus_is_a_sensor_tcp", sensor::tcp),
        trial("pymodbus_is_a_sensor_rtu", sensor::rtu),
        trial("pymodbus_sensor_whose_replies_are_spoilt", sensor::spoilt),
        trial("pymodbus_is_a_thermometer_tcp", thermometer::tcp),
        trial("pymodbus_is_a_thermometer_rtu", thermometer::rtu),
        trial("pymodbus_thermometer_that_goes_away", thermometer::away),
        trial("pymodbus_thermometer_that_never_answers", thermometer::none),
        trial("pymodbus_thermometer_as_check_finds_it", thermometer::checked),
    ];
    waiting::run(trials);
}
