//! The rig `tests/peers/linuxcnc/rig`: started once for all trials, ends with this process.

use std::io::{BufRead, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use libtest_mimic::Failed;

/// What is true when a trial begins.
const TRUTH: [(&str, f64); 8] = [
    ("c-x", 0.050),
    ("c-y", -0.030),
    ("ecc-x", 0.120),
    ("ecc-y", -0.080),
    ("stylus-x", 0.0121),
    ("stylus-y", -0.0082),
    ("stuck", 0.0),
    ("dead", 0.0),
];

pub struct Rig {
    /// Its standard input is the rig's life line.
    _process: Child,
    /// Id of the session in which all of LinuxCNC runs.
    session: String,
    pub port: u16,
    pub directory: PathBuf,
}

/// The one rig, for one trial at a time; switched on, homed, the truth as it was.
pub fn rig() -> Result<MutexGuard<'static, Rig>, Failed> {
    static RIG: OnceLock<Result<Mutex<Rig>, String>> = OnceLock::new();
    let rig = RIG.get_or_init(|| start().map(Mutex::new).map_err(|error| error.to_string()));
    let rig = rig.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner);
    for (name, value) in TRUTH {
        rig.make_true(name, value)?;
    }
    rig.switch_on()?;
    Ok(rig)
}

fn start() -> Result<Rig, Box<dyn std::error::Error>> {
    let directory = std::env::temp_dir().join(format!("trued-rig-{}", std::process::id()));
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let mut process =
        Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/linuxcnc/rig"))
            .arg(&directory)
            .arg(port.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
    let mut said = String::new();
    BufReader::new(process.stdout.take().ok_or("no output")?).read_line(&mut said)?;
    let Some(session) = said.trim().strip_prefix("ready ").map(str::to_owned) else {
        return Err(format!("the rig does not start: see {}", directory.display()).into());
    };
    Ok(Rig { _process: process, session, port, directory })
}

fn halcmd(arguments: &[&str]) -> Result<String, Failed> {
    let output = Command::new("halcmd").arg("-s").args(arguments).output()?;
    if !output.status.success() {
        return Err(format!("halcmd {arguments:?}: {output:?}").into());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

impl Rig {
    /// Change the true machine; nobody who measures sees it.
    pub fn make_true(&self, name: &str, value: f64) -> Result<(), Failed> {
        halcmd(&["setp", &format!("truth.{name}"), &value.to_string()]).map(drop)
    }

    /// Where the machine really is, joint by joint.
    pub fn joint(&self, joint: usize) -> Result<f64, Failed> {
        Ok(halcmd(&["getp", &format!("joint.{joint}.pos-fb")])?.parse()?)
    }

    /// Somebody hits the emergency stop.
    pub fn emergency_stop(&self) -> Result<(), Failed> {
        halcmd(&["unlinkp", "iocontrol.0.emc-enable-in"])?;
        halcmd(&["setp", "iocontrol.0.emc-enable-in", "0"]).map(drop)
    }

    /// LinuxCNC's task hangs, or goes on.
    pub fn freeze(&self, frozen: bool) -> Result<(), Failed> {
        let task = Command::new("pgrep")
            .args(["-s", &self.session, "-r", "DRST", "-x", "milltask"])
            .output()?;
        let task = String::from_utf8_lossy(&task.stdout).trim().to_owned();
        let signal = if frozen { "-STOP" } else { "-CONT" };
        let done = Command::new("kill").args([signal, &task]).status()?.success();
        if done { Ok(()) } else { Err(format!("no milltask `{task}`").into()) }
    }

    /// A person releases the stop, switches on and clears the part. Homing survives a stop.
    fn switch_on(&self) -> Result<(), Failed> {
        halcmd(&["net", "estop", "iocontrol.0.emc-enable-in"])?;
        let mut person = self.person()?;
        // While it is stopped, it refuses an abort.
        for line in ["set estop off", "set machine on", "set abort"] {
            person.say(line)?;
        }
        person.mdi("G53 G0 Z200")?;
        person.mdi("G53 G0 X0 Y0 B0 C0")
    }

    pub fn person(&self) -> Result<Person, Failed> {
        let stream = TcpStream::connect(("127.0.0.1", self.port))?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(Duration::from_secs(5)))?;
        let mut person = Person(stream);
        for line in ["hello EMC person 1.0", "set echo off", "set verbose on", "set enable EMCTOO"]
        {
            person.say(line)?;
        }
        Ok(person)
    }
}

/// Somebody else at the control.
pub struct Person(TcpStream);

impl Person {
    pub fn say(&mut self, line: &str) -> Result<String, Failed> {
        self.0.write_all(format!("{line}\n").as_bytes())?;
        let mut answer = Vec::new();
        let mut byte = [0];
        while byte != *b"\n" || answer.iter().all(u8::is_ascii_whitespace) {
            self.0.read_exact(&mut byte)?;
            answer.push(byte[0]);
        }
        let answer = String::from_utf8_lossy(&answer).trim().to_owned();
        if answer.ends_with("NAK") { Err(format!("{line}: {answer}").into()) } else { Ok(answer) }
    }

    /// Enter a line by hand and wait until it is done.
    pub fn mdi(&mut self, line: &str) -> Result<(), Failed> {
        self.say("set mode mdi")?;
        self.say(&format!("set mdi {line}"))?;
        while !self.say("get program_status")?.contains("IDLE") {
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }
}
