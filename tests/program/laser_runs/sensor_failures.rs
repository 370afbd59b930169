//! The sensor fails while the machine moves between points, or rests at one: the run stops, the machine is held,
//! and after the sensor has recovered an operator resumes the run.

use std::time::Duration;

use trued::setup::SimulationPace;

use super::laser_shop::{FIRST_REFERENCE_STEP, LaserShop, MIN_POINTS_DESIGN, SPHERE_SEARCH_STEP, estimate_of_output};
use super::tcp_sensor::SensorState;
use crate::support::grbl_control::GrblControl;
use crate::support::machine_shop::{MachineShop, stderr};

/// Step in which the sensor fails.
const FAILING_STEP: u32 = FIRST_REFERENCE_STEP + 1;

/// Moment of the failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FaultMoment {
    /// During the move to a point.
    Moving,
    /// At rest at a point.
    AtRest,
}

fn feed_move_count_of_failing_step(heard: &str) -> usize {
    heard.matches(&format!("N{FAILING_STEP} G53 G1")).count()
}

/// Asserts that all bytes after the hold are status requests or further holds.
fn assert_no_motion_after_hold(heard: &str, label: &str) {
    let (_, after) = heard.split_once('!').unwrap_or_else(|| panic!("{label}: no hold"));
    assert!(after.chars().all(|byte| "!?".contains(byte)), "{label}: sent after the hold: {after}");
}

fn check_sensor_failure_and_resume(state: SensorState, moment: FaultMoment, told: [&str; 2]) {
    let label = format!("{state:?}, {moment:?}");
    let shop = LaserShop::with_control(
        MIN_POINTS_DESIGN,
        GrblControl::start_at_pace(&MIN_POINTS_DESIGN.machine_file_text(), SimulationPace::RealTime),
    );
    let mut run = shop.start_run();
    // The path to the first point is one feed move, each further point one more.
    shop.wait_until_control_receives(
        &format!("N{FAILING_STEP} G53 G1"),
        MIN_POINTS_DESIGN.dwell_points_per_scan / 2,
        &mut run,
    );
    match moment {
        FaultMoment::Moving => shop.sender.set_state_in_next_move(state),
        // Some samples of the point have been received by then.
        FaultMoment::AtRest => shop
            .sender
            .set_state(SensorState::SilentAfterSamplesAtRest(MIN_POINTS_DESIGN.samples_per_dwell_point as u32 - 2)),
    }
    while !shop.sender.has_state(state) {
        assert!(run.try_wait().unwrap().is_none(), "{label}: it has ended");
        std::thread::sleep(Duration::from_millis(2));
    }
    let moves = feed_move_count_of_failing_step(&shop.bench.received_text());
    let ended = run.wait_with_output().unwrap();
    let stands = shop.bench.world.lock().unwrap().displayed_position();

    assert_eq!(ended.status.code(), Some(5), "{label}: {}", stderr(&ended));
    for words in told.into_iter().chain(["laser", " resume 1`"]) {
        assert!(stderr(&ended).contains(words), "{label}: no {words} in {}", stderr(&ended));
    }
    assert!(ended.stdout.is_empty(), "{label}: an estimate in spite of everything");
    let heard = shop.bench.received_text();
    // No move to another point has begun.
    assert_eq!(feed_move_count_of_failing_step(&heard), moves, "{label}: {heard}");
    assert_no_motion_after_hold(&heard, &label);
    assert_eq!(shop.run_state(), "held", "{label}");
    // No part of the scan is kept, but everything before it is.
    assert_eq!(
        shop.check_readings_and_return_steps(),
        (SPHERE_SEARCH_STEP..FAILING_STEP).collect::<Vec<_>>(),
        "{label}"
    );
    assert_eq!(shop.bench.world.lock().unwrap().displayed_position(), stands, "{label}: it has moved");

    shop.sender.set_state(SensorState::Measuring);
    // The operator resets the control.
    shop.bench.reset_and_home();
    let resumed = shop.resume();
    assert_eq!(resumed.status.code(), Some(0), "{label}: {}", stderr(&resumed));
    estimate_of_output(&resumed);
    // The repeatability of its means is not declared: the reference is measured twice to determine it.
    let steps: Vec<u32> = (SPHERE_SEARCH_STEP..FAILING_STEP)
        .chain([FIRST_REFERENCE_STEP; 2])
        .chain(FAILING_STEP..MIN_POINTS_DESIGN.step_count)
        .collect();
    assert_eq!(shop.check_readings_and_return_steps(), steps, "{label}");
    assert_eq!(shop.run_state(), "finished", "{label}");
}

