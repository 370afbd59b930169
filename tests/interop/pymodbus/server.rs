//! A pymodbus server in a separate process, and our link to it.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use super::pymodbus::python_with_pymodbus;
use link::modbus::{
    AccessList, DeviceSettings, Framing, ModbusClient, ModbusError, ModbusLineConfig, RegisterRange, RegisterSpace,
};
use link::{HostPort, LinkConfig, Pty, create_pty};

/// Whether a write may have reached the device in spite of `error`.
pub fn write_may_have_arrived(error: &ModbusError) -> bool {
    use ModbusError as E;
    match error {
        E::Timeout { .. }
        | E::UnexpectedReply { .. }
        | E::ConnectionLost { .. }
        | E::ReadBackDiffers { .. }
        | E::ReadBackFailed { .. }
        | E::LinkThreadEnded { .. } => true,
        E::OpenFailed(_)
        | E::ExceptionReply { .. }
        | E::LineNotCleared { .. }
        | E::NotAllowed { .. }
        | E::HoldActive { .. } => false,
    }
}

pub fn peer_script_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/pymodbus").join(name)
}

pub struct PymodbusServer {
    child: Child,
    stdin: ChildStdin,
    stdout: BufReader<ChildStdout>,
    link_config: LinkConfig,
    /// Joins two pseudo-terminals: each side opens its own path.
    pty_bridge: Option<tokio::task::JoinHandle<()>>,
}

impl PymodbusServer {
    /// Call inside a tokio runtime.
    pub fn start(framing: Framing) -> Self {
        match framing {
            Framing::Tcp => {
                let mut server = Self::spawn(&["tcp"], LinkConfig::Tcp(HostPort::local(1)), None);
                let port = server.read_answer().parse().expect("a port");
                server.link_config = LinkConfig::Tcp(HostPort::local(port));
                server
            }
            Framing::Rtu => {
                let (mut ours, mut theirs) = (create_pty().unwrap(), create_pty().unwrap());
                let at = LinkConfig::Serial { path: ours.path.clone().into(), baud: 115_200 };
                let path = theirs.path.clone();
                let bridge = tokio::spawn(async move {
                    let (Pty { device: near, .. }, Pty { device: far, .. }) = (&mut ours, &mut theirs);
                    let _ = tokio::io::copy_bidirectional(near, far).await;
                });
                let mut server = Self::spawn(&["rtu", &path], at, Some(bridge));
                server.read_answer();
                server
            }
        }
    }

    fn spawn(arguments: &[&str], link_config: LinkConfig, bridge: Option<tokio::task::JoinHandle<()>>) -> Self {
        let mut child = Command::new(python_with_pymodbus().unwrap())
            .arg(peer_script_path("server.py"))
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let stdin = child.stdin.take().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        Self { child, stdin, stdout, link_config, pty_bridge: bridge }
    }

    pub fn link_config(&self) -> LinkConfig {
        self.link_config.clone()
    }

    fn read_answer(&mut self) -> String {
        let mut line = String::new();
        self.stdout.read_line(&mut line).unwrap();
        line.trim().to_owned()
    }

    fn send_command(&mut self, command: &str) -> String {
        writeln!(self.stdin, "{command}").unwrap();
        self.read_answer()
    }

    /// Sets the content of the registers.
    pub fn set_register_value(&mut self, value: u16) {
        assert_eq!(self.send_command(&format!("value {value}")), "true");
    }

    pub fn set_faults(&mut self, faults: &[&str]) {
        assert_eq!(self.send_command(&format!("faults {}", faults.join(" "))), "true");
    }

    pub fn received_writes(&mut self) -> Vec<(u16, Vec<u16>)> {
        serde_json::from_str(&self.send_command("writes")).unwrap()
    }

    /// Takes `count` measurements, one every `ms`.
    pub fn start_measurements(&mut self, ms: f64, count: u32) {
        assert_eq!(self.send_command(&format!("sense {ms} {count}")), "true");
    }

    /// Number of measurements so far.
    pub fn measurement_count(&mut self) -> u32 {
        self.send_command("sensed").parse().unwrap()
    }

    pub fn request_count(&mut self) -> u64 {
        self.send_command("requests").parse().unwrap()
    }

    pub async fn open_client(&self, timeout: Duration) -> ModbusClient {
        let all = |space| RegisterRange { space, first: 0, last: 99 };
        let allowed = AccessList {
            readable: vec![
                all(RegisterSpace::Input),
                all(RegisterSpace::Holding),
                RegisterRange { space: RegisterSpace::Coil, first: 0, last: 29 },
                RegisterRange { space: RegisterSpace::Discrete, first: 0, last: 29 },
            ],
            writable: vec![RegisterRange { space: RegisterSpace::Holding, first: 50, last: 99 }],
        };
        self.open_client_with_access(timeout, allowed).await
    }

    pub async fn open_client_with_access(&self, timeout: Duration, allowed: AccessList) -> ModbusClient {
        ModbusClient::open(
            ModbusLineConfig::with_defaults(self.link_config()),
            DeviceSettings { unit: 1, timeout, access_list: allowed },
        )
        .await
        .unwrap()
    }
}

impl Drop for PymodbusServer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if let Some(bridge) = &self.pty_bridge {
            bridge.abort();
        }
    }
}

/// Runs a trial on a separate runtime; the bridge needs a thread while the trial talks to the server.
pub fn block_on<T>(trial: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    runtime.block_on(trial)
}
