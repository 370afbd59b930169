//! Controls a pymodbus client in a separate process.

use crate::support::pymodbus::python_with_pymodbus;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Addresses of input registers, written here independently, from docs/modbus.md.
pub const STATE_REGISTER: usize = 1;
pub const PROGRESS_REGISTER: usize = 2;
pub const VERDICT_REGISTER: usize = 3;
pub const RUN_NUMBER_REGISTER: usize = 6;
pub const ACCEPTED_COUNT_REGISTER: usize = 7;
pub const REFUSED_COUNT_REGISTER: usize = 8;
pub const REFUSAL_REASON_REGISTER: usize = 9;
const STATUS_TIMEOUT: Duration = Duration::from_secs(300);

pub struct PymodbusClient {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    heartbeat_count: u16,
}

impl Drop for PymodbusClient {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl PymodbusClient {
    pub fn new(port: u16) -> Self {
        Self::connect_from(port, "127.0.0.1")
    }

    pub fn connect_from(port: u16, address: &str) -> Self {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/pymodbus/client.py");
        let mut command = Command::new(python_with_pymodbus().unwrap());
        command.args([script, &port.to_string(), address]);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let requests = child.stdin.take().unwrap();
        let answers = BufReader::new(child.stdout.take().unwrap());
        let mut client = Self { child, requests, answers, heartbeat_count: 0 };
        assert_eq!(client.read_answer(), "ok", "no connection");
        client
    }

    fn read_answer(&mut self) -> String {
        let mut line = String::new();
        self.answers.read_line(&mut line).unwrap();
        line.trim().to_owned()
    }

    pub fn request(&mut self, request: &str) -> String {
        writeln!(self.requests, "{request}").unwrap();
        self.read_answer()
    }

    pub fn request_registers(&mut self, request: &str) -> Vec<u16> {
        let said = self.request(request);
        let numbers = said.split_whitespace().map(str::parse).collect::<Result<_, _>>();
        numbers.unwrap_or_else(|_| panic!("{request}: {said}"))
    }

    /// Reads the first registers and updates the heartbeat.
    pub fn update_heartbeat_and_read_status(&mut self) -> Vec<u16> {
        self.heartbeat_count = self.heartbeat_count.wrapping_add(1);
        let beat = self.heartbeat_count;
        assert_eq!(self.request(&format!("register 0 {beat}")), "ok");
        self.request_registers("input 0 16")
    }

    /// Waits until the registers satisfy `right`; returns all values that were read.
    pub fn poll_status_until(&mut self, right: impl Fn(&[u16]) -> bool) -> Vec<Vec<u16>> {
        let (started, mut seen) = (Instant::now(), Vec::new());
        loop {
            seen.push(self.update_heartbeat_and_read_status());
            if right(seen.last().unwrap()) {
                return seen;
            }
            assert!(started.elapsed() < STATUS_TIMEOUT, "{:?}", seen.last());
            sleep(Duration::from_millis(20));
        }
    }

    /// Sets key, automatic mode and door to their enabling states, with no button pressed, and updates the
    /// heartbeat.
    pub fn set_enabling_inputs(&mut self) {
        assert_eq!(self.request("coils 0 1 1 1 0 0"), "ok");
        assert_eq!(self.request("coils 11 0 0 0 0 0 0 0 0"), "ok");
        self.poll_status_until(|status| status[10] == 0b1111);
        sleep(Duration::from_millis(60));
    }

    /// Presses and releases a button.
    pub fn press_coil(&mut self, coil: u16) {
        assert_eq!(self.request(&format!("coil {coil} 1")), "ok");
        assert_eq!(self.request(&format!("coil {coil} 0")), "ok");
        sleep(Duration::from_millis(60));
    }

    /// Presses a start that must be refused; returns the reason.
    pub fn press_refused_coil(&mut self, coil: u16) -> u16 {
        let before = self.update_heartbeat_and_read_status();
        self.press_coil(coil);
        let after = self.update_heartbeat_and_read_status();
        assert_eq!(after[REFUSED_COUNT_REGISTER], before[REFUSED_COUNT_REGISTER] + 1, "{after:?}");
        assert_eq!(after[ACCEPTED_COUNT_REGISTER], before[ACCEPTED_COUNT_REGISTER], "{after:?}");
        after[REFUSAL_REASON_REGISTER]
    }
}
