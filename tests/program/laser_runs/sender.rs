//! A displacement sensor on a TCP port, implemented from the line format in `docs/sensors.md`: `M0,` the distance
//! in mm and a counter of four digits, a thousand a second. It measures the simulated world, fails on command, and
//! records all samples that it has sent.

use std::io::{self, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use machine::Position;
use simulator::{SensorOutput, SimulatedWorld};

/// `[sensor.serial]` for this sensor.
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

/// State of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    Well,
    /// The surface is beyond its range, and the sensor reports the distance.
    Beyond,
    Saturated,
    Silent,
    /// It stops sending after this number of samples at the next position.
    Resting(u32),
    /// It has closed the connection and accepts no other.
    Gone,
}

/// A distance that was sent, and the machine position at that time.
pub type Said = (f64, Position);

pub struct Sender {
    pub address: SocketAddr,
    state: Arc<Mutex<State>>,
    /// State that the sensor takes when the machine next moves.
    later: Arc<Mutex<Option<State>>>,
    said: Arc<Mutex<Vec<Said>>>,
}

const PERIOD: Duration = Duration::from_millis(1);

impl Sender {
    pub fn start(world: Arc<Mutex<SimulatedWorld>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(State::Well));
        let (later, said) = (Arc::default(), Arc::default());
        let here = Here { stands: Position::new(), samples: 0, next: false };
        let sensor =
            Sensor { world, count: 0, here, state: state.clone(), later: Arc::clone(&later), said: Arc::clone(&said) };
        std::thread::spawn(move || sensor.serve(&listener));
        Self { address, state, later, said }
    }

    pub fn is(&self, state: State) -> bool {
        *self.state.lock().unwrap() == state
    }

    pub fn becomes(&self, state: State) {
        *self.state.lock().unwrap() = state;
    }

    /// Sets the state that applies as soon as the machine moves.
    pub fn becomes_on_the_way(&self, state: State) {
        *self.later.lock().unwrap() = Some(state);
    }

    /// All distances so far, in order.
    pub fn said(&self) -> Vec<Said> {
        self.said.lock().unwrap().clone()
    }
}

/// Number of samples taken at the current position.
struct Here {
    stands: Position,
    samples: u32,
    /// The machine has arrived here after the command to fail.
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
    world: Arc<Mutex<SimulatedWorld>>,
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
            // A client that connects in this state waits.
            while self.state() == State::Gone {
                std::thread::sleep(PERIOD);
            }
            let Ok((stream, _)) = listener.accept() else { return };
            // The client or the sensor has disconnected.
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

    /// The machine does not move on before the line is sent.
    fn sample(&mut self, stream: &mut TcpStream, state: State) -> io::Result<()> {
        let mut world = self.world.lock().unwrap();
        let sensed = world.sample_after("laser", PERIOD.as_secs_f64()).expect("a sensor");
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
            (State::Saturated, _) | (_, SensorOutput::Saturated) => "+FFFFFFF".to_owned(),
            (_, SensorOutput::NoEcho | SensorOutput::OutOfRange(_)) => "-FFFFFFF".to_owned(),
            (_, SensorOutput::Distance(mm)) => {
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
