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
pub fn sensor_section(address: SocketAddr) -> String {
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
pub enum SenderState {
    Measuring,
    /// The surface is beyond its range, and the sensor reports the distance.
    OutOfRange,
    Saturated,
    Silent,
    /// It stops sending after this number of samples at the next position.
    SilentAtRest(u32),
    /// It has closed the connection and accepts no other.
    Disconnected,
}

/// A distance that was sent, and the machine position at that time.
pub type SentSample = (f64, Position);

pub struct SensorSender {
    pub address: SocketAddr,
    state: Arc<Mutex<SenderState>>,
    /// State that the sensor takes when the machine next moves.
    next_state: Arc<Mutex<Option<SenderState>>>,
    sent_samples: Arc<Mutex<Vec<SentSample>>>,
}

const SAMPLE_PERIOD: Duration = Duration::from_millis(1);

impl SensorSender {
    pub fn start(world: Arc<Mutex<SimulatedWorld>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(SenderState::Measuring));
        let (later, said) = (Arc::default(), Arc::default());
        let here = RestTracker { position: Position::new(), samples: 0, arrived_after_command: false };
        let sensor = SenderThread {
            world,
            count: 0,
            rest_tracker: here,
            state: state.clone(),
            next_state: Arc::clone(&later),
            sent_samples: Arc::clone(&said),
        };
        std::thread::spawn(move || sensor.serve(&listener));
        Self { address, state, next_state: later, sent_samples: said }
    }

    pub fn has_state(&self, state: SenderState) -> bool {
        *self.state.lock().unwrap() == state
    }

    pub fn set_state(&self, state: SenderState) {
        *self.state.lock().unwrap() = state;
    }

    /// Sets the state that applies as soon as the machine moves.
    pub fn set_state_in_next_move(&self, state: SenderState) {
        *self.next_state.lock().unwrap() = Some(state);
    }

    /// All distances so far, in order.
    pub fn sent_samples(&self) -> Vec<SentSample> {
        self.sent_samples.lock().unwrap().clone()
    }
}

/// Number of samples taken at the current position.
struct RestTracker {
    position: Position,
    samples: u32,
    /// The machine has arrived here after the command to fail.
    arrived_after_command: bool,
}

impl RestTracker {
    fn update(&mut self, stands: Position, state: SenderState) {
        let moved = stands != self.position;
        self.samples = if moved { 1 } else { self.samples + 1 };
        self.arrived_after_command =
            matches!(state, SenderState::SilentAtRest(_)) && (self.arrived_after_command || moved);
        self.position = stands;
    }
}

struct SenderThread {
    world: Arc<Mutex<SimulatedWorld>>,
    count: u32,
    rest_tracker: RestTracker,
    state: Arc<Mutex<SenderState>>,
    next_state: Arc<Mutex<Option<SenderState>>>,
    sent_samples: Arc<Mutex<Vec<SentSample>>>,
}

impl SenderThread {
    fn current_state(&self) -> SenderState {
        *self.state.lock().unwrap()
    }

    fn serve(mut self, listener: &TcpListener) {
        loop {
            // A client that connects in this state waits.
            while self.current_state() == SenderState::Disconnected {
                std::thread::sleep(SAMPLE_PERIOD);
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
            next += SAMPLE_PERIOD;
            match self.current_state() {
                SenderState::Disconnected => return Ok(()),
                SenderState::Silent => {}
                state => self.sample(&mut stream, state)?,
            }
        }
    }

    /// The machine does not move on before the line is sent.
    fn sample(&mut self, stream: &mut TcpStream, state: SenderState) -> io::Result<()> {
        let mut world = self.world.lock().unwrap();
        let sensed = world.sample_after("laser", SAMPLE_PERIOD.as_secs_f64()).expect("a sensor");
        if self.rest_tracker.position != world.position()
            && let Some(next) = self.next_state.lock().unwrap().take()
        {
            *self.state.lock().unwrap() = next;
            return Ok(());
        }
        self.rest_tracker.update(world.position(), state);
        if matches!(state, SenderState::SilentAtRest(most) if self.rest_tracker.arrived_after_command && self.rest_tracker.samples > most)
        {
            *self.state.lock().unwrap() = SenderState::Silent;
            return Ok(());
        }
        let value = match (state, sensed) {
            (SenderState::OutOfRange, _) => "+10.40000".to_owned(),
            (SenderState::Saturated, _) | (_, SensorOutput::TooMuchLight) => "+FFFFFFF".to_owned(),
            (_, SensorOutput::NoEcho | SensorOutput::OutOfRange(_)) => "-FFFFFFF".to_owned(),
            (_, SensorOutput::Distance(mm)) => {
                let text = format!("{mm:+09.5}");
                let said = (text.parse().unwrap(), self.rest_tracker.position.clone());
                self.sent_samples.lock().unwrap().push(said);
                text
            }
        };
        self.count = (self.count + 1) % 10_000;
        stream.write_all(format!("M0,{value},{:04}\r\n", self.count).as_bytes())
    }
}
