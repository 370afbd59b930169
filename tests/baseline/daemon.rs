//! `trued serve`: the description of its HTTP interface, some answers, and its Modbus registers.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};

use super::compare::{check_json_against_baseline, check_text_against_baseline};
use super::method_cases::SIMULATED_MACHINE_FILE;
use super::normalise::{replace_hashes, replace_timestamps};
use super::workspace::Workspace;
use crate::support::daemon_process::DaemonProcess;

const MACHINE_API_PATH: &str = "/api/v1/machines/simulated%20five-axis%20machine";
/// Timeout; a cycle takes a second.
const DAEMON_TIMEOUT: Duration = Duration::from_secs(60);

/// The built-in machine with HTTP, Modbus and one cycle.
const SERVE_CONFIG_SECTIONS: &str = "[method.self-calibration]\nmonte_carlo_trials = 1000\n\
                     [method.latch-delay]\ntouches = 6\n\
                     [tolerance]\nEX0C_um = 500.0\nEY0C_um = 500.0\n\
                     [serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"latch-delay\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n\
                     [serve.modbus]\nlisten = \"127.0.0.1:0\"\nallow = [\"127.0.0.1\"]\n";

fn served_workspace() -> Workspace {
    let (machine, _) = SIMULATED_MACHINE_FILE.split_once("\n[serve]").unwrap();
    Workspace::with_machine_file(&format!("{machine}\n{SERVE_CONFIG_SECTIONS}"))
}

fn start_daemon(workspace: &Workspace) -> DaemonProcess {
    let machine = workspace.file_path("machine.toml");
    DaemonProcess::start(&mut workspace.trued_command(&["serve", "--machine", &machine]))
}

/// Status, content type and body.
struct HttpAnswer {
    status: u16,
    content_type: String,
    body: String,
}

impl HttpAnswer {
    fn request(daemon: &DaemonProcess, path: &str, body: Option<&Value>) -> Self {
        let config = ureq::Agent::config_builder().http_status_as_error(false).max_redirects(0);
        let agent = config.max_redirects_will_error(false).build().new_agent();
        let url = format!("http://127.0.0.1:{}{path}", daemon.http_port());
        let answer = match body {
            Some(body) => agent.post(&url).send_json(body),
            None => agent.get(&url).call(),
        };
        let mut answer = answer.unwrap();
        let content_type = answer.headers().get("content-type");
        Self {
            status: answer.status().as_u16(),
            content_type: content_type.map_or(String::new(), |it| it.to_str().unwrap().to_owned()),
            body: answer.body_mut().read_to_string().unwrap(),
        }
    }

    /// Status, content type and body as JSON, without the body's times and hashes.
    fn normalised_json(&self) -> Value {
        let body = replace_hashes(&replace_timestamps(&self.body));
        let body = serde_json::from_str(&body).unwrap_or(Value::String(body));
        json!({"status": self.status, "content_type": self.content_type, "body": body})
    }
}

fn get_json(daemon: &DaemonProcess, path: &str) -> Value {
    serde_json::from_str(&HttpAnswer::request(daemon, path, None).body).unwrap()
}

pub fn check_openapi_description() {
    let workspace = served_workspace();
    let daemon = start_daemon(&workspace);
    check_json_against_baseline("http/openapi.json", &get_json(&daemon, "/api/v1/openapi.json"));
}

/// Answers of a daemon with two finished runs in its journal, before and after a cycle of its own.
pub fn check_http_answers() {
    let workspace = served_workspace();
    let machine = workspace.file_path("machine.toml");
    for _ in 0..2 {
        workspace.run_stdout(&["run", "self-calibration", "--machine", &machine, "--json"]);
    }
    let daemon = start_daemon(&workspace);
    let mut answers = Map::new();
    let mut record = |name: String, answer: HttpAnswer| {
        answers.insert(name, answer.normalised_json());
    };
    let of_machine = ["", "/schedule", "/trends"].map(|path| format!("{MACHINE_API_PATH}{path}"));
    let others = [
        "/",
        "/api/v1/machines",
        "/api/v1/machines/none",
        "/api/v1/runs",
        "/api/v1/runs?limit=1",
        "/api/v1/runs/1",
        "/api/v1/runs/1/estimate",
        "/api/v1/runs/1/readings?after=60&limit=2",
        "/api/v1/runs/99",
        "/api/v1/runs?wrong=1",
        "/api/v1/compare?a=1&b=2",
        "/api/v1/nothing",
    ];
    for path in of_machine.iter().map(String::as_str).chain(others) {
        record(format!("GET {path}"), HttpAnswer::request(&daemon, path, None));
    }
    let metrics = HttpAnswer::request(&daemon, "/metrics", None);
    let path = format!("{MACHINE_API_PATH}/start");
    let confirmed = json!({"cycle": 1, "who": "Ada", "enable": true, "auto": true, "door": true});
    let bodies = [
        json!({"cycle": 1, "who": "Ada"}),
        json!({"cycle": 1, "who": " ", "enable": true, "auto": true, "door": true}),
        json!({"cycle": 7, "who": "Ada", "enable": true, "auto": true, "door": true}),
        json!({"cycle": 1, "who": "Ada", "unknown": true}),
    ];
    for body in bodies {
        record(format!("POST {path} {body}"), HttpAnswer::request(&daemon, &path, Some(&body)));
    }
    let started = HttpAnswer::request(&daemon, &path, Some(&confirmed));
    assert_eq!(started.status, 202, "{}", started.body);
    wait_for_end_of_run(&daemon);
    for path in [MACHINE_API_PATH, "/api/v1/audit"] {
        record(format!("GET {path} after a cycle"), HttpAnswer::request(&daemon, path, None));
    }
    check_json_against_baseline("http/answers.json", &Value::Object(answers));
    check_text_against_baseline("http/metrics.txt", &metric_names_and_labels(&metrics.body));
}

