//! The other end of the wire: a grbl control over TCP that plays prepared answers, computes nothing, and keeps
//! when it got what.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use super::tape::Exchange;

#[derive(Default)]
pub struct Seen {
    /// When a hold was there.
    pub holds: Vec<Instant>,
    /// From the answer that ended a step to the first line of the next: reading, journal, next block.
    pub between: Vec<Duration>,
}

pub struct Wire {
    pub port: u16,
    pub seen: Arc<Mutex<Seen>>,
}

impl Wire {
    /// `takes`: the first move of each step.
    pub fn new(tape: Vec<Exchange>, takes: Duration) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let seen = Arc::new(Mutex::new(Seen::default()));
        let all = Arc::clone(&seen);
        thread::spawn(move || {
            for stream in listener.incoming() {
                let control = Control { tape: tape.clone(), takes, seen: Arc::clone(&all) };
                thread::spawn(move || control.serve(stream.unwrap()));
            }
        });
        Self { port, seen }
    }
}

struct Control {
    tape: Vec<Exchange>,
    takes: Duration,
    seen: Arc<Mutex<Seen>>,
}

/// The number of the step that a line belongs to.
fn step(line: &[u8]) -> Option<u32> {
    let text = std::str::from_utf8(line).ok()?;
    text.strip_prefix('N')?.split(' ').next()?.parse().ok()
}

impl Control {
    fn serve(self, mut stream: TcpStream) {
        stream.set_nodelay(true).unwrap();
        let (mut at, mut line, mut buffer, mut held) = (0, Vec::new(), [0; 4096], false);
        let mut known: Option<u32> = None;
        // When the last two answers were given.
        let mut answered = [Instant::now(); 2];
        if stream.write_all(&self.tape[0].replies).is_err() {
            return;
        }
        while let Ok(count @ 1..) = stream.read(&mut buffer) {
            let came = Instant::now();
            let mut said = Vec::new();
            for byte in &buffer[..count] {
                match byte {
                    b'!' => {
                        held = true;
                        self.seen.lock().unwrap().holds.push(came);
                    }
                    b'?' => said.extend(report(&self.tape[at], held)),
                    0x18 | 0x80.. => {}
                    byte => line.push(*byte),
                }
                if *byte != b'\n' || held {
                    continue;
                }
                at += 1;
                let line = std::mem::take(&mut line);
                assert_eq!(line, self.tape[at].line, "{:?}", String::from_utf8_lossy(&line));
                if let Some(step) = step(&line).filter(|step| known != Some(*step)) {
                    if known.replace(step).is_some() {
                        // The last answer was to the look before the step, the one before ended the other.
                        self.seen.lock().unwrap().between.push(came - answered[0]);
                    }
                    thread::sleep(self.takes);
                }
                said.extend(&self.tape[at].replies);
            }
            if stream.write_all(&said).is_err() {
                return;
            }
            if !said.is_empty() {
                answered = [answered[1], Instant::now()];
            }
        }
    }
}

fn report(exchange: &Exchange, held: bool) -> Vec<u8> {
    let text = String::from_utf8_lossy(&exchange.report);
    if held { text.replace("<Idle", "<Hold:0").into_bytes() } else { exchange.report.clone() }
}
