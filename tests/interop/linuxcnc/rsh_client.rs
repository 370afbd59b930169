//! A client of linuxcncrsh beside `trued`: sends lines, reads answers, and waits.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;

/// Timeout for a late control.
const REPLY_TIMEOUT: Duration = Duration::from_secs(30);

/// A client of linuxcncrsh beside `trued`.
pub struct RshClient(TcpStream);

impl RshClient {
    /// Connects to the linuxcncrsh of this port.
    pub fn connect(port: u16) -> Result<Self, Failed> {
        let stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(REPLY_TIMEOUT))?;
        let mut person = Self(stream);
        for line in ["hello EMC person 1.0", "set echo off", "set verbose on", "set enable EMCTOO"] {
            person.send_line(line)?;
        }
        Ok(person)
    }

    pub fn send_line(&mut self, line: &str) -> Result<String, Failed> {
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

    /// Sends `lines` until `get` with `what` answers `wanted`: a late control drops commands.
    pub fn repeat_until_status(&mut self, what: &str, wanted: &str, lines: &[&str]) -> Result<(), Failed> {
        let started = Instant::now();
        let mut said = String::new();
        while started.elapsed() < REPLY_TIMEOUT {
            for line in lines {
                self.send_line(line)?;
            }
            for _ in 0..20 {
                said = self.send_line(&format!("get {what}"))?;
                if said.split_whitespace().last() == Some(wanted) {
                    return Ok(());
                }
                sleep(Duration::from_millis(50));
            }
        }
        Err(format!("after {REPLY_TIMEOUT:?} of {lines:?}: {said}").into())
    }

    /// Enters an MDI line and waits until it is done.
    pub fn run_mdi(&mut self, line: &str) -> Result<(), Failed> {
        self.send_line("set mode mdi")?;
        self.send_line(&format!("set mdi {line}"))?;
        let started = Instant::now();
        while !self.send_line("get program_status")?.contains("IDLE") {
            if started.elapsed() > REPLY_TIMEOUT {
                return Err(format!("{line} does not end").into());
            }
            sleep(Duration::from_millis(5));
        }
        Ok(())
    }
}
