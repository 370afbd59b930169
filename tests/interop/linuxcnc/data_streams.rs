//! Starts `tests/peers/linuxcnc/streams.py`, which sends positions, laser and sensor values beside LinuxCNC.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use libtest_mimic::Failed;

use super::rig::{LinuxCncRig, free_port};

/// Number of sensors around the datum cylinder.
const SENSOR_COUNT: usize = 3;

/// Streams of positions, laser and sensors, each on its own port, until dropped.
pub struct StreamsProcess {
    process: Child,
    stdout: BufReader<ChildStdout>,
    stdin: Option<ChildStdin>,
    pub position_port: u16,
    pub laser_port: u16,
    /// Serial ports of the sensors around the datum cylinder.
    pub sensor_serial_paths: Vec<String>,
}

impl StreamsProcess {
    pub fn start(rig: &LinuxCncRig) -> Result<Self, Failed> {
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
        let mut streams = Self {
            process,
            stdout: says,
            stdin: hears,
            position_port: positions,
            laser_port: laser,
            sensor_serial_paths: Vec::new(),
        };
        for _ in 0..SENSOR_COUNT {
            let said = streams.read_line()?;
            let device = said.strip_prefix("sensor ").ok_or_else(|| said.clone())?;
            streams.sensor_serial_paths.push(device.to_owned());
        }
        streams.expect_line("ready")?;
        Ok(streams)
    }

    /// Sets the additional delay of the laser.
    pub fn set_laser_delay_ms(&mut self, delay: f64) -> Result<(), Failed> {
        let said = format!("delay {delay}");
        let hears = self.stdin.as_mut().ok_or("it hears nothing")?;
        writeln!(hears, "{said}")?;
        self.expect_line(&said)
    }

    fn read_line(&mut self) -> Result<String, Failed> {
        let mut said = String::new();
        self.stdout.read_line(&mut said)?;
        Ok(said.trim().to_owned())
    }

    fn expect_line(&mut self, wanted: &str) -> Result<(), Failed> {
        let said = self.read_line()?;
        if said == wanted { Ok(()) } else { Err(format!("streams.py says {said:?}").into()) }
    }
}

impl Drop for StreamsProcess {
    fn drop(&mut self) {
        drop(self.stdin.take());
        drop(self.process.wait());
    }
}
