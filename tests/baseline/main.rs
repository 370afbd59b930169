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
mod machines;
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
mod wires;
mod workspace;

use machines::CASES;

/// The tests of one method.
macro_rules! method_tests {
    ($($method:ident = $case:expr),* $(,)?) => {$(
        mod $method {
            use super::*;

            #[test]
            fn plan() {
                plans::plan(&$case);
            }

            #[test]
            fn programs() {
                plans::programs(&$case);
            }

            #[test]
            fn run_plan() {
                runs::plan(&$case);
            }

            #[test]
            fn run_readings() {
                runs::readings(&$case);
            }

            #[test]
            fn run_estimate() {
                runs::estimate(&$case);
            }

            #[test]
            fn run_capture() {
                runs::capture(&$case);
            }

            #[test]
            fn run_report() {
                runs::report(&$case);
            }

            #[test]
            fn short_run() {
                runs::short(&$case);
            }

            #[test]
            #[ignore = "up to 30 s of CPU for the number of trials that JCGM 101, 7.9 decides"]
            fn default_estimate() {
                runs::default_estimate(&$case);
            }
        }
    )*};
}

method_tests! {
    self_calibration = CASES[0],
    laser_r_test = CASES[1],
    samba = CASES[2],
    latch_delay = CASES[3],
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
    wires::grbl_in_memory,
    wires::grbl_on_pty,
    wires::line_window_on_tcp,
    wires::line_window_on_pty,
    wires::resident_program_on_tcp,
    wires::resident_program_on_pty,
    wires::serial_sensor_in_memory,
    wires::frame_sensor_in_memory,
    wires::modbus_sensor_on_tcp,
    wires::replay_of_linuxcnc,
    sensors::lines_of_text,
    sensors::lines_of_text_on_request,
    sensors::frames_of_bytes,
    sensors::registers,
    sensors::thermometer_registers,
    daemon::http_description,
    daemon::http_answers,
    daemon::modbus_map,
}
