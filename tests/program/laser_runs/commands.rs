//! The commands `run`, `identify`, `plan` and `simulate` with the laser R-test: reproducible results, replay of a
//! capture, the touch probe in place of the laser.

use std::fs::OpenOptions;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, Stdio};

use machine::record::estimate::Estimate;

use super::laser_shop::{TRUE_ERRORS_UM_AND_URAD, assert_near_truth, parameter};

const METHOD: &str = "laser-r-test";
/// Few poses, so that a run is short.
const FEW_POSES_SETTINGS: &str = "\n[method.laser-r-test]\ntilt_deg = [-60.0, 60.0]\nturn_deg = [120.0, 240.0]\n\
                     monte_carlo_trials = 100\n";

/// A folder with a machine file of these settings, in which the program runs.
struct RunWorkspace(tempfile::TempDir);

impl RunWorkspace {
    /// `added_toml`: appended to the machine file.
    fn with_added_toml(added_toml: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let text = include_str!("../../../config/laser.toml").to_owned() + added_toml;
        std::fs::write(folder.path().join("laser.toml"), text).expect("written");
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn run_trued(&self, arguments: &[&str]) -> std::process::Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).output().expect("started")
    }

    fn successful_stdout(&self, arguments: &[&str]) -> Vec<u8> {
        let output = self.run_trued(arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
        output.stdout
    }
}

/// A run through the whole program: control, sensor, proof, journal.
pub fn run_is_reproducible_and_near_the_truth() {
    let desk = RunWorkspace::with_added_toml(FEW_POSES_SETTINGS);
    let (file, first) = (desk.path("laser.toml"), desk.path("first"));
    let run = |state| desk.successful_stdout(&["run", METHOD, "--json", "--machine", &file, "--state", state]);
    let said = run(&first);
    assert_eq!(said, run(&desk.path("second")));
    let estimate: Estimate = serde_json::from_slice(&said).expect("an estimate");
    assert!(estimate.warnings.is_empty(), "{:?}", estimate.warnings);
    assert_near_truth(&estimate, 4.0);
    // Identified from the readings alone: the measured axis positions count, not those of a new plan.
    desk.successful_stdout(&["export", "1", "--state", &first, "--to", &desk.path("")]);
    let readings = desk.path("run-1-readings.csv");
    let again = desk.successful_stdout(&["identify", METHOD, "--json", "--readings", &readings, "--machine", &file]);
    let again: Estimate = serde_json::from_slice(&again).expect("an estimate");
    for (symbol, _) in TRUE_ERRORS_UM_AND_URAD {
        let (one, other) = (parameter(&estimate, symbol), parameter(&again, symbol));
        assert!((one.value - other.value).abs() < 0.01 * one.u, "{} {}", one.value, other.value);
    }
}

/// A replay without control and sensor.
pub fn captured_run_replays_to_the_same_bytes() {
    let desk = RunWorkspace::with_added_toml(FEW_POSES_SETTINGS);
    let (file, state, capture) = (desk.path("laser.toml"), desk.path("state"), desk.path("capture"));
    let run = |how: &[&str]| {
        desk.successful_stdout(&[&["run", METHOD, "--json", "--machine", &file, "--state", &state], how].concat())
    };
    let measured = run(&["--capture", &capture]);
    // The machine file now describes another machine: the result must be that of the capture.
    let text = std::fs::read_to_string(&file).expect("read");
    std::fs::write(&file, text.replace("\nseed = 1\n", "\nseed = 2\n")).expect("written");
    assert!(run(&[]) != measured, "the test could not fail");
    assert!(run(&["--replay", &capture]) == measured, "a replay gives something else");
    // Change one sample.
    let text = std::fs::read_to_string(&capture).expect("read");
    let (before, rest) = text.rsplit_once(" - 0\\n").expect("a sample");
    let (before, value) = before.rsplit_once(' ').expect("its value");
    let off: f64 = value.parse::<f64>().expect("a number") + 1.0;
    std::fs::write(&capture, format!("{before} {off} - 0\\n{rest}")).expect("written");
    let replay = ["run", METHOD, "--json", "--machine", &file, "--state", &state, "--replay", &capture];
    let output = desk.run_trued(&replay);
    let said = String::from_utf8_lossy(&output.stderr);
    // By a millimetre: its pose must be measured again, which the capture does not contain.
    assert_eq!(output.status.code(), Some(1), "the samples are not those of the capture");
    assert!(said.contains("outliers measured again: 1 step"), "{said}");
}

