//! Baseline: the output of the program as stored in `tests/data/baseline/`, so that a change of its structure can
//! be compared with it. The tests use the built program, its files, HTTP and Modbus, but not the library.
//!
//! ```text
//! cargo test --test baseline                             compares
//! TRUED_WRITE_BASELINE=1 cargo test --test baseline      writes; a commit names each changed field and why
//! ```
//!
//! Text and structure are equal, integers are equal, other numbers are equal within 1e-9 relative (1e-12 absolute).
//! This includes Monte Carlo results, because they have seeds. `normalise.rs` lists the output that depends on wall
//! time. A `.digest` replaces output that is too long to be stored, see `digest.rs`.

mod capture;
mod compare;
mod daemon;
mod digest;
mod method_cases;
mod normalise;
mod plans;
mod runs;
mod sensors;
#[path = "../support"]
#[allow(dead_code, reason = "other tests send signals to the daemon")]
mod support {
    pub mod daemon_process;
    pub mod http;
}
mod wire_runs;
mod workspace;

use method_cases::METHOD_CASES;

/// The tests of one method.
macro_rules! method_tests {
    ($($method:ident = $case:expr),* $(,)?) => {$(
        mod $method {
            use super::*;

            #[test]
            fn nominal_plan_is_as_stored() {
                plans::check_nominal_plan(&$case);
            }

            #[test]
            fn gcode_programs_are_as_stored() {
                plans::check_gcode_programs(&$case);
            }

            #[test]
            fn plan_of_run_is_as_stored() {
                runs::check_run_plan(&$case);
            }

            #[test]
            fn readings_of_run_are_as_stored() {
                runs::check_run_readings(&$case);
            }

            #[test]
            fn estimate_of_run_is_as_stored() {
                runs::check_run_estimate(&$case);
            }

            #[test]
            fn capture_of_run_is_as_stored() {
                runs::check_run_capture(&$case);
            }

            #[test]
            fn report_of_run_is_as_stored() {
                runs::check_run_report(&$case);
            }

            #[test]
            fn short_run_is_as_stored() {
                runs::check_short_run(&$case);
            }

            #[test]
            #[ignore = "up to 30 s of CPU for the number of trials that JCGM 101, 7.9 decides"]
            fn estimate_with_default_trials_is_as_stored() {
                runs::check_estimate_with_default_trials(&$case);
            }
        }
    )*};
}

method_tests! {
    self_calibration = METHOD_CASES[0],
    laser_r_test = METHOD_CASES[1],
    samba = METHOD_CASES[2],
    latch_delay = METHOD_CASES[3],
}

/// Tests that call one function each.
macro_rules! tests {
    ($($module:ident::$function:ident),* $(,)?) => {$(
        #[test]
        fn $function() {
            $module::$function();
        }
    )*};
}

tests! {
    wire_runs::run_over_grbl_in_memory_is_as_stored,
    wire_runs::run_over_grbl_on_pty_is_as_stored,
    wire_runs::run_over_line_window_on_tcp_is_as_stored,
    wire_runs::run_over_line_window_on_pty_is_as_stored,
    wire_runs::run_over_resident_program_on_tcp_is_as_stored,
    wire_runs::run_over_resident_program_on_pty_is_as_stored,
    wire_runs::run_with_serial_sensor_in_memory_is_as_stored,
    wire_runs::run_with_frame_sensor_in_memory_is_as_stored,
    wire_runs::run_with_modbus_sensor_on_tcp_is_as_stored,
    wire_runs::linuxcnc_capture_replays_to_the_stored_estimate,
    sensors::serial_text_lines_are_read_as_stored,
    sensors::polled_text_lines_and_requests_are_as_stored,
    sensors::serial_byte_frames_are_read_as_stored,
    sensors::modbus_sensor_samples_and_requests_are_as_stored,
    sensors::readings_with_modbus_thermometer_are_as_stored,
    daemon::check_openapi_description,
    daemon::check_http_answers,
    daemon::check_modbus_registers,
}
