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
pub enum SensorState {
    Measuring,
    /// The surface is beyond its range, and the sensor reports the distance.
    OutOfRange,
    Saturated,
    Silent,
    /// It stops sending after this number of samples at the next position.
    SilentAfterSamplesAtRest(u32),
    /// It has closed the connection and accepts no other.
    Disconnected,
}

/// A distance that was sent, and the machine position at that time.
pub type SentSample = (f64, Position);

pub struct TcpDisplacementSensor {
    pub address: SocketAddr,
    state: Arc<Mutex<SensorState>>,
    /// State that the sensor takes when the machine next moves.
    state_in_next_move: Arc<Mutex<Option<SensorState>>>,
    sent_samples: Arc<Mutex<Vec<SentSample>>>,
}

const SAMPLE_PERIOD: Duration = Duration::from_millis(1);

impl TcpDisplacementSensor {
    pub fn start(world: Arc<Mutex<SimulatedWorld>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(SensorState::Measuring));
        let (later, said) = (Arc::default(), Arc::default());
        let here = RestTracker { position: Position::new(), sample_count: 0, has_arrived_after_fault_command: false };
        let sensor = SensorThread {
            world,
            sample_counter: 0,
            rest_tracker: here,
            state: state.clone(),
            state_in_next_move: Arc::clone(&later),
            sent_samples: Arc::clone(&said),
        };
        std::thread::spawn(move || sensor.serve(&listener));
        Self { address, state, state_in_next_move: later, sent_samples: said }
    }

    pub fn has_state(&self, state: SensorState) -> bool {
        *self.state.lock().unwrap() == state
    }

    pub fn set_state(&self, state: SensorState) {
        *self.state.lock().unwrap() = state;
    }

    /// Sets the state that applies as soon as the machine moves.
    pub fn set_state_in_next_move(&self, state: SensorState) {
        *self.state_in_next_move.lock().unwrap() = Some(state);
    }

    /// All samples with a distance sent so far, in order.
    pub fn sent_samples(&self) -> Vec<SentSample> {
        self.sent_samples.lock().unwrap().clone()
    }
}

/// Counts the samples taken at the current position.
struct RestTracker {
    position: Position,
    sample_count: u32,
    /// The machine has arrived here after the command to fail.
    has_arrived_after_fault_command: bool,
}

impl RestTracker {
    fn update(&mut self, position: Position, state: SensorState) {
        let moved = position != self.position;
        self.sample_count = if moved { 1 } else { self.sample_count + 1 };
        self.has_arrived_after_fault_command = matches!(state, SensorState::SilentAfterSamplesAtRest(_))
            && (self.has_arrived_after_fault_command || moved);
        self.position = position;
    }
}

struct SensorThread {
    world: Arc<Mutex<SimulatedWorld>>,
    sample_counter: u32,
    rest_tracker: RestTracker,
    state: Arc<Mutex<SensorState>>,
    state_in_next_move: Arc<Mutex<Option<SensorState>>>,
    sent_samples: Arc<Mutex<Vec<SentSample>>>,
}

impl SensorThread {
    fn current_state(&self) -> SensorState {
        *self.state.lock().unwrap()
    }

    fn serve(mut self, listener: &TcpListener) {
        loop {
            // A client that connects in this state waits.
            while self.current_state() == SensorState::Disconnected {
                std::thread::sleep(SAMPLE_PERIOD);
            }
            let Ok((stream, _)) = listener.accept() else { return };
            // The client or the sensor has disconnected.
            let _ = self.send_until_disconnected(stream);
        }
    }

    fn send_until_disconnected(&mut self, mut stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        let mut next = Instant::now();
        loop {
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
            next += SAMPLE_PERIOD;
            match self.current_state() {
                SensorState::Disconnected => return Ok(()),
                SensorState::Silent => {}
                state => self.send_sample(&mut stream, state)?,
            }
        }
    }

    /// Sends one sample. The world is locked, so that the machine does not move before the line is sent.
    fn send_sample(&mut self, stream: &mut TcpStream, state: SensorState) -> io::Result<()> {
        let mut world = self.world.lock().unwrap();
        let sensed = world.sample_after("laser", SAMPLE_PERIOD.as_secs_f64()).expect("a sensor");
        if self.rest_tracker.position != world.displayed_position()
            && let Some(next) = self.state_in_next_move.lock().unwrap().take()
        {
            *self.state.lock().unwrap() = next;
            return Ok(());
        }
        self.rest_tracker.update(world.displayed_position(), state);
        if matches!(state, SensorState::SilentAfterSamplesAtRest(most) if self.rest_tracker.has_arrived_after_fault_command && self.rest_tracker.sample_count > most)
        {
            *self.state.lock().unwrap() = SensorState::Silent;
            return Ok(());
        }
        let value = match (state, sensed) {
            (SensorState::OutOfRange, _) => "+10.40000".to_owned(),
            (SensorState::Saturated, _) | (_, SensorOutput::TooMuchLight) => "+FFFFFFF".to_owned(),
            (_, SensorOutput::NoEcho | SensorOutput::OutOfRange(_)) => "-FFFFFFF".to_owned(),
            (_, SensorOutput::Distance(mm)) => {
                let text = format!("{mm:+09.5}");
                let said = (text.parse().unwrap(), self.rest_tracker.position.clone());
                self.sent_samples.lock().unwrap().push(said);
                text
            }
        };
        self.sample_counter = (self.sample_counter + 1) % 10_000;
        stream.write_all(format!("M0,{value},{:04}\r\n", self.sample_counter).as_bytes())
    }
}
