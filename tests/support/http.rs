//! A client of the daemon's HTTP interface, over plain sockets.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// `[serve.http]` of a machine file.
pub const HTTP_SECTION: &str = "[serve.http]\nlisten = \"127.0.0.1:0\"\n";
/// The built-in machine's resource.
pub const MACHINE_API_PATH: &str = "/api/v1/machines/simulated%20five-axis%20machine";
pub const JSON_HEADER: &str = "Content-Type: application/json\r\n";
pub const FORM_HEADER: &str = "Content-Type: application/x-www-form-urlencoded\r\n";
/// Maximum time of each wait: generous, because the computer may be busy.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(300);

#[derive(Debug, Clone, Copy)]
pub struct HttpClient {
    pub port: u16,
}

impl HttpClient {
    pub fn new(port: u16) -> Self {
        Self { port }
    }

    pub fn connect(self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(RESPONSE_TIMEOUT)).unwrap();
        stream
    }

    /// Returns status and body of the response. `headers`: lines with their line ends; `Host` is added if it is
    /// missing.
    pub fn request(self, method: &str, path: &str, headers: &str, body: &str) -> (u16, String) {
        self.try_request(method, path, headers, body).unwrap()
    }

    /// As [`Self::request`]; the error is that of the connection.
    pub fn try_request(self, method: &str, path: &str, headers: &str, body: &str) -> io::Result<(u16, String)> {
        let mut stream = self.connect();
        let host = match headers.contains("Host:") {
            true => String::new(),
            false => format!("Host: localhost:{}\r\n", self.port),
        };
        let length = body.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\n{host}{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )?;
        let mut response = String::new();
        if stream.read_to_string(&mut response)? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let status = response.split(' ').nth(1).unwrap().parse().unwrap();
        Ok((status, response.split_once("\r\n\r\n").unwrap().1.to_owned()))
    }

    pub fn get_text(self, path: &str) -> String {
        let (status, body) = self.request("GET", path, "", "");
        assert_eq!(status, 200, "{path}: {body}");
        body
    }

    pub fn get_json(self, path: &str) -> Value {
        serde_json::from_str(&self.get_text(path)).unwrap()
    }

    pub fn post_json(self, path: &str, body: &Value) -> (u16, Value) {
        let (status, body) = self.request("POST", path, JSON_HEADER, &body.to_string());
        (status, serde_json::from_str(&body).unwrap_or_else(|_| panic!("{body}")))
    }

    /// Posts `body` to `action` of the built-in machine.
    pub fn post_action(self, action: &str, body: &Value) -> (u16, Value) {
        self.post_json(&format!("{MACHINE_API_PATH}/{action}"), body)
    }

    /// Status of the response to a start of `cycle`.
    pub fn start_cycle(self, cycle: u16) -> u16 {
        self.post_action("start", &start_request_body_of_cycle(cycle)).0
    }

    /// The built-in machine as the daemon reports it.
    pub fn machine_state(self) -> Value {
        self.get_json(MACHINE_API_PATH)
    }

    pub fn wait_until_machine_state(self, is_reached: impl Fn(&Value) -> bool) -> Value {
        let started = Instant::now();
        loop {
            let machine = self.machine_state();
            if is_reached(&machine) {
                return machine;
            }
            assert!(started.elapsed() < RESPONSE_TIMEOUT, "{machine}");
            sleep(Duration::from_millis(20));
        }
    }

    pub fn wait_for_state(self, state: &str) -> Value {
        self.wait_until_machine_state(|machine| machine["state"] == state)
    }
}

/// A start of cycle 1 with all confirmations.
pub fn start_request_body() -> Value {
    start_request_body_of_cycle(1)
}

fn start_request_body_of_cycle(cycle: u16) -> Value {
    json!({"cycle": cycle, "who": "Ada", "enable": true, "auto": true, "door": true})
}

/// Status and error code of a response.
pub fn status_and_error_code(response: &(u16, Value)) -> (u16, &str) {
    (response.0, response.1["code"].as_str().unwrap_or(""))
}
