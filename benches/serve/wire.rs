//! The other end of the wire: a grbl control over TCP that plays prepared answers, computes nothing, and records
//! the times of reception.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use super::tape::{ASK_FULL, Exchange};

#[derive(Default)]
pub struct Seen {
    /// Times at which a hold arrived.
    pub holds: Vec<Instant>,
    /// Time from the answer that ended the previous step to the first line of the step with this number: reading,
    /// journal, next block.
    pub between: Vec<(u32, Duration)>,
}

pub struct Wire {
    pub port: u16,
    pub seen: Arc<Mutex<Seen>>,
}

impl Wire {
    /// `takes`: duration of the first move of each step.
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

/// The number of the step to which a line belongs.
fn step(line: &[u8]) -> Option<u32> {
    let text = std::str::from_utf8(line).ok()?;
    text.strip_prefix('N')?.split(' ').next()?.parse().ok()
}

/// State of the conversation.
struct Talk {
    at: usize,
    line: Vec<u8>,
    step: Option<u32>,
    held: bool,
    /// The answer to a running move, and the time of its end.
    moving: Option<(Instant, Vec<u8>)>,
    /// Times of the last two answers.
    answered: [Instant; 2],
}

impl Control {
    fn serve(self, mut stream: TcpStream) {
        stream.set_nodelay(true).unwrap();
        let answered = [Instant::now(); 2];
        let (line, step, moving) = (Vec::new(), None, None);
        let mut talk = Talk { at: 0, line, step, held: false, moving, answered };
        let mut said = self.tape[0].replies.clone();
        let mut buffer = [0; 4096];
        loop {
            if !said.is_empty() {
                if stream.write_all(&said).is_err() {
                    return;
                }
                talk.answered = [talk.answered[1], Instant::now()];
            }
            let left = talk
                .moving
                .as_ref()
                .map(|(end, _)| end.saturating_duration_since(Instant::now()).max(Duration::from_micros(100)));
            stream.set_read_timeout(left).unwrap();
            said = match stream.read(&mut buffer) {
                Ok(0) => return,
                Ok(count) => self.hears(&mut talk, &buffer[..count]),
                Err(error) if left.is_some() && error.kind() == ErrorKind::WouldBlock => {
                    talk.moving.take().map(|(_, replies)| replies).unwrap_or_default()
                }
                Err(_) => return,
            };
        }
    }

    /// The bytes that are answered at once.
    fn hears(&self, talk: &mut Talk, bytes: &[u8]) -> Vec<u8> {
        let (came, mut said) = (Instant::now(), Vec::new());
        for byte in bytes {
            match byte {
                b'!' => {
                    (talk.held, talk.moving) = (true, None);
                    self.seen.lock().unwrap().holds.push(came);
                }
                b'?' => said.extend(report(&self.tape[talk.at].report, talk)),
                &ASK_FULL => said.extend(report(&self.tape[talk.at].full_report, talk)),
                0x18 | 0x80.. => {}
                byte => talk.line.push(*byte),
            }
            if *byte == b'\n' && !talk.held {
                said.extend(self.line(talk, came));
            }
        }
        said
    }

    fn line(&self, talk: &mut Talk, came: Instant) -> Vec<u8> {
        talk.at += 1;
        let (line, exchange) = (std::mem::take(&mut talk.line), &self.tape[talk.at]);
        assert_eq!(line, exchange.line, "{:?}", String::from_utf8_lossy(&line));
        let step = step(&line);
        if step.is_none() || step == talk.step {
            return exchange.replies.clone();
        }
        if let (Some(_), Some(step)) = (talk.step, step) {
            // The last answer was for the query before the step; the one before it ended the previous step.
            self.seen.lock().unwrap().between.push((step, came - talk.answered[0]));
        }
        (talk.step, talk.moving) = (step, Some((came + self.takes, exchange.replies.clone())));
        Vec::new()
    }
}

/// `taped`, the report of an idle control, changed to that of a control that is held or moves.
fn report(taped: &[u8], talk: &Talk) -> Vec<u8> {
    let state = match (talk.held, &talk.moving) {
        (true, _) => "<Hold:0",
        (false, Some(_)) => "<Run",
        (false, None) => return taped.to_vec(),
    };
    String::from_utf8_lossy(taped).replace("<Idle", state).into_bytes()
}
