//! The program itself on a CAN bus of a real kernel, in a virtual machine (`tests/peers/socketcan/`), together with
//! can-utils. Without the machine the trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they fail.
//! `.ci/run` tests the sensor; `.ci/long` also a whole measurement, which takes a minute and a half.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use libtest_mimic::Failed;

use crate::support::harness::{Pool, Trials, trials};

const TRUED_PROGRAM_PATH: &str = env!("CARGO_BIN_EXE_trued");
const SCRIPT_FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/socketcan");
const SIMULATED_MACHINE_FILE: &str = include_str!("../../../config/simulated.toml");
const LASER_MACHINE_FILE: &str = include_str!("../../../config/laser.toml");
const GUEST_SCENES_SCRIPT: &str = include_str!("scenes");
const GUEST_MEASUREMENT_SCRIPT: &str = include_str!("measurement");
const GUEST_WITHOUT_CAN_SCRIPT: &str = include_str!("without");

const FRAME_COUNT: i64 = 10_000;
/// Index of each frame before which the counter skips, and the number of skipped counts.
const COUNTER_SKIPS: [(i64, i64); 3] = [(1000, 3), (5000, 1), (9000, 200)];

const NO_CAN_MESSAGE: &str = "the kernel of this computer does not support CAN";

type GuestOutput = BTreeMap<String, String>;

fn guest_cache_folder() -> Option<PathBuf> {
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).parent()?.join("peers/socketcan");
    cache.join("complete").exists().then_some(cache)
}

/// A machine file whose laser has these connection keys.
fn machine_with_laser(reached: &str) -> String {
    format!(
        "{SIMULATED_MACHINE_FILE}\n[[sensor]]\nname = \"laser\"\nzero_mm = [0.0, 0.0, -150.0]\n\
         direction = [0.0, 0.0, -1.0]\nrange_mm = [-100.0, 100.0]\n{reached}"
    )
}

/// 24 bits, two's complement, 10 nm per count; a counter of 16 bits before the value and a status after it.
fn machine_with_can_laser(interface: &str, timeout_s: f64) -> String {
    machine_with_laser(&format!(
        "[sensor.can]\ninterface = \"{interface}\"\nid = 0x181\ntimeout_s = {timeout_s:?}\n\
         order = \"big\"\nlength = 6\n\
         value = {{ byte = 2, width = 24, signed = true, scale_mm = 1e-5 }}\n\
         counter = {{ byte = 0, width = 16 }}\n\
         status = [{{ byte = 5, bit = 0, means = \"no-echo\" }}]\n"
    ))
}

/// The built-in machine of the laser R-test, its sensor on the guest's interface; few poses and points, because the
/// guest is slow.
fn laser_r_test_machine_on_vcan0() -> String {
    let memory = "speaks = \"can\"\nwire = \"memory\"\n";
    assert!(LASER_MACHINE_FILE.contains(memory));
    let text = LASER_MACHINE_FILE.replace(memory, "speaks = \"can\"\nwire = \"vcan0\"\n");
    text + "\n[method.laser-r-test]\ntilt_deg = [-60.0, 60.0]\nturn_deg = [120.0, 240.0]\n\
            points = 7\nsamples = 5\nmonte_carlo_trials = 100\n"
}

/// On the host, whatever its kernel: refused, with advice.
fn missing_can_interface_is_refused_with_a_remedy() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("machine.toml");
    std::fs::write(&file, machine_with_can_laser("can-none", 0.1))?;
    for words in [&["watch", "laser"][..], &["check"]] {
        let mut command = Command::new(TRUED_PROGRAM_PATH);
        command.args(words).arg("--machine").arg(&file).arg("--state").arg(folder.path());
        let ended = command.output()?;
        let said = [ended.stderr, ended.stdout].concat();
        let said = String::from_utf8_lossy(&said);
        let kernel = said.contains(NO_CAN_MESSAGE) && said.contains("modprobe can can_raw");
        let interface =
            said.contains("no CAN interface is named `can-none`") && said.contains("ip -brief link show type can");
        if ended.status.code() != Some(1) || !(kernel || interface) {
            return Err(format!("{words:?}: {said}").into());
        }
    }
    Ok(())
}

