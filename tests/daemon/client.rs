//! The interface, asked over plain sockets.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

const MACHINE: &str = "/api/v1/machines/simulated%20five-axis%20machine";
const PATIENCE: Duration = Duration::from_secs(120);

#[derive(Clone, Copy)]
pub struct Client {
    pub port: u16,
}

impl Client {
    fn connect(self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    fn ask(self, request: &str, body: &str) -> (u16, String) {
        let (port, length) = (self.port, body.len());
        let mut stream = self.connect();
        write!(
            stream,
            "{request} HTTP/1.1\r\nHost: localhost:{port}\r\nContent-Type: application/json\r\n\
             Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        (status, answer.split_once("\r\n\r\n").unwrap().1.to_owned())
    }

    pub fn text(self, path: &str) -> String {
        let (status, body) = self.ask(&format!("GET {path}"), "");
        assert_eq!(status, 200, "{path}: {body}");
        body
    }

    pub fn get(self, path: &str) -> Value {
        serde_json::from_str(&self.text(path)).unwrap()
    }

    /// The status of the answer.
    pub fn post(self, what: &str, body: &Value) -> u16 {
        self.ask(&format!("POST {MACHINE}/{what}"), &body.to_string()).0
    }

    pub fn start(self, cycle: u16) -> u16 {
        let vouched =
            json!({"cycle": cycle, "who": "Ada", "enable": true, "auto": true, "door": true});
        self.post("start", &vouched)
    }

    pub fn standing(self) -> Value {
        self.get(MACHINE)
    }

    pub fn until(self, right: impl Fn(&Value) -> bool) -> Value {
        let started = Instant::now();
        loop {
            let standing = self.standing();
            if right(&standing) {
                return standing;
            }
            assert!(started.elapsed() < PATIENCE, "{standing}");
            sleep(Duration::from_millis(10));
        }
    }

    pub fn until_state(self, state: &str) -> Value {
        self.until(|standing| standing["state"] == state)
    }

    pub fn listens(self) -> Listener {
        let mut stream = self.connect();
        let port = self.port;
        write!(stream, "GET {MACHINE}/events HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n").unwrap();
        let heard = Arc::<Mutex<Heard>>::default();
        let (lines, keeps) = (BufReader::new(stream), heard.clone());
        let reader = std::thread::spawn(move || {
            for line in lines.lines().map_while(Result::ok) {
                let Some(told) = line.strip_prefix("data: ") else { continue };
                let standing: Value = serde_json::from_str(told).unwrap();
                keeps.lock().unwrap().takes(&standing);
            }
        });
        Listener { heard, reader }
    }
}

/// What a listener was told at most.
#[derive(Debug, Clone, Copy, Default)]
pub struct Heard {
    pub run: u64,
    /// Of that run.
    pub measured: u64,
}

impl Heard {
    fn takes(&mut self, standing: &Value) {
        let number = |key: &str| standing[key].as_u64().unwrap();
        if number("run") > self.run {
            (self.run, self.measured) = (number("run"), 0);
        }
        if number("run") == self.run {
            self.measured = self.measured.max(number("measured"));
        }
    }
}

/// Somebody who reads the events.
pub struct Listener {
    heard: Arc<Mutex<Heard>>,
    reader: JoinHandle<()>,
}

impl Listener {
    /// Sooner or later.
    pub fn has_heard_of(&self, run: u64) {
        let began = Instant::now();
        while self.heard.lock().unwrap().run < run {
            assert!(began.elapsed() < PATIENCE, "{:?}", self.heard.lock().unwrap());
            sleep(Duration::from_millis(10));
        }
    }

    /// Everything that came, once the other end is gone.
    pub fn end(self) -> Heard {
        self.reader.join().unwrap();
        *self.heard.lock().unwrap()
    }
}