pub fn laser_r_test_by_touches_is_near_the_truth() {
    let desk = RunWorkspace::with_added_toml(&format!("{FEW_POSES_SETTINGS}by = \"probe\"\n"));
    let file = desk.path("laser.toml");
    let state = desk.path("state");
    let said = desk.successful_stdout(&["run", METHOD, "--json", "--machine", &file, "--state", &state]);
    let estimate: Estimate = serde_json::from_slice(&said).expect("an estimate");
    assert_near_truth(&estimate, 4.0);
}

/// There is no stylus that could be freed.
pub fn closed_probe_input_refuses_a_laser_run_without_advice_on_the_stylus() {
    let desk = RunWorkspace::with_added_toml("\n[[simulated.fault]]\nkind = \"probe-stuck\"\nat_line = 1\n");
    let (file, state) = (desk.path("laser.toml"), desk.path("state"));
    let output = desk.run_trued(&["run", METHOD, "--machine", &file, "--state", &state]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("the probe reads closed; but the sensor `laser` is mounted instead of the probe"), "{said}");
    assert!(said.contains("reads open while a sensor is in the spindle"), "{said}");
    assert!(!said.contains("free the stylus"), "{said}");
}

pub fn title_of_printed_program_states_samples_per_dwell() {
    let desk = RunWorkspace::with_added_toml(FEW_POSES_SETTINGS);
    for dialect in ["grbl-m19", "linuxcnc"] {
        let file = desk.path("laser.toml");
        let program = desk.successful_stdout(&["plan", METHOD, "--machine", &file, "--gcode", dialect]);
        let program = String::from_utf8(program).expect("text");
        let title = "(laser-r-test, at each G4 dwell trued takes 20 samples of laser)";
        assert!(program.lines().take(2).any(|line| line == title), "{:?}", program.get(..400));
    }
}

/// Report of the simulated control of `method` when the spindle is at a position in which the probe's stylus would
/// be pressed into the sphere's pole by 3 mm.
fn status_report_with_spindle_over_the_pole(desk: &RunWorkspace, method: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.args(["simulate", method, "--machine", &desk.path("laser.toml")]);
    let mut simulator = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().expect("started");
    let mut address = String::new();
    let mut said = BufReader::new(simulator.stdout.take().expect("its output"));
    said.read_line(&mut address).expect("where it is");
    let device = OpenOptions::new().read(true).write(true).open(address.trim());
    let mut control = device.expect("a pseudo-terminal");
    control.write_all(b"G21 G90\nG53 G0 X80.3 Y-0.2\nG53 G0 Z270\nG4 P0.01\n").expect("sent");
    let mut answers = BufReader::new(control.try_clone().expect("its answers")).lines();
    let mut answer = || answers.next().expect("an answer").expect("a line");
    let mut acknowledged = 0;
    while acknowledged < 4 {
        acknowledged += usize::from(answer() == "ok");
    }
    control.write_all(b"?").expect("sent");
    let report = std::iter::repeat_with(&mut answer).find(|line| line.starts_with('<'));
    simulator.kill().expect("killed");
    simulator.wait().expect("ended");
    report.expect("a report")
}

/// A rehearsal of a method with a sensor has no stylus that could touch anything.
pub fn simulate_removes_the_probe_for_a_method_with_a_spindle_sensor() {
    let desk = RunWorkspace::with_added_toml("");
    let (looks, touches) = (
        status_report_with_spindle_over_the_pole(&desk, METHOD),
        status_report_with_spindle_over_the_pole(&desk, "self-calibration"),
    );
    assert!(looks.starts_with("<Idle|MPos:80.300,-0.200,270.000") && !looks.contains("Pn:"), "{looks}");
    assert!(touches.contains("|Pn:P"), "{touches}");
}
