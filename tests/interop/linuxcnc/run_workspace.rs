//! Runs the program with a machine file for the rig and an empty journal.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use tempfile::TempDir;

use super::data_streams::StreamsProcess;
use super::rig::LinuxCncRig;
use crate::support::terminal_operator;

const MACHINE_FILE: &str = include_str!("../../../config/linuxcnc-sim.toml");
/// Machine files that replace the part and the settings of `MACHINE_FILE`.
const SAMBA_SECTIONS: &str = include_str!("samba.toml");
const LASER_SECTIONS: &str = include_str!("laser.toml");
const MULTIPROBE_SECTIONS: &str = include_str!("multiprobe.toml");

/// Parameters of SAMBA in `SAMBA_SECTIONS`.
const SAMBA_PARAMETERS_OF_B: &str = "[\"EA0B\", \"EC0B\", \"EX0C\", \"EA0C\", \"EB0C\"]";

/// Fewer and faster touches.
const QUICK_TOUCH_TEXT_CHANGES: [(&str, &str); 4] = [
    ("\nfeed_mm_min = 30.0", "\nfeed_mm_min = 300.0"),
    ("repeatability_um = 0.15", "repeatability_um = 1.5"),
    ("uncertainty_mm = 2.0", "uncertainty_mm = 0.4"),
    ("heights_mm = [90.0]", "heights_mm = [90.0]\npositions = 6\nlocate = false"),
];

/// A workspace: a machine file for this rig and an empty journal.
pub struct RunWorkspace(TempDir);

impl RunWorkspace {
    /// `config/linuxcnc-sim.toml` unchanged.
    pub fn for_rig(rig: &LinuxCncRig) -> Result<Self, Failed> {
        Self::with_text_changes(rig, &[])
    }

    /// With a work offset whose zero is the centre of rotation.
    pub fn with_work_offset(rig: &LinuxCncRig, slot: &str) -> Result<Self, Failed> {
        let section = format!("{MACHINE_FILE}\n[compensation.work-offset]\nslot = \"{slot}\"\n");
        Self::from_machine_text(rig, &section, &[])
    }

    /// A short cycle with quick touches, for trials that do not depend on the result.
    pub fn with_quick_touches(rig: &LinuxCncRig) -> Result<Self, Failed> {
        Self::with_text_changes(rig, &QUICK_TOUCH_TEXT_CHANGES)
    }

    /// A short cycle that is triggered externally: the program serves at `port` of this computer.
    pub fn with_modbus_trigger(rig: &LinuxCncRig, port: u16) -> Result<Self, Failed> {
        let serve = format!(
            "{}\n[tolerance]\nEX0C_um = 500.0\nEY0C_um = 500.0\n[serve]\nmin_interval_s = 1.0\n\
             [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n[serve.modbus]\n\
             listen = \"127.0.0.1:{port}\"\nallow = [\"127.0.0.1\"]\n",
            MACHINE_FILE
        );
        Self::from_machine_text(rig, &serve, &QUICK_TOUCH_TEXT_CHANGES)
    }

    /// A short cycle: a touch moves 2 µm in a servo period, the search for the part is fast.
    pub fn with_position_count(rig: &LinuxCncRig, positions: u32) -> Result<Self, Failed> {
        let settings = format!("heights_mm = [90.0]\npositions = {positions}");
        let short = [
            ("\nfeed_mm_min = 30.0", "\nfeed_mm_min = 120.0"),
            ("search_feed_mm_min = 300.0", "search_feed_mm_min = 900.0"),
            ("repeatability_um = 0.15", "repeatability_um = 0.6"),
            ("heights_mm = [90.0]", &*settings),
        ];
        Self::with_text_changes(rig, &short)
    }

    /// With balls in place of the cylinder, and touches at twice the feed: a servo period is then 1 µm.
    pub fn with_balls(rig: &LinuxCncRig) -> Result<Self, Failed> {
        let (head, _) = MACHINE_FILE.split_once("[artefact]").ok_or("there is no part in the file")?;
        let changes = [
            ("\nfeed_mm_min = 30.0", "\nfeed_mm_min = 60.0"),
            ("repeatability_um = 0.15", "repeatability_um = 0.3"),
            // The tools of this control are as long as the stylus.
            ("stylus_offset_um = 0.3", "stylus_offset_um = 0.3\nu_stylus_length_um = 0.0"),
        ];
        let target = "[compensation.linuxcnc-trunnion]\n";
        Self::from_machine_text(rig, &format!("{head}{target}{SAMBA_SECTIONS}"), &changes)
    }

    /// As [`Self::with_balls`], for a table that tilts on A.
    pub fn with_balls_on_a(rig: &LinuxCncRig) -> Result<Self, Failed> {
        let workspace = Self::with_balls(rig)?;
        workspace.change_machine_file(&[
            ("w-C-B-b", "w-C-A-b"),
            // With these kinematics LinuxCNC refuses Z300 after a touch, by rounding.
            ("max = 300.0", "max = 299.0"),
            ("[axes.B]", "[axes.A]"),
            ("on = \"B\"", "on = \"A\""),
            (SAMBA_PARAMETERS_OF_B, "[\"EB0A\", \"EC0A\", \"EY0C\", \"EA0C\", \"EB0C\"]"),
        ])?;
        Ok(workspace)
    }

