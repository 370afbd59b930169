//! User errors with a laser, as the program itself reports them: cause and remedy.

use std::io::Write as _;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use machine::Axis;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use trued::report::readings_csv;
use trued::setup::{self, MachineFile};

use crate::support::machine_shop::stderr;
use crate::support::plan_player;

const METHOD: &str = "laser-r-test";
const LASER_MACHINE: &str = include_str!("../../../config/laser.toml");
const SIMULATED_SENSOR_SECTION: &str = "[sensor.simulated]\nspeaks = \"can\"\nwire = \"memory\"\n";

/// The built-in machine file with each old text of `changes` replaced by the new one, and `settings` added.
#[track_caller]
fn laser_machine_with_text_replacements(changes: &[(&str, &str)], settings: &str) -> String {
    let change = |text: String, (old, new): &(&str, &str)| {
        assert!(text.contains(old), "{old}");
        text.replacen(old, new, 1)
    };
    let text = changes.iter().fold(LASER_MACHINE.to_owned(), change);
    format!("{text}\n[method.laser-r-test]\nmonte_carlo_trials = 100\n{settings}\n")
}

/// Runs the program in an empty folder with this machine file.
fn run_trued(folder: &Path, file: &str, arguments: &[&str]) -> Output {
    let machine = folder.join("laser.toml");
    std::fs::write(&machine, file).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.args(arguments).arg("--machine").arg(machine).stdin(Stdio::null());
    command.arg("--state").arg(folder.join("state"));
    command.output().unwrap()
}

#[track_caller]
fn assert_refused(file: &str, arguments: &[&str], messages: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let output = run_trued(folder.path(), file, arguments);
    assert_failed_with_messages(&output, messages);
}

#[track_caller]
fn assert_failed_with_messages(output: &Output, told: &[&str]) {
    let words = stderr(output);
    assert_eq!(output.status.code(), Some(1), "{words}");
    assert!(output.stdout.is_empty(), "a result in spite of everything");
    for words_told in told {
        assert!(words.contains(words_told), "no `{words_told}` in: {words}");
    }
}

/// `[sensor.can]` with this layout in place of its value and counter.
fn machine_with_frame_layout(layout: &str) -> String {
    let table = format!("[sensor.can]\ninterface = \"can0\"\nid = 0x181\norder = \"big\"\nlength = 6\n{layout}\n");
    laser_machine_with_text_replacements(&[(SIMULATED_SENSOR_SECTION, &table)], "")
}

pub fn invalid_frame_layout_is_refused_with_file_and_cause() {
    let value = "value = { byte = 2, width = 24, signed = true, scale_mm = 1e-5 }";
    let counter = "counter = { byte = 0, width = 16 }";
    let line = "laser.toml:";
    for (layout, told) in [
        (
            format!("{value}\ncounter = {{ byte = 1, width = 16 }}"),
            [line, "`value` and `counter` overlap at byte 2, bit 0", "the sensor's manual"],
        ),
        (
            format!("{}\n{counter}", value.replace("1e-5", "0.0")),
            [line, "all readings would be equal", "size of one count in mm"],
        ),
        (
            format!("{}\n{counter}", value.replace("1e-5", "\"10 nm\"")),
            [line, "`scale_mm` in [sensor.can.value]", "must be a number, not string \"10 nm\""],
        ),
        (
            format!("{value}\n{}", counter.replace("16", "160")),
            [line, "`counter.width` is 160", "a number has 1 to 64 bits"],
        ),
    ] {
        assert_refused(&machine_with_frame_layout(&layout), &["run", METHOD], &told);
    }
}

/// A sensor on a port that sends these bytes repeatedly.
fn machine_with_sensor_sending(bytes: Vec<u8>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        while let Ok((mut stream, _)) = listener.accept() {
            while stream.write_all(&bytes).is_ok() {
                std::thread::sleep(std::time::Duration::from_millis(2));
            }
        }
    });
    let line = format!(
        "[sensor.serial]\ntcp = \"{at}\"\n[sensor.serial.line]\nend = \"\\r\\n\"\nseparator = \",\"\n\
         columns = 3\nvalue = {{ column = 2, scale_mm = 1.0 }}\n"
    );
    laser_machine_with_text_replacements(&[(SIMULATED_SENSOR_SECTION, &line)], "")
}

pub fn wrong_baud_rate_and_text_values_are_refused_with_their_cause() {
    let line = b"M0,+01.23450,0001\r\n".repeat(12);
    let noise = link::decode_at_baud(&line, 115_200, 9600);
    let speed = ["mostly noise instead of lines of text", "set the converter to the sensor's baud rate"];
    assert_refused(&machine_with_sensor_sending(noise), &["run", METHOD], &speed);
    let text = b"M0,STANDBY,0001\r\n".to_vec();
    let columns = ["the received lines do not match the layout: `M0,STANDBY", "a number in the column"];
    assert_refused(&machine_with_sensor_sending(text), &["run", METHOD], &columns);
}

