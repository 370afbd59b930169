//! The simulated control behind the line window, driven by an independent program: `window.py`, which implements
//! docs/line-window.md with pymodbus.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};

use libtest_mimic::Failed;
use machine::{Axis, Position};
use serde_json::Value;
use simulator::Speed;
use trued::setup::{self, MachineFile};

use super::pymodbus::python_with_pymodbus;
use super::server::peer_script_path;

const SIMULATED_MACHINE_FILE: &str = include_str!("../../../config/simulated.toml");
const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// `trued simulate`, ended with the trial.
struct SimulatorProcess {
    child: Child,
    folder: tempfile::TempDir,
    wire: &'static str,
    address: String,
}

impl Drop for SimulatorProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn machine_file_with_line_window(wire: &str) -> String {
    let wire = if wire == "tcp" { "tcp" } else { "pty" };
    assert!(SIMULATED_MACHINE_FILE.contains("wire = \"memory\"\n"));
    SIMULATED_MACHINE_FILE.replace("wire = \"memory\"\n", &format!("speaks = \"modbus\"\nwire = \"{wire}\"\n"))
}

impl SimulatorProcess {
    /// `wire`: `tcp` or a serial line; `speed`: argument of `--speed`.
    fn start(wire: &'static str, speed: &str) -> Result<Self, Failed> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("machine.toml");
        std::fs::write(&file, machine_file_with_line_window(wire))?;
        let mut child = Command::new(env!("CARGO_BIN_EXE_trued"))
            .args(["simulate", "--speed", speed, "--machine"])
            .arg(&file)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let mut said = String::new();
        BufReader::new(child.stdout.take().ok_or("no output")?).read_line(&mut said)?;
        let at = said.trim().trim_start_matches("127.0.0.1:").to_owned();
        Ok(Self { child, folder, wire, address: at })
    }

    /// The lines that `trial` prints, without the last one, which confirms the documented behaviour.
    fn play_trial(&self, trial: &str, input: &str) -> Result<Vec<String>, Failed> {
        let mut client = Command::new(python_with_pymodbus().ok_or("no python")?)
            .arg(peer_script_path("window.py"))
            .args([self.wire, &self.address, trial])
            .current_dir(self.folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        client.stdin.take().ok_or("no input")?.write_all(input.as_bytes())?;
        let output = client.wait_with_output()?;
        let said = String::from_utf8_lossy(&output.stdout);
        let mut lines: Vec<String> = said.lines().map(str::to_owned).collect();
        match lines.pop().as_deref() {
            Some("as documented") if output.status.success() => Ok(lines),
            last => {
                let why = String::from_utf8_lossy(&output.stderr).into_owned();
                Err(format!("{trial} over {}: {last:?} {why}", self.wire).into())
            }
        }
    }
}

/// Two touches, compared with the same motions on the world itself without a control.
pub fn touches_over_the_line_window_equal_those_in_the_world() -> Result<(), Failed> {
    const TWO_TOUCH_PROGRAM: &str = "G21 G90 G94\nG53 G0 X50.5\nG53 G0 Z235\nN7 G38.3 Z170 F3000\n\
                         N7 G38.3 X40 F60\nG53 G1 X50.5 F300\nG53 G0 Z235\nG53 G0 X0\n\
                         N9 G38.3 Z215 F60\nG53 G1 Z235 F300\n";
    let file = MachineFile::parse("machine.toml", machine_file_with_line_window("tcp")).map_err(|e| e.to_string())?;
    let mut world = setup::build_world(&file).map_err(|error| error.to_string())?;
    let to = |axis: Axis, mm: f64| Position::new().with(axis, mm);
    world.travel(&to(Axis::X, 50.5), Speed::Rapid);
    world.travel(&to(Axis::Z, 235.0), Speed::Rapid);
    let missed = world.probe(&to(Axis::Z, 170.0), 3000.0, 7);
    let first = world.probe(&to(Axis::X, 40.0), 60.0, 7).contact.ok_or("nothing is there")?;
    world.travel(&to(Axis::X, 50.5), Speed::Feed { mm_min: 300.0 });
    world.travel(&to(Axis::Z, 235.0), Speed::Rapid);
    world.travel(&to(Axis::X, 0.0), Speed::Rapid);
    let second = world.probe(&to(Axis::Z, 215.0), 60.0, 9).contact.ok_or("nothing is there")?;
    assert!(missed.contact.is_none());
    for wire in ["tcp", "rtu"] {
        let told = SimulatorProcess::start(wire, "fast")?.play_trial("lines", TWO_TOUCH_PROGRAM)?;
        let told: Vec<Value> = told.iter().map(|line| serde_json::from_str(line)).collect::<Result<_, _>>()?;
        assert_eq!(told.len(), TWO_TOUCH_PROGRAM.lines().count(), "{wire}");
        let latches = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2];
        let counted: Vec<_> = told.iter().map(|status| status["latches"].clone()).collect();
        assert_eq!(counted, latches, "{wire}");
        // In contact at the touches, free before and after.
        let closed: Vec<_> = told.iter().map(|status| status["probe"] == 1).collect();
        assert_eq!(closed.iter().filter(|closed| **closed).count(), 2, "{wire}: {closed:?}");
        assert!(closed[4] && closed[8], "{wire}: {closed:?}");
        for (at, contact) in [(4, &first), (8, &second)] {
            let steps = |axis: Axis| axis.to_mm_or_deg(contact.latched_position.get_or_zero(axis)) * 1e3;
            for (place, axis) in AXES.into_iter().enumerate() {
                let latched = told[at]["latch"][place].as_f64().ok_or("no latch")?;
                assert!((latched - steps(axis)).abs() <= 0.5, "{wire}: {axis} {latched}");
            }
            assert_eq!(told[at]["latch_time"], contact.latch_time_s, "{wire}");
        }
        assert_eq!(told[9]["position"], serde_json::json!([0, 0, 235_000, 0, 0, 0]), "{wire}");
    }
    Ok(())
}

fn play_trial_on_each_wire(trial: &str) -> Result<(), Failed> {
    for wire in ["tcp", "rtu"] {
        SimulatorProcess::start(wire, "real")?.play_trial(trial, "")?;
    }
    Ok(())
}

pub fn line_window_refusals_are_as_documented() -> Result<(), Failed> {
    play_trial_on_each_wire("refusals")
}

pub fn line_window_hold_is_as_documented() -> Result<(), Failed> {
    play_trial_on_each_wire("hold")
}

pub fn line_window_heartbeat_is_as_documented() -> Result<(), Failed> {
    play_trial_on_each_wire("heartbeat")
}
