//! The script that acts as the sensor, in a separate process, and our driver for it.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;

use devices::sensors::serial::{SerialConfig, SerialDriver};
use link::SharedPorts;
use link::clock::HostClock;
use machine::record::sensor::Sensor;
use serde::de::DeserializeOwned;

pub const TEXT_LINE_KEYS: &str = r##"
[line]
end = "\r\n"
prefix = "#"
separator = " "
columns = 2
counter = { column = 1, round = 1000 }
value = { column = 2, scale_mm = 0.001, codes = [{ is = "ERR", means = "no-echo" }] }
"##;

pub const BYTE_FRAME_KEYS: &str = r#"
[frame]
sync = [0x7E, 0x81]
length = 5
counter = { byte = 0, width = 16, order = "little" }
checksum = { kind = "crc16-xmodem", order = "big" }
[frame.value]
byte = 2
width = 24
order = "big"
signed = true
scale_mm = 0.001
codes = [{ is = -8388608, means = "no-echo" }]
"#;

pub const PYTHON_COMMAND: &str = "python3";

pub struct PythonSensor {
    child: Child,
    stdin: ChildStdin,
    /// `None` while an answer is awaited.
    stdout: Option<BufReader<ChildStdout>>,
    pub pty_path: String,
}

impl PythonSensor {
    pub fn start(form: &str) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/sensor/sender.py");
        let mut child = Command::new(PYTHON_COMMAND)
            .arg(script)
            .arg(form)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let stdin = child.stdin.take().unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let mut path = String::new();
        stdout.read_line(&mut path).unwrap();
        Self { child, stdin, stdout: Some(stdout), pty_path: path.trim().to_owned() }
    }

    pub async fn open_driver(&self, keys: &str) -> SerialDriver {
        self.open_driver_with_timeout(0.3, keys).await
    }

    /// The driver with a timeout of 30 s.
    pub async fn open_driver_with_long_timeout(&self, keys: &str) -> SerialDriver {
        self.open_driver_with_timeout(30.0, keys).await
    }

    async fn open_driver_with_timeout(&self, timeout_s: f64, keys: &str) -> SerialDriver {
        let keys = format!("serial = \"{}\"\ntimeout_s = {timeout_s:?}\n{keys}", self.pty_path);
        let config: SerialConfig = toml::from_str(&keys).unwrap();
        let clock = Arc::new(HostClock::start());
        SerialDriver::open(config, &sensor_description(), clock, SharedPorts::default()).await.unwrap()
    }

    /// Sends a command and waits for its answer, which comes when it is done.
    pub async fn send_command<T: DeserializeOwned>(&mut self, command: &str) -> T {
        writeln!(self.stdin, "{command}").unwrap();
        let mut stdout = self.stdout.take().unwrap();
        let read = move || {
            let mut line = String::new();
            stdout.read_line(&mut line).unwrap();
            (line, stdout)
        };
        let (line, stdout) = tokio::task::spawn_blocking(read).await.unwrap();
        self.stdout = Some(stdout);
        serde_json::from_str(&line).unwrap()
    }
}

impl Drop for PythonSensor {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn sensor_description() -> Sensor {
    serde_json::from_value(serde_json::json!({
        "name": "laser", "zero_mm": [0, 0, -150], "direction": [0, 0, -1], "range_mm": [-10, 10]
    }))
    .unwrap()
}
