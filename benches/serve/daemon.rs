//! Starts `trued serve` with a control at a TCP port, and sends HTTP requests to it.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::daemon_process::DaemonProcess;
use super::tape::{self, GrblExchange};

const SIMULATED_MACHINE_TOML: &str = include_str!("../../config/simulated.toml");
const SIMULATED_KIND_LINE: &str = "kind = \"simulated\"";
const MACHINE_API_PATH: &str = "/api/v1/machines/simulated%20five-axis%20machine";
const SERVE_SECTIONS_TOML: &str = "\n[method.self-calibration]\nmonte_carlo_trials = 1000\n[serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n";
const STATE_TIMEOUT: Duration = Duration::from_secs(120);

/// The simulated machine without `[serve]`.
fn machine_toml_without_serve() -> &'static str {
    SIMULATED_MACHINE_TOML.split("\n[serve]").next().unwrap_or(SIMULATED_MACHINE_TOML)
}

fn trued_command(arguments: &[&str], state: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.args(arguments).arg("--state").arg(state);
    command
}

/// Runs the method on the simulated control; returns its recorded exchanges.
pub fn record_exchanges() -> Vec<GrblExchange> {
    let folder = tempfile::tempdir().unwrap();
    let (machine, capture) = (folder.path().join("machine.toml"), folder.path().join("a.capture"));
    std::fs::write(&machine, format!("{}{SERVE_SECTIONS_TOML}", machine_toml_without_serve())).unwrap();
    let [machine, file] = [&machine, &capture].map(|path| path.display().to_string());
    let arguments = ["run", "self-calibration", "--machine", &machine, "--capture", &file];
    let ran = trued_command(&arguments, folder.path()).stderr(Stdio::null()).output().unwrap();
    assert!(ran.status.code().is_some_and(|code| code != 1 && code != 2), "{ran:?}");
    tape::grbl_exchanges(&std::fs::read_to_string(capture).unwrap())
}

pub struct Daemon {
    process: DaemonProcess,
    pub port: u16,
    _folder: tempfile::TempDir,
}

/// The machine file with `[controller]` and `[simulated]` replaced by the control at this port.
fn machine_toml_for_control(port: u16) -> String {
    let file = machine_toml_without_serve();
    let begin = file.find("\n[controller]").unwrap();
    let end = begin + 1 + file[begin + 1..].find("\n[").unwrap();
    let simulated = file.find("\n[simulated]").unwrap();
    let control = format!("\n[controller]\nkind = \"grbl\"\ntcp = \"127.0.0.1:{port}\"\ndialect = \"grbl-m19\"\n");
    assert!(file[begin..end].contains(SIMULATED_KIND_LINE) && end < simulated);
    format!("{}{control}{}{SERVE_SECTIONS_TOML}", &file[..begin], &file[end..simulated])
}

impl Daemon {
    /// Starts the daemon with the control at `control_port`; its journal is in `folder`.
    pub fn new(control_port: u16, folder: &Path) -> Self {
        let folder = tempfile::tempdir_in(folder).unwrap();
        let machine: PathBuf = folder.path().join("machine.toml");
        std::fs::write(&machine, machine_toml_for_control(control_port)).unwrap();
        let machine = machine.display().to_string();
        let mut command = trued_command(&["serve", "--machine", &machine], folder.path());
        let served = DaemonProcess::start(&mut command);
        Self { port: served.http_port(), process: served, _folder: folder }
    }

    pub fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Status and body of the response for `what` below the machine's path.
    pub fn send_machine_request(&self, method: &str, what: &str, body: &Value) -> (u16, Value) {
        self.send_request(method, &format!("{MACHINE_API_PATH}{what}"), body)
    }

    fn send_request(&self, method: &str, path: &str, body: &Value) -> (u16, Value) {
        let mut stream = TcpStream::connect(self.address()).unwrap();
        stream.set_nodelay(true).unwrap();
        let body = body.to_string();
        let request = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            self.address(),
            body.len()
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{answer}"));
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, serde_json::from_str(body).unwrap_or_default())
    }

    pub fn start_cycle(&self) {
        self.post_until_accepted(
            "/start",
            &json!({"cycle": 1, "who": "a", "enable": true, "auto": true, "door": true}),
        );
    }

    /// Sends a request, and repeats it as long as the answer is 429 (too many requests).
    pub fn post_until_accepted(&self, what: &str, body: &Value) {
        let mut answer = self.send_machine_request("POST", what, body);
        while answer.0 == 429 {
            sleep(Duration::from_millis(100));
            answer = self.send_machine_request("POST", what, body);
        }
        assert_eq!(answer.0, 202, "{}", answer.1);
    }

    /// Polls the machine's state until `is_reached` is true of it; returns that state.
    pub fn wait_until(&self, is_reached: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            let now = self.send_machine_request("GET", "", &json!({})).1;
            if is_reached(&now) {
                return now;
            }
            assert!(begun.elapsed() < STATE_TIMEOUT, "{now}");
            sleep(Duration::from_millis(50));
        }
    }

    /// The first step of each stage of the first run.
    pub fn first_steps_of_stages(&self) -> Vec<u32> {
        let plan = self.send_request("GET", "/api/v1/runs/1/plan", &json!({})).1;
        let steps = plan["steps"].as_array().expect("steps").iter();
        let mut steps: Vec<_> = steps.map(|step| (&step["stage"], &step["id"])).collect();
        steps.dedup_by_key(|(stage, _)| *stage);
        steps.iter().filter_map(|(_, id)| Some(id.as_u64()? as u32)).collect()
    }

    /// Processor time of the daemon, s.
    pub fn processor_time_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.process.child.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
        // utime and stime, in hundredths of a second.
        (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
    }
}

/// Path that a tablet requests after each event, as the page's script does.
pub const LIVE_PATH: &str = "/machines/simulated%20five-axis%20machine/live";
pub const EVENTS_PATH: &str = "/api/v1/machines/simulated%20five-axis%20machine/events";