pub fn unmeasurable_settings_are_refused_for_dwell_and_continuous_scans() {
    for sampling in ["dwell", "continuous"] {
        let settings = |more: &str| format!("sampling = \"{sampling}\"\n{more}");
        let two = laser_machine_with_text_replacements(&[], &settings("heights_mm = [-5.0, 5.0, 5.1]"));
        assert_refused(&two, &["plan", METHOD], &["heights_mm has 2 different heights", "state three or more heights"]);
        // At some pose the sphere is beyond the travel of an axis.
        let far = laser_machine_with_text_replacements(&[("centre_mm = [80.0,", "centre_mm = [205.0,")], &settings(""));
        assert_refused(
            &far,
            &["plan", METHOD],
            &["at B -90°, C 0° the scan needs Z", "remove the position from tilt_deg"],
        );
    }
    // Known only after the sphere was measured.
    let high = laser_machine_with_text_replacements(&[], "heights_mm = [-5.0, 0.0, 9.5]");
    let told = ["may be out of the sensor's range", "choose heights_mm nearer to the middle"];
    assert_refused(&high, &["run", METHOD], &told);
}

/// Readings of a run on the simulated machine with `sampling`.
fn simulate_laser_readings(sampling: &str) -> (String, Plan, Vec<Reading>) {
    let settings =
        format!("tilt_deg = [-60.0, 60.0]\nturn_deg = [120.0, 240.0]\nsampling = \"{sampling}\"\nrate_hz = 100.0");
    let text = laser_machine_with_text_replacements(&[], &settings);
    let file = MachineFile::parse("laser.toml", text.clone()).unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, METHOD, None).unwrap();
    let mut world = setup::build_world(&file).unwrap();
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    (text, plan, readings)
}

fn identify_readings((text, plan, readings): (&str, &Plan, &[Reading])) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (plan_at, csv) = (at("plan.json"), at("readings.csv"));
    std::fs::write(&plan_at, serde_json::to_string(plan).unwrap()).unwrap();
    readings_csv::write_readings(readings, &[], std::fs::File::create(&csv).unwrap()).unwrap();
    run_trued(folder.path(), text, &["identify", METHOD, "--plan", &plan_at, "--readings", &csv])
}

/// Flags the samples for which `is_lost` is true as out of range.
fn flag_out_of_range(
    (plan, readings): (&Plan, &[Reading]),
    is_lost: impl Fn(&Step, &[Reading], &Reading) -> bool,
) -> Vec<Reading> {
    let same = |one: &Reading, other: &Reading| one.step == other.step;
    let scans = readings.chunk_by(same);
    let mut spoilt = Vec::new();
    for scan in scans {
        let step = plan.steps.iter().find(|step| step.id == scan[0].step).unwrap();
        for reading in scan {
            let mut reading = reading.clone();
            if is_lost(step, scan, &reading) {
                (reading.value_mm, reading.flag) = (None, ReadingFlag::Range);
            }
            spoilt.push(reading);
        }
    }
    spoilt
}

/// Whether the reading is off that line of the cross which is along X.
fn is_off_line_along_x(scan: &[Reading], reading: &Reading) -> bool {
    let mut all: Vec<f64> = scan.iter().map(|reading| reading.position.get_or_zero(Axis::Y)).collect();
    all.sort_by(f64::total_cmp);
    (reading.position.get_or_zero(Axis::Y) - all[all.len() / 2]).abs() > 0.05
}

pub fn insufficient_readings_are_refused_for_dwell_and_continuous_scans() {
    for sampling in ["dwell", "continuous"] {
        let (text, plan, readings) = simulate_laser_readings(sampling);
        let whole = identify_readings((&text, &plan, &readings));
        assert_eq!(whole.status.code(), Some(0), "{sampling}: {}", stderr(&whole));

        let one = flag_out_of_range((&plan, &readings), |step, _, _| {
            step.label.starts_with("height/1") || step.label.starts_with("height/2")
        });
        let told = ["needs scans at three heights, the readings have 1", "three heights_mm that are well apart"];
        assert_failed_with_messages(&identify_readings((&text, &plan, &one)), &told);

        // The scans for the latency are unchanged.
        let flat = flag_out_of_range((&plan, &readings), |step, scan, reading| {
            !step.label.starts_with("latency") && is_off_line_along_x(scan, reading)
        });
        assert_failed_with_messages(
            &identify_readings((&text, &plan, &flat)),
            &["great circle", "two lines that cross"],
        );
    }
}
