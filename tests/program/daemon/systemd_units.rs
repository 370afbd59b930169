//! `systemd/` as systemd itself parses it. Without `systemd-analyze` these tests are skipped; with
//! `TRUED_REQUIRE_PEERS=1` they fail.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const UNIT_FILES: [&str; 3] = ["trued.service", "trued-cycle@.service", "trued-cycle@.timer"];
/// Targets to which the units refer.
const SYSTEMD_TARGETS: [&str; 7] =
    ["sysinit", "basic", "shutdown", "timers", "network-online", "time-sync", "multi-user"];
/// Maximum exposure level of `systemd-analyze security`, of 10.
const MAX_EXPOSURE: f64 = 2.0;

fn unit_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd")
}

/// Runs `systemd-analyze`; returns `None` if it is neither installed nor required.
fn systemd_analyze(arguments: &[&str]) -> Option<Output> {
    let output = Command::new("systemd-analyze").args(arguments).output();
    let required = std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1");
    match output {
        Ok(output) => Some(output),
        Err(error) if required => panic!("systemd-analyze: {error}"),
        Err(error) => {
            println!("skipped, no systemd-analyze (Debian: systemd): {error}");
            None
        }
    }
}

fn output_text(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|said| String::from_utf8_lossy(said).into_owned()).concat()
}

/// A root directory with the units, and the program at the path in the units.
fn root_with_units() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    let (units, programs) = ("etc/systemd/system", "usr/bin");
    for made in [units, programs] {
        std::fs::create_dir_all(root.path().join(made)).unwrap();
    }
    for unit in UNIT_FILES {
        std::fs::copy(unit_folder().join(unit), root.path().join(units).join(unit)).unwrap();
    }
    for target in SYSTEMD_TARGETS {
        let file = root.path().join(units).join(format!("{target}.target"));
        std::fs::write(file, "[Unit]\n").unwrap();
    }
    for program in ["trued", "curl"] {
        std::fs::copy("/bin/sh", root.path().join(programs).join(program)).unwrap();
    }
    root
}

fn verify_units(root: &Path) -> Option<Output> {
    let root = format!("--root={}", root.display());
    systemd_analyze(&["verify", &root, "trued.service", "trued-cycle@1.service", "trued-cycle@1.timer"])
}

pub fn units_are_valid() {
    let root = root_with_units();
    let Some(output) = verify_units(root.path()) else { return };
    assert!(output.status.success() && output_text(&output).is_empty(), "{}", output_text(&output));
    // Check that an error is detected.
    let unit = root.path().join("etc/systemd/system/trued.service");
    let text = std::fs::read_to_string(&unit).unwrap();
    for (right, wrong) in [("WatchdogSec=30s", "WatchdogSec=often"), ("ExecStart=", "ExecStrat=")] {
        assert!(text.contains(right), "{right}");
        std::fs::write(&unit, text.replacen(right, wrong, 1)).unwrap();
        let output = verify_units(root.path()).unwrap();
        assert!(!output_text(&output).is_empty(), "{wrong} was not seen");
    }
}

pub fn services_are_hardened() {
    for unit in &UNIT_FILES[..2] {
        let file = unit_folder().join(unit).display().to_string();
        let Some(output) = systemd_analyze(&["security", "--offline=true", &file]) else { return };
        let said = output_text(&output);
        let overall = said.lines().find(|line| line.contains("Overall exposure level"));
        let level = overall.and_then(|line| line.rsplit_once(": ")?.1.split(' ').next()?.parse().ok());
        let level: f64 = level.unwrap_or_else(|| panic!("{said}"));
        println!("{unit}: {level}");
        assert!(level <= MAX_EXPOSURE, "{unit}: {level}\n{said}");
    }
}

/// The commands in the unit agree with those of the program.
pub fn service_commands_and_options_exist_in_the_program() {
    let unit = std::fs::read_to_string(unit_folder().join("trued.service")).unwrap();
    let calls: Vec<Vec<&str>> = unit
        .lines()
        .filter(|line| line.starts_with("Exec"))
        .map(|line| line.split_once("/usr/bin/trued ").unwrap().1.split(' ').collect())
        .collect();
    assert_eq!(calls.len(), 1);
    for call in calls {
        // Each option is listed in the program's help.
        let help = Command::new(env!("CARGO_BIN_EXE_trued")).args([call[0], "--help"]).output();
        let help = output_text(&help.unwrap());
        let options: Vec<_> = call.iter().filter(|word| word.starts_with("--")).collect();
        assert!(options.iter().all(|option| help.contains(**option)), "{call:?}: {help}");
    }
    assert!(unit.contains("Type=notify\n") && unit.contains("SuccessExitStatus=5\n"));
}

/// A timer does not start a stopped daemon; the kernel modules of adapters that are plugged in later are loaded
/// before the daemon starts.
pub fn cycle_unit_starts_nothing_and_service_loads_adapter_modules() {
    let of = |unit: &str, keys: &[&str]| -> Vec<String> {
        let text = std::fs::read_to_string(unit_folder().join(unit)).unwrap();
        let lines = text.lines().filter_map(|line| line.split_once('='));
        let lines = lines.filter(|(key, _)| keys.contains(key));
        lines.flat_map(|(_, units)| units.split(' ').map(str::to_owned)).collect()
    };
    let starts = ["Requires", "Wants", "BindsTo", "Upholds", "PropagatesReloadTo"];
    assert!(of("trued-cycle@.service", &starts).is_empty());
    assert_eq!(of("trued-cycle@.service", &["Requisite"]), ["trued.service"]);
    assert_eq!(of("trued-cycle@.service", &["After"]), ["trued.service"]);
    let allowed = of("trued.service", &["DeviceAllow"]);
    let modules = [("char-ttyUSB", "usbserial"), ("char-ttyACM", "cdc_acm")];
    for (group, module) in modules {
        assert!(allowed.iter().any(|word| word == group), "{group}");
        for key in ["Wants", "After"] {
            let units = of("trued.service", &[key]);
            assert!(units.contains(&format!("modprobe@{module}.service")), "{key}: {units:?}");
        }
    }
}
