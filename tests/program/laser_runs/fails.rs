//! The sensor fails while the machine moves from point to point, or rests at one: the run stops, the
//! machine is held, and when the sensor is back a person lets the run go on.

use std::time::Duration;

use trued::setup::Pace;

use super::laser_shop::{LaserShop, REFERENCE, SEARCH, SHORT, estimate};
use super::sender::State;
use crate::support::grbl_control::GrblControl;
use crate::support::machine_shop::{MachineShop, stderr};

/// The step in which it fails.
const STEP: u32 = REFERENCE + 1;

/// When it fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Moment {
    /// The machine is on its way to a point.
    Way,
    /// It rests there.
    Rest,
}

fn feed_moves(heard: &str) -> usize {
    heard.matches(&format!("N{STEP} G53 G1")).count()
}

/// All that was sent after the hold asks for nothing but the control's state.
fn nothing_follows_the_hold(heard: &str, label: &str) {
    let (_, after) = heard.split_once('!').unwrap_or_else(|| panic!("{label}: no hold"));
    assert!(after.chars().all(|byte| "!?".contains(byte)), "{label}: sent after the hold: {after}");
}

fn fails(state: State, moment: Moment, told: [&str; 2]) {
    let label = format!("{state:?}, {moment:?}");
    let shop = LaserShop::over(SHORT, GrblControl::at(&SHORT.file(), Pace::Real));
    let mut run = shop.starts();
    // The way to the first point is one feed move, each point one more.
    shop.wait_for(&format!("N{STEP} G53 G1"), SHORT.points / 2, &mut run);
    match moment {
        Moment::Way => shop.sender.becomes_on_the_way(state),
        // Of those that are taken there some have come by then.
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
    // No way to another point was begun.
    assert_eq!(feed_moves(&heard), moves, "{label}: {heard}");
    nothing_follows_the_hold(&heard, &label);
    assert_eq!(shop.state(), "held", "{label}");
    // Not a part of the scan is kept, and all that went before is.
    assert_eq!(shop.all_is_true(), (SEARCH..STEP).collect::<Vec<_>>(), "{label}");
    assert_eq!(shop.bench.world.lock().unwrap().position(), stands, "{label}: it has moved");

    shop.sender.becomes(State::Well);
    // A person lets the control go on.
    shop.bench.reset();
    let resumed = shop.resume();
    assert_eq!(resumed.status.code(), Some(0), "{label}: {}", stderr(&resumed));
    estimate(&resumed);
    // Nobody has declared how its means repeat: the reference tells it, twice.
    let steps: Vec<u32> = (SEARCH..STEP).chain([REFERENCE; 2]).chain(STEP..SHORT.steps).collect();
    assert_eq!(shop.all_is_true(), steps, "{label}");
    assert_eq!(shop.state(), "finished", "{label}");
}

/// All at once: the machine takes its time, the computer hardly any.
pub fn a_sensor_that_fails_in_mid_scan_holds_the_machine() {
    let silent = ["(stale)", "has fallen silent: see to its cable"];
    let cases = [
        (State::Beyond, Moment::Way, ["(range)", "see that the sensor measures the artefact"]),
        (State::Silent, Moment::Way, silent),
        (State::Gone, Moment::Way, ["the link to", "see to the sensor's power and cable"]),
        (State::Saturated, Moment::Way, ["(saturated)", "lower the sensor's exposure"]),
        (State::Silent, Moment::Rest, silent),
    ];
    std::thread::scope(|scope| {
        for (state, moment, told) in &cases {
            scope.spawn(move || fails(*state, *moment, *told));
        }
    });
}

/// The machine's truth: the sensor sits 15 mm lower than stated, so the sphere comes within its range of 10 mm
/// while the machine file has it 25 mm away.
fn lower() -> String {
    let (stated, lower) = ("zero_offset_um = [210.0, -340.0, 170.0]", "-15000.0]");
    let text = SHORT.file();
    assert!(text.contains(stated));
    text.replacen(stated, &stated.replace("170.0]", lower), 1)
}

/// A simulated sensor without a wire is not watched; it is read before the machine goes where it may report a
/// distance.
pub fn an_early_distance_at_rest_holds_the_machine() {
    let shop = MachineShop::new(&lower());
    let ended = shop.trued(&["run", "laser-r-test", "--machine", &shop.machine()]);
    let told = stderr(&ended);
    assert_eq!(ended.status.code(), Some(5), "{told}");
    for words in ["`laser` reports ", "nothing that the machine file states", "retract by hand"] {
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

/// Contact stops nothing: nobody has confirmed what is in the spindle.
pub fn a_real_control_is_not_sent_a_motion_before_a_person_has_confirmed_the_sensor() {
    let shop = LaserShop::over(SHORT, GrblControl::start(&SHORT.file()));
    let refused = shop.trued(&["run", "laser-r-test", "--machine", &shop.machine()]);
    let told = stderr(&refused);
    assert_eq!(refused.status.code(), Some(1), "{told}");
    assert!(
        told.contains("`laser` in the spindle, uncovered") && told.contains("nobody is there"),
        "{told}"
    );
    assert!(!shop.bench.heard().contains("G53"), "{}", shop.bench.heard());
}
