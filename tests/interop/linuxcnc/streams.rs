//! Data streams beside LinuxCNC: `tests/peers/linuxcnc/streams.py`.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use libtest_mimic::Failed;

use super::rig::{Rig, free_port};

/// Number of sensors around the datum cylinder.
const SENSORS: usize = 3;

/// Streams of positions, laser and sensors, each on its own port, until dropped.
pub struct Streams {
    process: Child,
    says: BufReader<ChildStdout>,
    hears: Option<ChildStdin>,
    pub positions: u16,
    pub laser: u16,
    /// Serial ports of the sensors around the datum cylinder.
    pub sensors: Vec<String>,
}

impl Streams {
    pub fn of(rig: &Rig) -> Result<Self, Failed> {
        let (positions, laser) = (free_port()?, free_port()?);
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/linuxcnc/streams.py");
        let mut process = Command::new("python3")
            .args([script, &positions.to_string(), &laser.to_string()])
            // The streams end with the rig in every case.
            .env("TRUED_RIG", &rig.directory)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let says = BufReader::new(process.stdout.take().ok_or("no output")?);
        let hears = process.stdin.take();
        let mut streams = Self { process, says, hears, positions, laser, sensors: Vec::new() };
        for _ in 0..SENSORS {
            let said = streams.line()?;
            let device = said.strip_prefix("sensor ").ok_or_else(|| said.clone())?;
            streams.sensors.push(device.to_owned());
        }
        streams.expect("ready")?;
        Ok(streams)
    }

    /// Sets the additional delay of the laser.
    pub fn delay_ms(&mut self, delay: f64) -> Result<(), Failed> {
        let said = format!("delay {delay}");
        let hears = self.hears.as_mut().ok_or("it hears nothing")?;
        writeln!(hears, "{said}")?;
        self.expect(&said)
    }

    fn line(&mut self) -> Result<String, Failed> {
        let mut said = String::new();
        self.says.read_line(&mut said)?;
        Ok(said.trim().to_owned())
    }

    fn expect(&mut self, wanted: &str) -> Result<(), Failed> {
        let said = self.line()?;
        if said == wanted { Ok(()) } else { Err(format!("streams.py says {said:?}").into()) }
    }
}

impl Drop for Streams {
    fn drop(&mut self) {
        drop(self.hears.take());
        drop(self.process.wait());
    }
}
