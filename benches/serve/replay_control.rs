//! A grbl control over TCP that replays recorded answers and records the times of reception.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use super::tape::{FULL_REPORT_REQUEST, GrblExchange};

#[derive(Default)]
pub struct ReceptionTimes {
    /// Times at which a hold arrived.
    pub hold_times: Vec<Instant>,
    /// Time from the answer that ended the previous step to the first line of the step with this number: reading,
    /// journal, next block.
    pub delays_before_steps: Vec<(u32, Duration)>,
}

pub struct ReplayControlServer {
    pub port: u16,
    pub reception_times: Arc<Mutex<ReceptionTimes>>,
}

impl ReplayControlServer {
    /// `takes`: duration of the first move of each step.
    pub fn new(tape: Vec<GrblExchange>, takes: Duration) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let seen = Arc::new(Mutex::new(ReceptionTimes::default()));
        let all = Arc::clone(&seen);
        thread::spawn(move || {
            for stream in listener.incoming() {
                let control =
                    ReplayControl { tape: tape.clone(), move_duration: takes, reception_times: Arc::clone(&all) };
                thread::spawn(move || control.serve(stream.unwrap()));
            }
        });
        Self { port, reception_times: seen }
    }
}

struct ReplayControl {
    tape: Vec<GrblExchange>,
    move_duration: Duration,
    reception_times: Arc<Mutex<ReceptionTimes>>,
}

/// The number of the step to which a line belongs.
fn parse_step_number(line: &[u8]) -> Option<u32> {
    let text = std::str::from_utf8(line).ok()?;
    text.strip_prefix('N')?.split(' ').next()?.parse().ok()
}

/// State of one connection.
struct ConnectionState {
    exchange_index: usize,
    partial_line: Vec<u8>,
    current_step: Option<u32>,
    is_held: bool,
    /// Time of the end of a running move, and the answer to it.
    running_move: Option<(Instant, Vec<u8>)>,
    /// Times of the last two answers, the older first.
    last_answer_times: [Instant; 2],
}

impl ReplayControl {
    fn serve(self, mut stream: TcpStream) {
        stream.set_nodelay(true).unwrap();
        let answered = [Instant::now(); 2];
        let (line, step, moving) = (Vec::new(), None, None);
        let mut talk = ConnectionState {
            exchange_index: 0,
            partial_line: line,
            current_step: step,
            is_held: false,
            running_move: moving,
            last_answer_times: answered,
        };
        let mut said = self.tape[0].replies.clone();
        let mut buffer = [0; 4096];
        loop {
            if !said.is_empty() {
                if stream.write_all(&said).is_err() {
                    return;
                }
                talk.last_answer_times = [talk.last_answer_times[1], Instant::now()];
            }
            let left = talk
                .running_move
                .as_ref()
                .map(|(end, _)| end.saturating_duration_since(Instant::now()).max(Duration::from_micros(100)));
            stream.set_read_timeout(left).unwrap();
            said = match stream.read(&mut buffer) {
                Ok(0) => return,
                Ok(count) => self.answer_bytes(&mut talk, &buffer[..count]),
                Err(error) if left.is_some() && error.kind() == ErrorKind::WouldBlock => {
                    talk.running_move.take().map(|(_, replies)| replies).unwrap_or_default()
                }
                Err(_) => return,
            };
        }
    }

    /// Processes received bytes; returns the bytes that are answered at once.
    fn answer_bytes(&self, talk: &mut ConnectionState, bytes: &[u8]) -> Vec<u8> {
        let (came, mut said) = (Instant::now(), Vec::new());
        for byte in bytes {
            match byte {
                b'!' => {
                    (talk.is_held, talk.running_move) = (true, None);
                    self.reception_times.lock().unwrap().hold_times.push(came);
                }
                b'?' => said.extend(report_in_current_state(&self.tape[talk.exchange_index].report, talk)),
                &FULL_REPORT_REQUEST => {
                    said.extend(report_in_current_state(&self.tape[talk.exchange_index].full_report, talk))
                }
                0x18 | 0x80.. => {}
                byte => talk.partial_line.push(*byte),
            }
            if *byte == b'\n' && !talk.is_held {
                said.extend(self.answer_line(talk, came));
            }
        }
        said
    }

    fn answer_line(&self, talk: &mut ConnectionState, came: Instant) -> Vec<u8> {
        talk.exchange_index += 1;
        let (line, exchange) = (std::mem::take(&mut talk.partial_line), &self.tape[talk.exchange_index]);
        assert_eq!(line, exchange.line, "{:?}", String::from_utf8_lossy(&line));
        let step = parse_step_number(&line);
        if step.is_none() || step == talk.current_step {
            return exchange.replies.clone();
        }
        if let (Some(_), Some(step)) = (talk.current_step, step) {
            // The last answer was for the query before the step; the one before it ended the previous step.
            self.reception_times.lock().unwrap().delays_before_steps.push((step, came - talk.last_answer_times[0]));
        }
        (talk.current_step, talk.running_move) = (step, Some((came + self.move_duration, exchange.replies.clone())));
        Vec::new()
    }
}

/// `taped`, the report of an idle control, changed to that of a control that is held or moves.
fn report_in_current_state(taped: &[u8], talk: &ConnectionState) -> Vec<u8> {
    let state = match (talk.is_held, &talk.running_move) {
        (true, _) => "<Hold:0",
        (false, Some(_)) => "<Run",
        (false, None) => return taped.to_vec(),
    };
    String::from_utf8_lossy(taped).replace("<Idle", state).into_bytes()
}
