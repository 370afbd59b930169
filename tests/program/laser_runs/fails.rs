//! The sensor fails while the machine moves between points, or rests at one: the run stops, the machine is held,
//! and after the sensor has recovered an operator resumes the run.

use std::time::Duration;

use trued::setup::Pace;

use super::laser_shop::{LaserShop, REFERENCE, SEARCH, SHORT, estimate};
use super::sender::State;
use crate::support::grbl_control::GrblControl;
use crate::support::machine_shop::{MachineShop, stderr};

/// Step in which the sensor fails.
const STEP: u32 = REFERENCE + 1;

/// Moment of the failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Moment {
    /// During the move to a point.
    Way,
    /// At rest at a point.
    Rest,
}

fn feed_moves(heard: &str) -> usize {
    heard.matches(&format!("N{STEP} G53 G1")).count()
}

/// Asserts that all bytes after the hold are status requests.
fn nothing_follows_the_hold(heard: &str, label: &str) {
    let (_, after) = heard.split_once('!').unwrap_or_else(|| panic!("{label}: no hold"));
    assert!(after.chars().all(|byte| "!?".contains(byte)), "{label}: sent after the hold: {after}");
}

fn fails(state: State, moment: Moment, told: [&str; 2]) {
    let label = format!("{state:?}, {moment:?}");
    let shop = LaserShop::over(SHORT, GrblControl::at(&SHORT.file(), Pace::Real));
    let mut run = shop.starts();
    // The path to the first point is one feed move, each further point one more.
    shop.wait_for(&format!("N{STEP} G53 G1"), SHORT.points / 2, &mut run);
    match moment {
        Moment::Way => shop.sender.becomes_on_the_way(state),
        // Some samples of the point have been received by then.
        Moment::Rest => shop.sender.becomes(State::Resting(SHORT.samples as u32 - 2)),
    }
    while !shop.sender.is(state) {
        assert!(run.try_wait().unwrap().is_none(), "{label}: it has ended");
        std::thread::sleep(Duration::from_millis(2));
    }
    let moves = feed_moves(&shop.bench.heard());
    let ended = run.wait_with_output().unwrap();
    let stands = shop.bench.world.lock().unwrap().position();

    assert_eq!(ended.status.code(), Some(5), "{label}: {}", stderr(&ended));
    for words in told.into_iter().chain(["laser", " resume 1`"]) {
        assert!(stderr(&ended).contains(words), "{label}: no {words} in {}", stderr(&ended));
    }
    assert!(ended.stdout.is_empty(), "{label}: an estimate in spite of everything");
    let heard = shop.bench.heard();
    // No move to another point has begun.
    assert_eq!(feed_moves(&heard), moves, "{label}: {heard}");
    nothing_follows_the_hold(&heard, &label);
    assert_eq!(shop.state(), "held", "{label}");
    // No part of the scan is kept, but everything before it is.
    assert_eq!(shop.all_is_true(), (SEARCH..STEP).collect::<Vec<_>>(), "{label}");
    assert_eq!(shop.bench.world.lock().unwrap().position(), stands, "{label}: it has moved");

    shop.sender.becomes(State::Well);
    // The operator resets the control.
    shop.bench.reset();
    let resumed = shop.resume();
    assert_eq!(resumed.status.code(), Some(0), "{label}: {}", stderr(&resumed));
    estimate(&resumed);
    // The repeatability of its means is not declared: the reference is measured twice to determine it.
    let steps: Vec<u32> = (SEARCH..STEP).chain([REFERENCE; 2]).chain(STEP..SHORT.steps).collect();
    assert_eq!(shop.all_is_true(), steps, "{label}");
    assert_eq!(shop.state(), "finished", "{label}");
}

/// All cases in parallel: the machine runs in real time and needs little processor time.
pub fn a_sensor_that_fails_in_mid_scan_holds_the_machine() {
    let silent = ["(stale)", "sends no more data: check its cable"];
    let cases = [
        (State::Beyond, Moment::Way, ["(range)", "check that the artefact is at its position"]),
        (State::Silent, Moment::Way, silent),
        (State::Gone, Moment::Way, ["the link to", "check the sensor's power and cable"]),
        (State::Saturated, Moment::Way, ["(saturated)", "reduce its exposure"]),
        (State::Silent, Moment::Rest, silent),
    ];
    std::thread::scope(|scope| {
        for (state, moment, told) in &cases {
            scope.spawn(move || fails(*state, *moment, *told));
        }
    });
}

/// The true machine: the sensor is 15 mm lower than stated, so the sphere comes within its range of 10 mm while it
/// is 25 mm away by the machine file.
fn lower() -> String {
    let (stated, lower) = ("zero_offset_um = [210.0, -340.0, 170.0]", "-15000.0]");
    let text = SHORT.file();
    assert!(text.contains(stated));
    text.replacen(stated, &stated.replace("170.0]", lower), 1)
}

/// A simulated sensor without a wire is not monitored; it is read before the machine enters the region where it may
/// report a distance.
pub fn an_early_distance_at_rest_holds_the_machine() {
    let shop = MachineShop::new(&lower());
    let ended = shop.trued(&["run", "laser-r-test", "--machine", &shop.machine()]);
    let told = stderr(&ended);
    assert_eq!(ended.status.code(), Some(5), "{told}");
    for words in ["`laser` reports ", "no body of the machine file", "retract by hand"] {
        assert!(told.contains(words), "no {words} in {told}");
    }
    assert!(shop.exported_steps().is_empty());
}

pub fn a_sensor_that_falls_silent_on_its_first_way_holds_the_machine() {
    let shop = LaserShop::over(SHORT, GrblControl::at(&SHORT.file(), Pace::Real));
    let mut run = shop.starts();
    shop.wait_for(&format!("N{SEARCH} G53 G1"), 1, &mut run);
    shop.sender.becomes(State::Silent);
    let ended = run.wait_with_output().unwrap();
    let told = stderr(&ended);
    assert!(ended.status.code() == Some(5) && told.contains("(stale)"), "{told}");
    nothing_follows_the_hold(&shop.bench.heard(), "silent");
    assert!(shop.readings().is_empty());
}

/// Contact does not stop a motion: the tool in the spindle has not been confirmed.
pub fn a_real_control_is_not_sent_a_motion_before_a_person_has_confirmed_the_sensor() {
    let shop = LaserShop::over(SHORT, GrblControl::start(&SHORT.file()));
    let refused = shop.trued(&["run", "laser-r-test", "--machine", &shop.machine()]);
    let told = stderr(&refused);
    assert_eq!(refused.status.code(), Some(1), "{told}");
    assert!(
        told.contains("without covers: `laser` in the spindle") && told.contains("no operator can answer"),
        "{told}"
    );
    assert!(!shop.bench.heard().contains("G53"), "{}", shop.bench.heard());
}
