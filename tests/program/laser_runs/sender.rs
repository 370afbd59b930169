//! A displacement sensor on a TCP port, written from what `docs/sensors.md` says of its lines: `M0,` the
//! distance in mm and a counter of four digits, a thousand a second. It sees what stands in the simulated
//! world, fails when it is told to, and is the witness of all that it has said.

use std::io::{self, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use machine::Position;
use simulator::{Sensed, World};

/// `[sensor.serial]` for it.
pub fn table(address: SocketAddr) -> String {
    format!(
        r#"
[sensor.serial]
tcp = "{address}"
timeout_s = 1.5
[sensor.serial.line]
end = "\r\n"
separator = ","
columns = 3
value = {{ column = 2, scale_mm = 1.0, codes = [
    {{ is = "-FFFFFFF", means = "no-echo" }}, {{ is = "+FFFFFFF", means = "saturated" }} ] }}
counter = {{ column = 3, round = 10000 }}
"#
    )
}

/// How it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    Well,
    /// The surface lies beyond its range, and it says how far.
    Beyond,
    Saturated,
    Silent,
    /// It falls silent after so many samples at the next place.
    Resting(u32),
    /// It has closed the link and takes no other.
    Gone,
}

/// A distance that was said, and where the machine stood.
pub type Said = (f64, Position);

pub struct Sender {
    pub address: SocketAddr,
    state: Arc<Mutex<State>>,
    /// What it becomes while the machine moves.
    later: Arc<Mutex<Option<State>>>,
    said: Arc<Mutex<Vec<Said>>>,
}

const PERIOD: Duration = Duration::from_millis(1);

impl Sender {
    pub fn start(world: Arc<Mutex<World>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(State::Well));
        let (later, said) = (Arc::default(), Arc::default());
        let here = Here { stands: Position::new(), samples: 0, next: false };
        let sensor = Sensor {
            world,
            count: 0,
            here,
            state: state.clone(),
            later: Arc::clone(&later),
            said: Arc::clone(&said),
        };
        std::thread::spawn(move || sensor.serve(&listener));
        Self { address, state, later, said }
    }

    pub fn is(&self, state: State) -> bool {
        *self.state.lock().unwrap() == state
    }

    pub fn becomes(&self, state: State) {
        *self.state.lock().unwrap() = state;
    }

    /// As soon as the machine is seen to move.
    pub fn becomes_on_the_way(&self, state: State) {
        *self.later.lock().unwrap() = Some(state);
    }

    /// All distances so far, in their order.
    pub fn said(&self) -> Vec<Said> {
        self.said.lock().unwrap().clone()
    }
}

/// How long it has been looking from where the machine stands.
struct Here {
    stands: Position,
    samples: u32,
    /// The machine has come here since the sensor knows that it is to fall silent.
    next: bool,
}

impl Here {
    fn seen(&mut self, stands: Position, state: State) {
        let moved = stands != self.stands;
        self.samples = if moved { 1 } else { self.samples + 1 };
        self.next = matches!(state, State::Resting(_)) && (self.next || moved);
        self.stands = stands;
    }
}

struct Sensor {
    world: Arc<Mutex<World>>,
    count: u32,
    here: Here,
    state: Arc<Mutex<State>>,
    later: Arc<Mutex<Option<State>>>,
    said: Arc<Mutex<Vec<Said>>>,
}

impl Sensor {
    fn state(&self) -> State {
        *self.state.lock().unwrap()
    }

    fn serve(mut self, listener: &TcpListener) {
        loop {
            // Whoever comes while it is gone waits.
            while self.state() == State::Gone {
                std::thread::sleep(PERIOD);
            }
            let Ok((stream, _)) = listener.accept() else { return };
            // Its client has gone, or it has.
            let _ = self.send(stream);
        }
    }

    fn send(&mut self, mut stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        let mut next = Instant::now();
        loop {
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
            next += PERIOD;
            match self.state() {
                State::Gone => return Ok(()),
                State::Silent => {}
                state => self.sample(&mut stream, state)?,
            }
        }
    }

    /// The machine does not move on before the line is on its way.
    fn sample(&mut self, stream: &mut TcpStream, state: State) -> io::Result<()> {
        let mut world = self.world.lock().unwrap();
        let sensed = world.sense("laser", PERIOD.as_secs_f64()).expect("a sensor");
        if self.here.stands != world.position()
            && let Some(next) = self.later.lock().unwrap().take()
        {
            *self.state.lock().unwrap() = next;
            return Ok(());
        }
        self.here.seen(world.position(), state);
        if matches!(state, State::Resting(most) if self.here.next && self.here.samples > most) {
            *self.state.lock().unwrap() = State::Silent;
            return Ok(());
        }
        let value = match (state, sensed) {
            (State::Beyond, _) => "+10.40000".to_owned(),
            (State::Saturated, _) | (_, Sensed::Saturated) => "+FFFFFFF".to_owned(),
            (_, Sensed::NoEcho | Sensed::OutOfRange(_)) => "-FFFFFFF".to_owned(),
            (_, Sensed::Distance(mm)) => {
                let text = format!("{mm:+09.5}");
                let said = (text.parse().unwrap(), self.here.stands.clone());
                self.said.lock().unwrap().push(said);
                text
            }
        };
        self.count = (self.count + 1) % 10_000;
        stream.write_all(format!("M0,{value},{:04}\r\n", self.count).as_bytes())
    }
}