    /// As [`Self::with_balls`], with the scale of X and its compensation file.
    pub fn with_balls_and_x_table(rig: &LinuxCncRig) -> Result<Self, Failed> {
        let workspace = Self::with_balls(rig)?;
        workspace.change_machine_file(&[
            ("[compensation.linuxcnc-trunnion]", "[compensation.linuxcnc-joints]"),
            (SAMBA_PARAMETERS_OF_B, "[\"EA0B\", \"EC0B\", \"EX0C\", \"EA0C\", \"EB0C\", \"EXX1\"]"),
        ])?;
        Ok(workspace)
    }

    /// For a verification: other positions of the rotary axes, and the tool centre of the control is read.
    pub fn change_to_verification(&self) -> Result<(), Failed> {
        self.change_machine_file(&[
            ("tilt_deg = [-30.0, 0.0, 30.0]\nturn_deg = [0.0,", "tilt_deg = [-25.0, 5.0, 20.0]\nturn_deg = [45.0,"),
            ("kind = \"linuxcnc\"", "kind = \"linuxcnc\"\ntool_centre = { on = \"M68 E3 Q1\", off = \"M68 E3 Q0\" }"),
        ])
    }

    fn change_machine_file(&self, changes: &[(&str, &str)]) -> Result<(), Failed> {
        let text = replace_all(&std::fs::read_to_string(self.machine_file_path())?, changes)?;
        Ok(std::fs::write(self.machine_file_path(), text)?)
    }

    /// With a laser over one ball, and LinuxCNC's sampler, whose table has this additional line.
    pub fn with_laser(rig: &LinuxCncRig, streams: &StreamsProcess, line: &str) -> Result<Self, Failed> {
        let (head, _) = MACHINE_FILE.split_once("[artefact]").ok_or("there is no part in the file")?;
        let ports = [
            ("[controller.sampler]\ntcp", &*format!("[controller.sampler]\n{line}\ntcp")),
            ("127.0.0.1:5011", &*format!("127.0.0.1:{}", streams.position_port)),
            ("127.0.0.1:5012", &*format!("127.0.0.1:{}", streams.laser_port)),
        ];
        Self::from_machine_text(rig, &format!("{head}{LASER_SECTIONS}"), &ports)
    }

    /// With sensors around a datum cylinder at 0°, 90° and 230° (as in rig.hal), and LinuxCNC's sampler.
    pub fn with_multiprobe_sensors(rig: &LinuxCncRig, streams: &StreamsProcess) -> Result<Self, Failed> {
        let (head, _) = MACHINE_FILE.split_once("[artefact]").ok_or("there is no part in the file")?;
        let mut file = format!("{head}{MULTIPROBE_SECTIONS}");
        for (device, degrees) in streams.sensor_serial_paths.iter().zip([0.0_f64, 90.0, 230.0]) {
            let (sin, cos) = degrees.to_radians().sin_cos();
            file += &format!(
                "\n[[sensor]]\nname = \"at {degrees}\"\nmount = \"bed\"\n\
                 zero_mm = [{:.9}, {:.9}, 60.0]\ndirection = [{:.9}, {:.9}, 0.0]\n\
                 range_mm = [-0.3, 0.3]\nstand_off_mm = 0.5\n\
                 [sensor.serial]\nserial = \"{device}\"\nbaud = 115200\ntimeout_s = 3.0\n\
                 [sensor.serial.line]\nseparator = \",\"\nvalue = {{ column = 1, scale_mm = 1.0 }}\n\
                 counter = {{ column = 2, round = 10000 }}\n",
                30.0 * cos,
                30.0 * sin,
                -cos,
                -sin
            );
        }
        let port = format!("127.0.0.1:{}", streams.position_port);
        Self::from_machine_text(rig, &file, &[("127.0.0.1:5011", &port)])
    }

    /// `MACHINE_FILE` with some of its text replaced.
    fn with_text_changes(rig: &LinuxCncRig, changes: &[(&str, &str)]) -> Result<Self, Failed> {
        Self::from_machine_text(rig, MACHINE_FILE, changes)
    }

    fn from_machine_text(rig: &LinuxCncRig, machine: &str, changes: &[(&str, &str)]) -> Result<Self, Failed> {
        let port = format!("127.0.0.1:{}", rig.rsh_port);
        let directory = rig.directory.display().to_string();
        let ini = format!("ini = \"{}\"", rig.ini_path().display());
        let here = [
            ("127.0.0.1:5007", &*port),
            ("/tmp/trued-linuxcnc", &*directory),
            ("# ini = \"/home/cnc/linuxcnc/configs/mine/mine.ini\"", &*ini),
        ];
        let changes: Vec<_> = changes.iter().chain(&here).copied().collect();
        Self::with_changed_machine_file(machine, &changes)
    }

