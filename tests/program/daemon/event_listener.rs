//! A client that reads the event stream.

use std::io::{BufRead, BufReader, Write};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::http::{HttpClient, MACHINE_API_PATH};

const EVENT_TIMEOUT: Duration = Duration::from_secs(120);

/// Largest values that a listener has received.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReceivedEvents {
    pub run: u64,
    /// Number of measured steps of that run.
    pub measured: u64,
}

impl ReceivedEvents {
    fn add_state(&mut self, standing: &Value) {
        let number = |key: &str| standing[key].as_u64().unwrap();
        if number("run") > self.run {
            (self.run, self.measured) = (number("run"), 0);
        }
        if number("run") == self.run {
            self.measured = self.measured.max(number("measured"));
        }
    }
}

/// A client that reads the event stream.
pub struct Listener {
    heard: Arc<Mutex<ReceivedEvents>>,
    reader: JoinHandle<()>,
}

impl Listener {
    pub fn connect(http: HttpClient) -> Self {
        let mut stream = http.connect();
        write!(stream, "GET {MACHINE_API_PATH}/events HTTP/1.1\r\nHost: localhost:{}\r\n\r\n", http.port).unwrap();
        let heard = Arc::<Mutex<ReceivedEvents>>::default();
        let (lines, keeps) = (BufReader::new(stream), heard.clone());
        let reader = std::thread::spawn(move || {
            for line in lines.lines().map_while(Result::ok) {
                let Some(data) = line.strip_prefix("data: ") else { continue };
                let machine: Value = serde_json::from_str(data).unwrap();
                keeps.lock().unwrap().add_state(&machine);
            }
        });
        Self { heard, reader }
    }

    /// Waits until an event of this run has been received.
    pub fn wait_for_run(&self, run: u64) {
        let began = Instant::now();
        while self.heard.lock().unwrap().run < run {
            assert!(began.elapsed() < EVENT_TIMEOUT, "{:?}", self.heard.lock().unwrap());
            sleep(Duration::from_millis(10));
        }
    }

    /// The last values, after the connection has closed.
    pub fn end(self) -> ReceivedEvents {
        self.reader.join().unwrap();
        *self.heard.lock().unwrap()
    }
}