/// A log in candump's format: `count` frames, one every `interval_ms`, from the smallest to the
/// largest value of 24 bits.
fn candump_log(interval_ms: i64, count: i64, first_counter: i64, counter_skips: &[(i64, i64)]) -> String {
    let mut text = String::new();
    for frame in 0..count {
        let more: i64 = counter_skips.iter().filter(|(at, _)| *at <= frame).map(|(_, more)| more).sum();
        let counter = (first_counter + frame + more) & 0xFFFF;
        let value = -8_388_608 + frame * 16_777_215 / (count - 1);
        let value = value & 0xFF_FFFF;
        let (seconds, millis) = ((frame + 1) * interval_ms / 1000, (frame + 1) * interval_ms % 1000);
        writeln!(text, "({seconds:010}.{millis:03}000) vcan0 181#{counter:04X}{value:06X}00").expect("text");
    }
    text
}

fn missing_guest() -> Option<&'static str> {
    guest_cache_folder().is_none().then_some("the virtual machine is missing: tests/peers/socketcan/fetch")
}

fn guest_scenes_give_the_expected_counts_and_messages() -> Result<(), Failed> {
    let twin = "[sensor.simulated]\nspeaks = \"can\"\nwire = \"vcan0\"\n";
    let half = machine_with_can_laser("vcan0", 5.0).replace("[sensor.can]", "rate_hz = 1000.0\n[sensor.can]");
    let told = run_in_guest(&[
        ("scenes", GUEST_SCENES_SCRIPT.to_owned()),
        ("stream.log", candump_log(1, FRAME_COUNT, 65_000, &COUNTER_SKIPS)),
        ("before.log", candump_log(1, 200, 0, &[])),
        ("after.log", candump_log(1, 200, 250, &[])),
        ("without", GUEST_WITHOUT_CAN_SCRIPT.to_owned()),
        ("half.log", candump_log(2, 60_000, 0, &[])),
        ("half.toml", half),
        ("quick.toml", machine_with_can_laser("vcan0", 0.5)),
        ("patient.toml", machine_with_can_laser("vcan0", 30.0)),
        ("none.toml", machine_with_can_laser("can7", 0.5)),
        ("lo.toml", machine_with_can_laser("lo", 0.5)),
        ("twin.toml", machine_with_laser(twin)),
    ])?;
    check_scenes(&guest_values(&told), &told).map_err(Failed::from)
}

fn laser_r_test_over_can_finds_the_true_values() -> Result<(), Failed> {
    let told = run_in_guest(&[
        ("scenes", GUEST_MEASUREMENT_SCRIPT.to_owned()),
        ("run.toml", laser_r_test_machine_on_vcan0()),
    ])?;
    check_measurement(&guest_values(&told), &told).map_err(Failed::from)
}

/// Runs the script `scenes` of `files` in the virtual machine; before it, without CAN, the script `without` if there is
/// one. Returns the output.
fn run_in_guest(files: &[(&str, String)]) -> Result<String, Failed> {
    let cache = guest_cache_folder().ok_or("no virtual machine")?;
    let folder = tempfile::tempdir()?;
    let data = folder.path().join("data");
    std::fs::create_dir(&data)?;
    files.iter().try_for_each(|(name, text)| std::fs::write(data.join(name), text))?;
    let image = folder.path().join("image");
    let packed = Command::new(format!("{SCRIPT_FOLDER}/pack"))
        .args([cache.as_path(), &data, Path::new(TRUED_PROGRAM_PATH), &image])
        .output()?;
    if !packed.status.success() {
        return Err(String::from_utf8_lossy(&packed.stderr).into_owned().into());
    }
    let booted = Command::new(format!("{SCRIPT_FOLDER}/boot")).args([&cache, &image]).output()?;
    let told = String::from_utf8_lossy(&booted.stdout).into_owned();
    print!("{told}");
    match booted.status.success() {
        true => Ok(told),
        false => Err(format!("the guest failed ({}):\n{told}", booted.status).into()),
    }
}

/// The values of the lines `scene.key value`.
fn guest_values(told: &str) -> GuestOutput {
    let line = |line: &str| {
        let (key, value) = line.split_once(' ')?;
        key.contains('.').then(|| (key.to_owned(), value.trim().to_owned()))
    };
    told.lines().filter_map(line).collect()
}

