//! A second client of the control beside `trued`: enters lines, reads answers, and waits.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;

/// Timeout for a late control.
const PATIENCE: Duration = Duration::from_secs(30);

/// A second client of the control.
pub struct Person(TcpStream);

impl Person {
    /// Connects to the linuxcncrsh of this port.
    pub fn at(port: u16) -> Result<Self, Failed> {
        let stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let mut person = Self(stream);
        for line in ["hello EMC person 1.0", "set echo off", "set verbose on", "set enable EMCTOO"] {
            person.say(line)?;
        }
        Ok(person)
    }

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

    /// Sends `lines` until `get what` answers `wanted`: a late control drops commands.
    pub fn until(&mut self, what: &str, wanted: &str, lines: &[&str]) -> Result<(), Failed> {
        let started = Instant::now();
        let mut said = String::new();
        while started.elapsed() < PATIENCE {
            for line in lines {
                self.say(line)?;
            }
            for _ in 0..20 {
                said = self.say(&format!("get {what}"))?;
                if said.split_whitespace().last() == Some(wanted) {
                    return Ok(());
                }
                sleep(Duration::from_millis(50));
            }
        }
        Err(format!("after {PATIENCE:?} of {lines:?}: {said}").into())
    }

    /// Enters an MDI line and waits until it is done.
    pub fn mdi(&mut self, line: &str) -> Result<(), Failed> {
        self.say("set mode mdi")?;
        self.say(&format!("set mdi {line}"))?;
        let started = Instant::now();
        while !self.say("get program_status")?.contains("IDLE") {
            if started.elapsed() > PATIENCE {
                return Err(format!("{line} does not end").into());
            }
            sleep(Duration::from_millis(5));
        }
        Ok(())
    }
}
