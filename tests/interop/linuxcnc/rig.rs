//! The rig `tests/peers/linuxcnc/rig`: started once for all trials, ends with this process. All faults of a machine
//! can be simulated here.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::sleep;
use std::time::Duration;

use libtest_mimic::Failed;

use super::rsh_client::RshClient;

/// Pins of the true machine, and their values at the start of a trial.
const TRUE_MACHINE_PINS: [(&str, f64); 21] = [
    ("radius", 45.0),
    ("ball-radius-0", 0.0),
    ("ball-radius-1", 0.0),
    ("ball-radius-2", 0.0),
    ("ball-radius-3", 0.0),
    ("scale-x", 0.0),
    ("b-x", 0.0),
    ("b-z", 0.0),
    ("b-a", 0.0),
    ("b-c", 0.0),
    ("c-a", 0.0),
    ("c-b", 0.0),
    ("stylus-z", 0.0),
    ("c-x", 0.050),
    ("c-y", -0.030),
    ("ecc-x", 0.120),
    ("ecc-y", -0.080),
    ("stylus-x", 0.0121),
    ("stylus-y", -0.0082),
    ("stuck", 0.0),
    ("dead", 0.0),
];
/// Limit of X, as in rig.ini.
const X_LIMIT_MM: f64 = 300.0;

/// What differs between the controls of the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RigVariant {
    /// Axis on which the table tilts.
    pub tilt: char,
    /// Joint X has a compensation file.
    pub has_x_table: bool,
}

/// The table tilts on B.
const DEFAULT_VARIANT: RigVariant = RigVariant { tilt: 'B', has_x_table: false };

pub struct LinuxCncRig {
    variant: RigVariant,
    /// The rig ends when its standard input is closed.
    rig_process: Child,
    /// Id of the session in which all of LinuxCNC runs.
    session_id: String,
    pub rsh_port: u16,
    pub directory: PathBuf,
}

/// Locks the one rig for one trial; the machine is enabled and homed, and the truth is restored.
pub fn lock_rig() -> Result<MutexGuard<'static, LinuxCncRig>, Failed> {
    lock_rig_variant(DEFAULT_VARIANT)
}

/// As [`lock_rig`]; LinuxCNC is restarted if it is another variant.
pub fn lock_rig_variant(variant: RigVariant) -> Result<MutexGuard<'static, LinuxCncRig>, Failed> {
    static SHARED_RIG: OnceLock<Result<Mutex<LinuxCncRig>, String>> = OnceLock::new();
    let rig = SHARED_RIG.get_or_init(|| start_rig(None, variant).map(Mutex::new).map_err(|error| error.to_string()));
    let mut rig = rig.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner);
    if rig.variant != variant {
        rig.variant = variant;
        let _ = std::fs::remove_file(rig.directory.join("x.comp"));
        rig.restart()?;
    }
    rig.restore_or_restart()?;
    Ok(rig)
}

pub fn free_port() -> Result<u16, Box<dyn std::error::Error>> {
    Ok(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port())
}

/// Starts the rig in up to three attempts: on a busy computer LinuxCNC does not always start. Without `port`, each
/// attempt takes a free port.
fn start_rig(port: Option<u16>, variant: RigVariant) -> Result<LinuxCncRig, Box<dyn std::error::Error>> {
    let directory = std::env::temp_dir().join(format!("trued-rig-{}", std::process::id()));
    std::fs::create_dir_all(&directory)?;
    let mut why = String::new();
    for attempt in 1..=3 {
        let port = port.map_or_else(free_port, Ok)?;
        if let Some(rig) = try_start_rig(port, &directory, variant)? {
            return Ok(rig);
        }
        why += &format!("attempt {attempt} at port {port}\n{}", log_tails(&directory));
    }
    Err(format!("the rig does not start:\n{why}").into())
}

/// `None` if the rig ended before it was ready; it has then cleaned up.
fn try_start_rig(
    port: u16,
    directory: &Path,
    variant: RigVariant,
) -> Result<Option<LinuxCncRig>, Box<dyn std::error::Error>> {
    let mut process = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/linuxcnc/rig"))
        .arg(directory)
        .arg(port.to_string())
        .env("RIG_TILT", variant.tilt.to_string())
        .env("RIG_X_TABLE", if variant.has_x_table { "1" } else { "" })
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(File::create(directory.join("rig.log"))?)
        .spawn()?;
    let mut said = String::new();
    BufReader::new(process.stdout.take().ok_or("no output")?).read_line(&mut said)?;
    let Some(session) = said.trim().strip_prefix("ready ").map(str::to_owned) else {
        process.wait()?;
        return Ok(None);
    };
    Ok(Some(LinuxCncRig {
        variant,
        rig_process: process,
        session_id: session,
        rsh_port: port,
        directory: directory.to_owned(),
    }))
}

