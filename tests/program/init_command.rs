//! `trued init` and `trued simulate`, both as programs: the machine file that `init` writes can be read and
//! planned.

use crate::support::harness::{Pool, Trials, trials};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use machine::Axis;
use trued::setup::MachineFile;

const TRUED_PROGRAM: &str = env!("CARGO_BIN_EXE_trued");
const MACHINE_FILE: &str = include_str!("../../config/simulated.toml");

/// `trued simulate`, ended with the test.
struct SimulatorProcess {
    process: Child,
    address: String,
}

impl SimulatorProcess {
    /// Starts with `wire_lines` in place of the line with the key `wire`.
    fn start(folder: &Path, wire_lines: &str) -> Self {
        let file = folder.join("truth.toml");
        assert!(MACHINE_FILE.contains("wire = \"memory\"\n"));
        std::fs::write(&file, MACHINE_FILE.replace("wire = \"memory\"\n", wire_lines)).unwrap();
        let mut process = Command::new(TRUED_PROGRAM)
            .args(["simulate", "--machine"])
            .arg(&file)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut at = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut at).unwrap();
        Self { process, address: at.trim().to_owned() }
    }
}

impl Drop for SimulatorProcess {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn run_trued(arguments: &[&str]) -> Output {
    Command::new(TRUED_PROGRAM).args(arguments).output().unwrap()
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn init_reads_most_of_the_machine_file_from_grbl() {
    let folder = tempfile::tempdir().unwrap();
    let simulator = SimulatorProcess::start(folder.path(), "wire = \"pty\"\nbaud = 57600\n");
    let file = folder.path().join("mine.toml");
    let to = file.to_str().unwrap();
    let at = ["init", "--kind", "grbl", "--serial", simulator.address.as_str(), "--to", to];

    let wrong = run_trued(&at);
    assert_eq!(wrong.status.code(), Some(1), "{}", stderr_text(&wrong));
    assert!(stderr_text(&wrong).contains("wrong baud rate (115200)"), "{}", stderr_text(&wrong));
    assert!(!file.exists());
    let search = run_trued(&[&at[..], &["--search"]].concat());
    assert!(stderr_text(&search).contains("communicates at 57600 baud"), "{}", stderr_text(&search));

    let init = run_trued(&[&at[..], &["--baud", "57600"]].concat());
    assert_eq!(init.status.code(), Some(0), "{}", stderr_text(&init));
    let drafted = MachineFile::read(&file).unwrap();
    let truth = MachineFile::parse("truth.toml", MACHINE_FILE.to_owned()).unwrap().machine;
    for axis in [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C] {
        let (drafted, truth) = (&drafted.machine.axes[&axis], &truth.axes[&axis]);
        assert_eq!(drafted.rapid_per_min, truth.rapid_per_min, "{axis}");
        assert_eq!(drafted.acceleration_per_s2, truth.acceleration_per_s2, "{axis}");
        assert_eq!(drafted.max - drafted.min, truth.max - truth.min, "{axis}");
    }
    assert_eq!(drafted.machine.topology, truth.topology);
    let plan = run_trued(&["plan", "self-calibration", "--machine", to]);
    assert_eq!(plan.status.code(), Some(0), "{}", stderr_text(&plan));

    let text = std::fs::read_to_string(&file).unwrap();
    let again = run_trued(&[&at[..], &["--baud", "57600"]].concat());
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr_text(&again).contains("exists already"), "{}", stderr_text(&again));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), text);
}

fn init_over_modbus_marks_what_the_control_does_not_report() {
    let folder = tempfile::tempdir().unwrap();
    let simulator = SimulatorProcess::start(folder.path(), "speaks = \"modbus\"\n");
    let init = run_trued(&["init", "--kind", "modbus", "--tcp", &simulator.address, "--name", "a \"mill\""]);
    assert_eq!(init.status.code(), Some(0), "{}", stderr_text(&init));
    let text = String::from_utf8(init.stdout).unwrap();
    let drafted = MachineFile::parse("drafted.toml", text.clone()).unwrap();
    assert_eq!(drafted.machine.name, "a \"mill\"");
    assert_eq!(drafted.machine.axes[&Axis::X].resolution_um, 1.0);
    assert!(text.contains("YOURS: travel in machine coordinates; the control does not report it"));
    assert!(text.contains(&format!("tcp = \"{}\"", simulator.address)));
}

fn missing_program_dir_option_is_named() {
    let init = run_trued(&["init", "--kind", "linuxcnc", "--tcp", "127.0.0.1:1"]);
    assert_eq!(init.status.code(), Some(2), "{}", stderr_text(&init));
    assert!(stderr_text(&init).contains("--program-dir <DIR>"), "{}", stderr_text(&init));
}

fn missing_ini_file_error_names_the_ini_option() {
    let folder = tempfile::tempdir().unwrap();
    let programs = folder.path().display().to_string();
    let at = ["init", "--kind", "linuxcnc", "--tcp", "127.0.0.1:1", "--program-dir", &programs];
    let init = run_trued(&[&at[..], &["--ini", "none.ini"]].concat());
    assert_eq!(init.status.code(), Some(1), "{}", stderr_text(&init));
    assert!(stderr_text(&init).contains("--ini: the file none.ini does not exist"), "{}", stderr_text(&init));
    assert!(!stderr_text(&init).contains("--search"), "{}", stderr_text(&init));
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        init_reads_most_of_the_machine_file_from_grbl,
        init_over_modbus_marks_what_the_control_does_not_report,
        missing_program_dir_option_is_named,
        missing_ini_file_error_names_the_ini_option,
    ]
}
