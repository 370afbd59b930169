//! The firmware as a machine: five axes, homed at their positive ends, soft limits enabled, and a probe whose
//! contact is computed from a truth file.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use tempfile::TempDir;

use super::recording_proxy::RecordingProxy;
use crate::linuxcnc::rig::free_port;
use crate::linuxcnc::run_workspace::RunWorkspace;

/// The table's centre in machine coordinates; the stylus ball relative to the spindle datum; the part of
/// `config/grblhal-sim.toml`, offset from its position in that file.
const TRUE_MACHINE_VALUES: [(&str, f64); 12] = [
    ("ox", -150.0),
    ("oy", -100.0),
    ("oz", -450.0),
    ("cx", 0.05),
    ("cy", -0.03),
    ("sB", -1.0),
    ("sC", -1.0),
    ("tz", -120.0),
    ("rball", 3.0),
    ("px", 0.2),
    ("py", -0.15),
    ("rad", 25.0),
];
/// Settings of the machine in `config/grblhal-sim.toml`. Homing: each axis at its current position ($22).
const GRBL_SETTINGS: &str = "$130=300 $131=200 $132=400 $110=9000 $111=9000 $112=9000 $113=3600 $114=7200 \
    $120=1000 $121=1000 $122=1000 $123=400 $124=400 $133=0 $134=0 $376=3 $22=35 $44=0 $45=0 $46=0 $47=0 $48=0 $20=1";
pub const MACHINE_FILE: &str = include_str!("../../../config/grblhal-sim.toml");
/// Timeout of the start; other trials may keep the computer busy meanwhile.
const REPLY_TIMEOUT: Duration = Duration::from_secs(60);
const START_PAUSE: Duration = Duration::from_millis(500);
const MAX_ATTEMPTS: u32 = 5;

pub fn firmware_path() -> PathBuf {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap_or(Path::new(""));
    target.join("peers/grblhal/grblHAL_sim")
}

pub struct GrblHalRig {
    firmware_process: Child,
    folder: TempDir,
    firmware_port: u16,
    pub proxy: RecordingProxy,
}

impl Drop for GrblHalRig {
    fn drop(&mut self) {
        let _ = self.firmware_process.kill();
        let _ = self.firmware_process.wait();
    }
}

impl GrblHalRig {
    /// A rig that has never been homed, with the settings of the machine; `truth` replaces values of `TRUE_MACHINE_VALUES`.
    pub fn start_not_homed(truth: &[(&str, f64)]) -> Result<Self, Failed> {
        let folder = TempDir::new()?;
        let all = TRUE_MACHINE_VALUES.iter().chain(&[("height", 100.0)]).chain(truth);
        let all: String = all.map(|(name, value)| format!("{name} {value}\n")).collect();
        std::fs::write(folder.path().join("truth"), all)?;
        let (process, port) = start_firmware(folder.path())?;
        let rig = Self { firmware_process: process, folder, firmware_port: port, proxy: RecordingProxy::start(port)? };
        rig.wait_until_firmware_answers()?;
        GRBL_SETTINGS.split_whitespace().try_for_each(|setting| rig.query(setting).map(drop))?;
        Ok(rig)
    }

    /// During its start the firmware reports an empty memory and loses received settings.
    fn wait_until_firmware_answers(&self) -> Result<(), Failed> {
        let started = Instant::now();
        while self.query_within("", START_PAUSE).is_err() {
            if started.elapsed() > REPLY_TIMEOUT {
                return Err("the firmware does not answer".into());
            }
        }
        Ok(())
    }

    pub fn start_homed(truth: &[(&str, f64)]) -> Result<Self, Failed> {
        let rig = Self::start_not_homed(truth)?;
        rig.home_axes()?;
        Ok(rig)
    }

    /// Moves the axes to their ends by commands at the control, and homes them there.
    pub fn home_axes(&self) -> Result<(), Failed> {
        self.query("$X")?;
        for line in ["$20=0", "G21 G90 G94 G53 G0 Z0", "G53 G0 X0 Y0 B0 C0", "G4 P0", "$20=1", "$H"] {
            self.query(line)?;
        }
        Ok(())
    }

    /// Sends a line at the control itself while no other client is connected; returns the answer. The first byte of
    /// a client may be lost; the line is then not a command and is sent again.
    pub fn query(&self, line: &str) -> Result<String, Failed> {
        let mut answer = self.query_within(line, REPLY_TIMEOUT);
        for _ in 1..MAX_ATTEMPTS {
            if answer.is_ok() {
                break;
            }
            answer = self.query_within(line, REPLY_TIMEOUT);
        }
        answer
    }