/// Last output of the rig and of LinuxCNC.
fn log_tails(directory: &Path) -> String {
    let tail = |name: &str| {
        let bytes = std::fs::read(directory.join(name)).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().collect();
        format!("== {name}\n{}\n", lines[lines.len().saturating_sub(15)..].join("\n"))
    };
    ["rig.log", "linuxcnc.log", "rsh.log"].map(tail).concat()
}

pub fn halcmd(arguments: &[&str]) -> Result<String, Failed> {
    let output = Command::new("halcmd").arg("-s").args(arguments).output()?;
    if !output.status.success() {
        return Err(format!("halcmd {arguments:?}: {output:?}").into());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Runs a `halcmd` that loads or unloads a component: as the rig in `directory` itself, so that the component ends
/// with the rig.
pub fn run_component_halcmd(directory: &Path, arguments: &[&str]) -> Result<(), Failed> {
    let log = File::create(directory.join("load.log"))?;
    let done = Command::new("halcmd")
        .args(arguments)
        .current_dir(directory)
        .env("TRUED_RIG", directory)
        .env("RTAPI_UID", "65534")
        .env("RTAPI_FIFO_PATH", directory.join("rt/fifo"))
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log)
        .status()?;
    match done.success() {
        true => Ok(()),
        false => {
            let said = std::fs::read_to_string(directory.join("load.log"))?;
            Err(format!("halcmd {arguments:?}: {said}").into())
        }
    }
}

fn send_signal(signal: &str, process: &str) -> Result<(), Failed> {
    let done = Command::new("kill").args([signal, process]).output()?;
    if done.status.success() { Ok(()) } else { Err(format!("no process `{process}` for {signal}").into()) }
}

impl LinuxCncRig {
    /// Changes the true machine, which is hidden from the measurement.
    pub fn set_true_value(&self, name: &str, value: f64) -> Result<(), Failed> {
        halcmd(&["setp", &format!("truth.{name}"), &value.to_string()]).map(drop)
    }

    /// True position of a joint.
    pub fn joint_position(&self, joint: usize) -> Result<f64, Failed> {
        Ok(halcmd(&["getp", &format!("joint.{joint}.pos-fb")])?.parse()?)
    }

    /// Presses the emergency stop.
    pub fn press_emergency_stop(&self) -> Result<(), Failed> {
        halcmd(&["unlinkp", "iocontrol.0.emc-enable-in"])?;
        halcmd(&["setp", "iocontrol.0.emc-enable-in", "0"]).map(drop)
    }

    /// Releases the emergency stop; it must still be acknowledged at the control.
    pub fn release_emergency_stop(&self) -> Result<(), Failed> {
        halcmd(&["net", "estop", "iocontrol.0.emc-enable-in"]).map(drop)
    }

    /// Switches whether the kinematics compensate the rotary axes, as M428 and M429 do.
    pub fn set_tool_centre_point_mode(&self, is_on: bool) -> Result<(), Failed> {
        halcmd(&["setp", "motion.switchkins-type", if is_on { "1" } else { "0" }])?;
        sleep(Duration::from_millis(100));
        Ok(())
    }

    /// Lets programs switch the kinematics by M68 E3, as in LinuxCNC's samples, while `work` is done.
    pub fn with_kinematics_switch<T>(&self, work: impl FnOnce() -> Result<T, Failed>) -> Result<T, Failed> {
        halcmd(&["net", "kinematics-type", "motion.analog-out-03", "motion.switchkins-type"])?;
        let done = work();
        halcmd(&["delsig", "kinematics-type"])?;
        done
    }

    /// Deflects the stylus for 20 ms, as an obstacle would.
    pub fn deflect_stylus_briefly(&self) -> Result<(), Failed> {
        self.set_true_value("stuck", 1.0)?;
        sleep(Duration::from_millis(20));
        self.set_true_value("stuck", 0.0)
    }

    /// Removes the part from the table.
    pub fn remove_part(&self) -> Result<(), Failed> {
        self.set_true_value("ecc-x", 400.0)
    }

    /// Number of touches since the simulated machine was started.
    pub fn touch_count(&self) -> Result<u64, Failed> {
        Ok(halcmd(&["getp", "truth.touches"])?.parse()?)
    }

    /// Presses a button at the machine: `program.pause`, `machine.off` …
    pub fn press_button(&self, button: &str) -> Result<(), Failed> {
        halcmd(&["setp", &format!("halui.{button}"), "1"])?;
        sleep(Duration::from_millis(100));
        halcmd(&["setp", &format!("halui.{button}"), "0"]).map(drop)
    }

    /// Sets the feed override to 0 %.
    pub fn set_feed_override_zero(&self) -> Result<(), Failed> {
        halcmd(&["setp", "halui.feed-override.scale", "1"])?;
        self.press_button("feed-override.decrease")
    }

    /// Simulates an open guard: the axes hold without a message.
    pub fn set_feed_inhibit(&self, is_on: bool) -> Result<(), Failed> {
        halcmd(&["setp", "motion.feed-inhibit", if is_on { "1" } else { "0" }]).map(drop)
    }

    /// Reduces the travel of X at the control.
    pub fn set_x_max_limit_mm(&self, mm: f64) -> Result<(), Failed> {
        halcmd(&["setp", "ini.0.max_limit", &mm.to_string()])?;
        halcmd(&["setp", "ini.x.max_limit", &mm.to_string()]).map(drop)
    }

    /// Sends a signal to LinuxCNC's task: `-STOP`, `-CONT`, `-KILL`.
    pub fn signal_task(&self, signal: &str) -> Result<(), Failed> {
        send_signal(signal, &self.pid_of_task()?)
    }

    fn pid_of_task(&self) -> Result<String, Failed> {
        let arguments = ["-s", &self.session_id, "-r", "DRST", "-x", "milltask"];
        let task = Command::new("pgrep").args(arguments).output()?;
        Ok(String::from_utf8_lossy(&task.stdout).trim().to_owned())
    }

    /// Sends a signal to linuxcncrsh: `-STOP`, `-CONT`, `-KILL`.
    pub fn signal_linuxcncrsh(&self, signal: &str) -> Result<(), Failed> {
        send_signal(signal, std::fs::read_to_string(self.directory.join("rsh.pid"))?.trim())
    }

    /// Starts linuxcncrsh again.
    pub fn restart_linuxcncrsh(&self) -> Result<(), Failed> {
        send_signal("-USR1", &self.rig_process.id().to_string())?;
        for _ in 0..100 {
            sleep(Duration::from_millis(50));
            if self.connect_client().is_ok() {
                return Ok(());
            }
        }
        Err("linuxcncrsh does not come back".into())
    }

    /// Restarts LinuxCNC; it is homed then, and the truth is restored.
    pub fn restart(&mut self) -> Result<(), Failed> {
        drop(self.rig_process.stdin.take());
        self.rig_process.wait()?;
        *self = start_rig(Some(self.rsh_port), self.variant).map_err(|error| error.to_string())?;
        self.restore_start_state()
    }

    /// The INI file that LinuxCNC was started with.
    pub fn ini_path(&self) -> PathBuf {
        self.directory.join("rig.ini")
    }

    /// Waits until the machine is at rest; returns the joint positions.
    pub fn wait_for_rest(&self) -> Result<Vec<f64>, Failed> {
        let joints = || (0..5).map(|joint| self.joint_position(joint)).collect::<Result<Vec<_>, _>>();
        let mut last = joints()?;
        for _ in 0..100 {
            sleep(Duration::from_millis(200));
            let now = joints()?;
            if now == last {
                return Ok(now);
            }
            last = now;
        }
        Err("it does not come to rest".into())
    }

    /// Restores the state at the start of a trial, as an operator would. If that fails, LinuxCNC is restarted.
    pub fn restore_or_restart(&mut self) -> Result<(), Failed> {
        let _ = self.signal_linuxcncrsh("-CONT");
        if self.pid_of_task()?.is_empty() {
            return self.restart();
        }
        self.restore_start_state().or_else(|failed| {
            eprintln!("the rig starts anew: {}", failed.message().unwrap_or_default());
            self.restart()
        })
    }

    fn restore_start_state(&self) -> Result<(), Failed> {
        self.signal_task("-CONT")?;
        if self.connect_client().is_err() {
            self.restart_linuxcncrsh()?;
        }
        for (name, value) in TRUE_MACHINE_PINS {
            self.set_true_value(name, value)?;
        }
        self.set_x_max_limit_mm(X_LIMIT_MM)?;
        self.set_feed_inhibit(false)?;
        self.set_tool_centre_point_mode(false)?;
        self.enable_and_move_to_start()
    }

    /// Releases the stop, enables the machine and clears the part, as an operator does. Homing survives a stop.
    fn enable_and_move_to_start(&self) -> Result<(), Failed> {
        self.release_emergency_stop()?;
        let mut person = self.connect_client()?;
        person.repeat_until_status("estop", "OFF", &["set estop off"])?;
        person.repeat_until_status("machine", "ON", &["set machine on"])?;
        // While it is paused, LinuxCNC refuses an abort.
        person.repeat_until_status("program_status", "IDLE", &["set abort"])?;
        person.repeat_until_status("feed_override", "100", &["set feed_override 100"])?;
        for _ in 0..3 {
            person.run_mdi("G53 G0 Z200")?;
            person.run_mdi(&format!("G53 G0 X0 Y0 {}0 C0", self.variant.tilt))?;
            let mut off = 0.0_f64;
            for (joint, to) in [0.0, 0.0, 200.0, 0.0, 0.0].into_iter().enumerate() {
                off = off.max((self.joint_position(joint)? - to).abs());
            }
            if off < 1e-3 {
                return Ok(());
            }
        }
        Err("it does not go home".into())
    }

    pub fn connect_client(&self) -> Result<RshClient, Failed> {
        RshClient::connect(self.rsh_port)
    }
}