fn check_scenes(values: &GuestOutput, told: &str) -> Result<(), String> {
    let missing = COUNTER_SKIPS.iter().map(|(_, more)| more).sum::<i64>();
    let counts = [
        ("stream.status", 0),
        ("stream.dumped", FRAME_COUNT),
        ("stream.values", FRAME_COUNT),
        ("stream.gaps", COUNTER_SKIPS.len() as i64),
        ("stream.missing", missing),
        ("stream.stale", 0),
        ("down.values", 400),
        ("down.gaps", 1),
        ("down.missing", 50),
        ("down.stale", 1),
        ("off.values", 4),
        ("off.gaps", 1),
        ("off.missing", 3),
        ("off.stale", 1),
        ("others.status", 0),
        ("others.values", 2),
        ("twin.status", 0),
        ("twin.stale", 0),
        ("twin.missing", 0),
        ("none.status", 1),
        ("lo.status", 1),
    ];
    for (key, wanted) in counts {
        let came = values.get(key).and_then(|value| value.parse::<i64>().ok());
        if came != Some(wanted) {
            return Err(format!("{key} is {came:?}, not {wanted}\n{told}"));
        }
    }
    for scene in ["stream", "others"] {
        for (key, wanted) in [("least", "-83.88608"), ("greatest", "83.88607")] {
            if values.get(&format!("{scene}.{key}")).map(String::as_str) != Some(wanted) {
                return Err(format!("{scene}.{key} is not {wanted}\n{told}"));
            }
        }
    }
    match EXPECTED_MESSAGES.iter().find(|words| !told.contains(**words)) {
        Some(words) => Err(format!("nobody said: {words}\n{told}")),
        None => Ok(()),
    }
}

fn check_measurement(values: &GuestOutput, told: &str) -> Result<(), String> {
    if values.get("run.status").map(String::as_str) != Some("0") {
        return Err(format!("the run failed\n{told}"));
    }
    // Paper 2, Table 5, as in the simulated machine; the tolerances are those of a few poses.
    for (symbol, truth, limit) in [("E_B0B", -42.0, 12.0), ("E_X0C", -1.0, 1.5), ("E_A0C", 5.2, 12.0)] {
        // The terminal shows a true minus sign.
        let number = |text: &String| text.replace('\u{2212}', "-").parse::<f64>().ok();
        let came = values.get(&format!("run.{symbol}")).and_then(number);
        if came.is_none_or(|came: f64| (came - truth).abs() > limit) {
            return Err(format!("{symbol} is {came:?}, truly {truth}\n{told}"));
        }
    }
    Ok(())
}

/// Expected messages; output of `trued check` begins with the name of a scene.
const EXPECTED_MESSAGES: [&str; 11] = [
    "no CAN interface is named `can7`; available: vcan0",
    "`lo` is not a CAN interface; available: vcan0",
    "without: sensors FAILED         laser (frames 181 on CAN interface vcan0): the kernel of this computer does not support CAN",
    "without:         → load the modules as root: `modprobe can can_raw`",
    "errors: sensors FAILED         laser (frames 181 on CAN interface vcan0): no frame 181 was received on `vcan0`, and \
     the bus has errors",
    "errors:         → compare the bit rate (`ip -details link show vcan0`)",
    "stranger: sensors FAILED         laser (frames 181 on CAN interface vcan0): no frame 181 was received on `vcan0`, \
     only frames with other identifiers: 182",
    "closed: sensors FAILED         laser (frames 181 on CAN interface vcan0): the CAN interface `vcan0` is down",
    "gone: sensors FAILED         laser (frames 181 on CAN interface vcan0): the CAN controller of `vcan0` is bus-off",
    "samples/s; the machine file states rate_hz = 1000",
    "sound: sensors ok             laser (simulated)",
];

pub fn trials() -> Trials {
    let measurement = trials![Pool::Alone, 120; laser_r_test_over_can_finds_the_true_values].mark_ignored();
    let guest = trials![Pool::Alone, 50; guest_scenes_give_the_expected_counts_and_messages].with_trials(measurement);
    trials![Pool::Waiting, 0; missing_can_interface_is_refused_with_a_remedy]
        .with_trials(guest.requires_peer(missing_guest))
}