    /// A folder with the machine file `machine_text`, in which each first text of `changes` is replaced by the second.
    pub fn with_changed_machine_file(machine_text: &str, changes: &[(&str, &str)]) -> Result<Self, Failed> {
        let machine = replace_all(machine_text, changes)?;
        let workspace = Self(TempDir::new()?);
        std::fs::write(workspace.machine_file_path(), machine)?;
        Ok(workspace)
    }

    pub fn machine_file_path(&self) -> PathBuf {
        self.0.path().join("machine.toml")
    }

    /// Command of the program without `--state`, so that it has no journal in this folder.
    pub fn trued_command_without_journal(arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub fn trued_command_with_journal(&self, arguments: &[&str]) -> Command {
        let mut command = Self::trued_command_without_journal(arguments);
        command.arg("--state").arg(self.0.path());
        command
    }

    /// Standard output of a command that must succeed.
    pub fn run_stdout(&self, arguments: &[&str]) -> Result<String, Failed> {
        let output = self.trued_command_with_journal(arguments).output()?;
        if !output.status.success() {
            return Err(failure_text(&output).into());
        }
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// The folder of the journal.
    pub fn state_folder(&self) -> &Path {
        self.0.path()
    }

    /// `trued compensate` with these arguments, for the machine of this workspace.
    pub fn compensate(&self, arguments: &[&str]) -> Result<Output, Failed> {
        Ok(self.compensate_command(arguments).output()?)
    }

    pub fn compensate_command(&self, arguments: &[&str]) -> Command {
        let machine = self.machine_file_path().display().to_string();
        self.trued_command_with_journal(&[&["compensate"], arguments, &["--machine", &machine]].concat())
    }

    /// Checks the state of the last run in the journal.
    pub fn check_last_run_state(&self, state: &str) -> Result<(), Failed> {
        let runs = self.run_stdout(&["runs", "--json"])?;
        let said = serde_json::from_str::<serde_json::Value>(&runs)?[0]["state"].clone();
        if said == state { Ok(()) } else { Err(runs.into()) }
    }

    /// Number of readings of the touch probe in the first run, which is exported for each call.
    pub fn first_run_probe_reading_count(&self) -> Result<usize, Failed> {
        let readings = self.read_exported_file("readings.csv")?;
        Ok(readings.lines().filter(|line| line.contains(",probe,")).count())
    }

    /// Number of readings of all sensors in the first run, in steps whose label begins with `label`.
    pub fn first_run_reading_count_of_label_prefix(&self, label: &str) -> Result<usize, Failed> {
        let plan: Plan = serde_json::from_str(&self.read_exported_file("plan.json")?)?;
        let steps = plan.steps.iter().filter(|step| step.label.starts_with(label));
        let steps: Vec<String> = steps.map(|step| step.id.to_string()).collect();
        let readings = self.read_exported_file("readings.csv")?;
        let rows = readings.lines().filter_map(|line| line.split(',').next());
        Ok(rows.filter(|step| steps.iter().any(|of| of == step)).count())
    }

    fn read_exported_file(&self, name: &str) -> Result<String, Failed> {
        self.run_stdout(&["export", "1", "--to", &self.0.path().display().to_string()])?;
        Ok(std::fs::read_to_string(self.0.path().join(format!("run-1-{name}")))?)
    }

    /// Acknowledges the hold and resumes the first run.
    pub fn start_resume_of_first_run(&self) -> Result<Child, Failed> {
        Ok(self.trued_command_with_journal(&["resume", "1", "--acknowledge", "Anna", "--json"]).spawn()?)
    }

    pub fn start_self_calibration(&self) -> Result<Child, Failed> {
        self.start_run("self-calibration")
    }

    /// Starts `trued serve`.
    pub fn start_daemon(&self) -> Result<Child, Failed> {
        let machine = self.machine_file_path().display().to_string();
        Ok(self.trued_command_with_journal(&["serve", "--machine", &machine]).spawn()?)
    }

    pub fn start_run(&self, method: &str) -> Result<Child, Failed> {
        let machine = self.machine_file_path().display().to_string();
        let mut command = self.trued_command_with_journal(&["run", method, "--json", "--machine", &machine]);
        Ok(terminal_operator::confirm_prompts_with_enter(&mut command).spawn()?)
    }
}

fn replace_all(machine_text: &str, changes: &[(&str, &str)]) -> Result<String, Failed> {
    let mut machine = machine_text.to_owned();
    for (from, to) in changes {
        if !machine.contains(from) {
            return Err(format!("`{from}` does not stand in the machine file").into());
        }
        machine = machine.replace(from, to);
    }
    Ok(machine)
}

pub fn failure_text(output: &Output) -> String {
    format!("{}: {}", output.status, String::from_utf8_lossy(&output.stderr))
}

/// Value and expanded uncertainty, µm.
pub fn value_and_expanded_u(estimate: &Estimate, symbol: &str) -> Result<(f64, f64), Failed> {
    let found = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
    found.map(|parameter| (parameter.value, parameter.expanded)).ok_or_else(|| symbol.into())
}