pub fn failing_sensor_in_a_scan_holds_the_machine() {
    check_sensor_failures(3);
}

pub fn sensor_that_fails_in_five_ways_holds_the_machine() {
    check_sensor_failures(5);
}

/// The first `case_count` cases in parallel: the machine runs in real time. The first three differ the most: a flag of
/// the sensor, a lost link, and silence at rest.
fn check_sensor_failures(case_count: usize) {
    let silent = ["(stale)", "sends no more data: check its cable"];
    let cases = [
        (SensorState::OutOfRange, FaultMoment::Moving, ["(range)", "check that the artefact is at its position"]),
        (SensorState::Disconnected, FaultMoment::Moving, ["the link to", "check the sensor's power and cable"]),
        (SensorState::Silent, FaultMoment::AtRest, silent),
        (SensorState::Silent, FaultMoment::Moving, silent),
        (SensorState::Saturated, FaultMoment::Moving, ["(saturated)", "reduce its exposure"]),
    ];
    std::thread::scope(|scope| {
        for (state, moment, told) in &cases[..case_count] {
            scope.spawn(move || check_sensor_failure_and_resume(*state, *moment, *told));
        }
    });
}

/// The true machine: the sensor is 15 mm lower than stated, so the sphere comes within its range of 10 mm while it
/// is 25 mm away by the machine file.
fn machine_file_with_lowered_sensor() -> String {
    let (stated, lower) = ("zero_offset_um = [210.0, -340.0, 170.0]", "-15000.0]");
    let text = MIN_POINTS_DESIGN.machine_file_text();
    assert!(text.contains(stated));
    text.replacen(stated, &stated.replace("170.0]", lower), 1)
}

/// A simulated sensor without a wire is not monitored; it is read before the machine enters the region where it may
/// report a distance.
pub fn unexpected_distance_at_rest_holds_the_machine() {
    let shop = MachineShop::with_machine_file(&machine_file_with_lowered_sensor());
    let ended = shop.run_trued(&["run", "laser-r-test", "--machine", &shop.machine_path()]);
    let told = stderr(&ended);
    assert_eq!(ended.status.code(), Some(5), "{told}");
    for words in ["`laser` reports ", "no body of the machine file", "retract by hand"] {
        assert!(told.contains(words), "no {words} in {told}");
    }
    assert!(shop.exported_reading_steps().is_empty());
}

pub fn silent_sensor_in_the_first_move_holds_the_machine() {
    let shop = LaserShop::with_control(
        MIN_POINTS_DESIGN,
        GrblControl::start_at_pace(&MIN_POINTS_DESIGN.machine_file_text(), SimulationPace::RealTime),
    );
    let mut run = shop.start_run();
    shop.wait_until_control_receives(&format!("N{SPHERE_SEARCH_STEP} G53 G1"), 1, &mut run);
    shop.sender.set_state(SensorState::Silent);
    let ended = run.wait_with_output().unwrap();
    let told = stderr(&ended);
    assert!(ended.status.code() == Some(5) && told.contains("(stale)"), "{told}");
    assert_no_motion_after_hold(&shop.bench.received_text(), "silent");
    assert!(shop.exported_readings().is_empty());
}

/// Contact does not stop a motion: the tool in the spindle has not been confirmed.
pub fn a_real_control_is_not_sent_a_motion_before_a_person_has_confirmed_the_sensor() {
    let shop = LaserShop::with_control(MIN_POINTS_DESIGN, GrblControl::start(&MIN_POINTS_DESIGN.machine_file_text()));
    let refused = shop.run_trued(&["run", "laser-r-test", "--machine", &shop.machine_path()]);
    let told = stderr(&refused);
    assert_eq!(refused.status.code(), Some(1), "{told}");
    assert!(
        told.contains("without covers: `laser` in the spindle") && told.contains("no operator can answer"),
        "{told}"
    );
    assert!(!shop.bench.received_text().contains("G53"), "{}", shop.bench.received_text());
}