    fn query_within(&self, line: &str, timeout: Duration) -> Result<String, Failed> {
        let mut wire = TcpStream::connect(("127.0.0.1", self.firmware_port))?;
        wire.set_read_timeout(Some(Duration::from_millis(100)))?;
        writeln!(wire, "{line}")?;
        let (started, mut answer, mut bytes) = (Instant::now(), String::new(), [0; 4096]);
        while started.elapsed() < timeout {
            match wire.read(&mut bytes) {
                Ok(count) => answer += &String::from_utf8_lossy(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
            if answer.lines().any(|line| line == "ok") && answer.ends_with('\n') {
                return Ok(answer);
            }
            if answer.contains("error:") {
                break;
            }
        }
        Err(format!("the firmware answers `{line}` by `{answer}`").into())
    }

    /// Sends `bytes` once, then `?` until the replies contain `done`. No other client may be connected.
    pub fn send_bytes_until_reported(&self, bytes: &[u8], done: &str) -> Result<(), Failed> {
        let mut wire = TcpStream::connect(("127.0.0.1", self.firmware_port))?;
        wire.set_read_timeout(Some(Duration::from_millis(100)))?;
        wire.write_all(bytes)?;
        let (started, mut answer, mut bytes) = (Instant::now(), String::new(), [0; 4096]);
        while !answer.contains(done) {
            if started.elapsed() > REPLY_TIMEOUT {
                return Err(format!("the firmware says {answer:?}, and not {done}").into());
            }
            wire.write_all(b"?")?;
            match wire.read(&mut bytes) {
                Ok(count) => answer += &String::from_utf8_lossy(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Sends Ctrl-X at the control.
    pub fn soft_reset(&self) -> Result<(), Failed> {
        self.send_bytes_until_reported(b"\x18", "GrblHAL")
    }

    /// Presses or releases a button at the machine: `h` feed hold, `r` reset; `p` deflects the stylus.
    pub fn press_button(&mut self, button: char) -> Result<(), Failed> {
        let buttons = self.firmware_process.stdin.as_mut().ok_or("no buttons")?;
        write!(buttons, "{button}")?;
        buttons.flush()?;
        sleep(Duration::from_millis(200));
        Ok(())
    }

    pub fn kill_firmware(&mut self) -> Result<(), Failed> {
        self.firmware_process.kill()?;
        self.firmware_process.wait()?;
        Ok(())
    }

    /// Restarts the firmware with its stored settings; it is then at machine zero.
    pub fn restart_firmware(&mut self) -> Result<(), Failed> {
        self.kill_firmware()?;
        (self.firmware_process, self.firmware_port) = start_firmware(self.folder.path())?;
        self.proxy.set_firmware_port(self.firmware_port);
        self.wait_until_firmware_answers()
    }

    /// A workspace with the machine file of this rig, with some of its text replaced.
    pub fn create_run_workspace(&self, changes: &[(&str, &str)]) -> Result<RunWorkspace, Failed> {
        let address = format!("127.0.0.1:{}", self.proxy.listen_port);
        let changes: Vec<_> = changes.iter().copied().chain([("127.0.0.1:7001", &*address)]).collect();
        RunWorkspace::with_changed_machine_file(MACHINE_FILE, &changes)
    }

    /// Waits until this many measuring touches (at 120 mm/min) have begun since the last call of `clear_record`, while
    /// `run` continues.
    pub fn wait_for_touches(&self, touches: usize, run: &mut Child) -> Result<(), Failed> {
        let measuring = |line: &&String| line.contains("G38.3") && line.ends_with("F120.000");
        while self.proxy.sent_lines().iter().filter(measuring).count() < touches {
            if run.try_wait()?.is_some() {
                return Err(format!("the run ended before {touches} touches").into());
            }
            sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

/// Starts the firmware and waits until it listens; returns its port. A client that connects while its threads start
/// may end it; it is then started again.
fn start_firmware(folder: &Path) -> Result<(Child, u16), Failed> {
    for _ in 0..MAX_ATTEMPTS {
        let port = free_port().map_err(|error| error.to_string())?;
        let mut process = Command::new(firmware_path())
            .args(["-n", "-t", "1", "-p", &port.to_string(), "-e"])
            .arg(folder.join("eeprom"))
            .env("TRUTH", folder.join("truth"))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        sleep(START_PAUSE);
        let started = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() && started.elapsed() < REPLY_TIMEOUT {
            sleep(Duration::from_millis(20));
        }
        sleep(START_PAUSE);
        if process.try_wait()?.is_none() {
            return Ok((process, port));
        }
    }
    Err("the firmware ends while it starts".into())
}