/// Waits until the machine is idle again and the result of its run has been read from the journal, which happens
/// later.
fn wait_for_end_of_run(daemon: &DaemonProcess) {
    let begun = Instant::now();
    loop {
        let machine = get_json(daemon, MACHINE_API_PATH);
        let run = &machine["run"];
        if machine["state"] == "waiting" && *run != 0 && machine["result"]["run"] == *run {
            return;
        }
        assert!(begun.elapsed() < DAEMON_TIMEOUT, "{machine}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Names, labels and comments, sorted, because the order of labels changes. Values are omitted: they are counts and
/// seconds of this process.
fn metric_names_and_labels(text: &str) -> String {
    let name = |line: &str| match line.rsplit_once(' ') {
        Some((name, _)) if !line.starts_with('#') => format!("{name}\n"),
        _ => format!("{line}\n"),
    };
    let mut names: Vec<String> = text.lines().map(name).collect();
    names.sort();
    names.concat()
}

/// Reads every address of docs/modbus.md and the neighbouring ones by hand-written requests, from an idle daemon
/// and after a cycle.
pub fn check_modbus_registers() {
    let workspace = served_workspace();
    let daemon = start_daemon(&workspace);
    let mut client = ModbusTcpClient::connect(daemon.modbus_port());
    let waiting = client.dump_register_map();
    let confirmed = json!({"cycle": 1, "who": "Ada", "enable": true, "auto": true, "door": true});
    let started = HttpAnswer::request(&daemon, &format!("{MACHINE_API_PATH}/start"), Some(&confirmed));
    assert_eq!(started.status, 202, "{}", started.body);
    wait_for_end_of_run(&daemon);
    let after = client.dump_register_map();
    check_text_against_baseline("modbus/registers.txt", &format!("waiting\n{waiting}\nafter a cycle\n{after}"));
}

struct ModbusTcpClient {
    stream: TcpStream,
}

const READ_COILS_FUNCTION: u8 = 1;
const READ_HOLDING_FUNCTION: u8 = 3;
const READ_INPUT_FUNCTION: u8 = 4;

impl ModbusTcpClient {
    fn connect(port: u16) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(DAEMON_TIMEOUT)).unwrap();
        Self { stream }
    }

    /// Function and data of the reply to a request.
    fn request(&mut self, function: u8, data: &[u8]) -> (u8, Vec<u8>) {
        const TRANSACTION_ID: u8 = 0x2A;
        const UNIT_ID: u8 = 1;
        let length = u8::try_from(data.len() + 2).unwrap();
        let head = [0, TRANSACTION_ID, 0, 0, 0, length, UNIT_ID, function];
        self.stream.write_all(&[&head[..], data].concat()).unwrap();
        let mut head = [0; 8];
        self.stream.read_exact(&mut head).unwrap();
        assert_eq!((head[1], head[6]), (TRANSACTION_ID, UNIT_ID));
        let mut data = vec![0; usize::from(head[5]) - 2];
        self.stream.read_exact(&mut data).unwrap();
        (head[7], data)
    }

    /// Formats the reply as a line; with `zeroes_first_register`, the first register, a heartbeat, is written as 0.
    fn read_block_as_text(&mut self, function: u8, address: u16, count: u16, zeroes_first_register: bool) -> String {
        let request = [address.to_be_bytes(), count.to_be_bytes()].concat();
        let (reply, mut data) = self.request(function, &request);
        if zeroes_first_register && reply == function {
            data[1..3].fill(0);
        }
        let data: Vec<String> = data.iter().map(|byte| byte.to_string()).collect();
        format!("function {function} {address}+{count}: {reply} {}\n", data.join(" "))
    }

    fn dump_register_map(&mut self) -> String {
        let reads = [
            (READ_INPUT_FUNCTION, 0, 16),
            (READ_INPUT_FUNCTION, 100, 120),
            (READ_INPUT_FUNCTION, 16, 1),
            (READ_INPUT_FUNCTION, 99, 1),
            (READ_INPUT_FUNCTION, 220, 1),
            (READ_INPUT_FUNCTION, 0, 0),
            (READ_COILS_FUNCTION, 0, 9),
            (READ_COILS_FUNCTION, 11, 8),
            (READ_COILS_FUNCTION, 9, 1),
            (READ_COILS_FUNCTION, 10, 1),
            (READ_COILS_FUNCTION, 19, 1),
            (READ_HOLDING_FUNCTION, 0, 1),
            (READ_HOLDING_FUNCTION, 1, 1),
            (2, 0, 1),
            (7, 0, 0),
        ];
        let lines = reads.map(|(function, address, count)| {
            self.read_block_as_text(function, address, count, (function, address) == (READ_INPUT_FUNCTION, 0))
        });
        lines.concat()
    }
}
