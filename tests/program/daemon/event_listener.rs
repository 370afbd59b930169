//! A client that reads the event stream.

use std::io::{BufRead, BufReader, Write};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::http::{HttpClient, MACHINE_API_PATH};

const EVENT_TIMEOUT: Duration = Duration::from_secs(120);

/// The newest run that a listener has received, and its largest number of measured steps.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReceivedProgress {
    pub run_id: u64,
    /// Number of measured steps of that run.
    pub measured_step_count: u64,
}

impl ReceivedProgress {
    fn add_machine_state(&mut self, machine_state: &Value) {
        let number = |key: &str| machine_state[key].as_u64().unwrap();
        if number("run") > self.run_id {
            (self.run_id, self.measured_step_count) = (number("run"), 0);
        }
        if number("run") == self.run_id {
            self.measured_step_count = self.measured_step_count.max(number("measured"));
        }
    }
}

/// A client that reads the event stream.
pub struct EventListener {
    received_progress: Arc<Mutex<ReceivedProgress>>,
    reader: JoinHandle<()>,
}

impl EventListener {
    pub fn connect(http: HttpClient) -> Self {
        let mut stream = http.connect();
        write!(stream, "GET {MACHINE_API_PATH}/events HTTP/1.1\r\nHost: localhost:{}\r\n\r\n", http.port).unwrap();
        let heard = Arc::<Mutex<ReceivedProgress>>::default();
        let (lines, keeps) = (BufReader::new(stream), heard.clone());
        let reader = std::thread::spawn(move || {
            for line in lines.lines().map_while(Result::ok) {
                let Some(data) = line.strip_prefix("data: ") else { continue };
                let machine: Value = serde_json::from_str(data).unwrap();
                keeps.lock().unwrap().add_machine_state(&machine);
            }
        });
        Self { received_progress: heard, reader }
    }

    /// Waits until an event of this run has been received.
    pub fn wait_for_run(&self, run: u64) {
        let began = Instant::now();
        while self.received_progress.lock().unwrap().run_id < run {
            assert!(began.elapsed() < EVENT_TIMEOUT, "{:?}", self.received_progress.lock().unwrap());
            sleep(Duration::from_millis(10));
        }
    }

    /// The last values, after the connection has closed.
    pub fn wait_until_closed(self) -> ReceivedProgress {
        self.reader.join().unwrap();
        *self.received_progress.lock().unwrap()
    }
}
