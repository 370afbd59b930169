//! An amplifier with three displacement sensors around a datum cylinder, on a pseudo-terminal. Each line has their
//! distances in mm, the count of the encoder on C (16 bits) and the number of the line (four digits):
//! `+0.01234,-0.00456,+0.00789,51234,0017`. The amplifier works beside the simulated world, whose axes
//! move in no host time: its samples of a turn of C are sent before the control reports the end of the turn
//! ([`Amplifier::wait_until_due_samples_are_sent`]).

use std::fmt::Write as _;
use std::sync::{Arc, Mutex, mpsc as std_mpsc};
use std::time::Duration;

use link::Pty;
use machine::{Axis, Position};
use simulator::{SensorOutput, SimulatedWorld};
use tokio::io::AsyncWriteExt;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::{MissedTickBehavior, interval, sleep};

pub const SENSOR_NAMES: [&str; 3] = ["x1", "y1", "r1"];
/// The count decreases while the angle of C increases.
pub const COUNTS_PER_TURN: i64 = -90_000;
pub const ENCODER_COUNT_MODULUS: i64 = 1 << 16;
/// The count at C = 0.
const COUNT_AT_ZERO: i64 = 1_000;
const LINE_NUMBER_MODULUS: u32 = 10_000;
/// Period of the lines, both in simulated time and in host time.
const SAMPLE_PERIOD_S: f64 = 4e-3;
/// While C turns, one line per this angle.
const C_ANGLE_PER_LINE_DEG: f64 = 0.25;
const MAX_LINES_PER_WRITE: usize = 40;
/// Pause that lets the reader keep up.
const WRITE_PAUSE: Duration = Duration::from_millis(4);

type DoneSender = std_mpsc::Sender<()>;

pub struct Amplifier {
    /// Path of the serial port for the client.
    pub port_path: String,
    send_requests: UnboundedSender<DoneSender>,
}

impl Amplifier {
    pub fn start(world: Arc<Mutex<SimulatedWorld>>) -> Self {
        let (requests, requested) = unbounded_channel();
        let (ready, path) = std_mpsc::channel();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let Pty { device, path, client_side } = link::create_pty().unwrap();
                // Without a client, sent bytes are lost.
                drop(client_side);
                ready.send(path).unwrap();
                let sent_s = world.lock().unwrap().time_s();
                SampleSender { world, device, sent_s, line_number: 0, last_c_rad: 0.0 }.run(requested).await;
            });
        });
        Self { port_path: path.recv().unwrap(), send_requests: requests }
    }

    /// Waits until all samples of turns of C up to the world's time have been sent.
    pub fn wait_until_due_samples_are_sent(&self) {
        let (done, sent) = std_mpsc::channel();
        self.send_requests.send(done).unwrap();
        sent.recv().unwrap();
    }
}

struct SampleSender<D> {
    world: Arc<Mutex<SimulatedWorld>>,
    device: D,
    /// Simulated time up to which lines have been sent.
    sent_s: f64,
    line_number: u32,
    /// Angle of C in the last line.
    last_c_rad: f64,
}

impl<D: AsyncWriteExt + Unpin> SampleSender<D> {
    async fn run(mut self, mut requested: UnboundedReceiver<DoneSender>) {
        let mut ticks = interval(Duration::from_secs_f64(SAMPLE_PERIOD_S));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                done = requested.recv() => {
                    let Some(done) = done else { return };
                    self.send_due_samples().await;
                    done.send(()).unwrap();
                }
                _ = ticks.tick() => {
                    let measured = self.sample_line(self.sent_s);
                    self.send_lines(&[measured]).await;
                }
            }
        }
    }

    async fn send_due_samples(&mut self) {
        loop {
            let mut all = Vec::new();
            let now_s = self.world.lock().unwrap().time_s();
            while all.len() < MAX_LINES_PER_WRITE && self.sent_s + SAMPLE_PERIOD_S <= now_s {
                self.sent_s += SAMPLE_PERIOD_S;
                let at = self.world.lock().unwrap().sample_at(SENSOR_NAMES[0], self.sent_s).unwrap();
                let turned = at.displayed_position.get_or_zero(Axis::C) - self.last_c_rad;
                if turned.abs().to_degrees() >= C_ANGLE_PER_LINE_DEG {
                    all.push(self.sample_line(self.sent_s));
                }
            }
            if all.is_empty() {
                return;
            }
            self.send_lines(&all).await;
            sleep(WRITE_PAUSE).await;
        }
    }

    async fn send_lines(&mut self, all: &[String]) {
        let mut lines = String::new();
        for measured in all {
            self.line_number = (self.line_number + 1) % LINE_NUMBER_MODULUS;
            writeln!(lines, "{measured},{:04}", self.line_number).unwrap();
        }
        // The port may not be open.
        let _ = self.device.write_all(lines.as_bytes()).await;
    }

    /// Distances and count at `t_s`.
    fn sample_line(&mut self, t_s: f64) -> String {
        let mut world = self.world.lock().unwrap();
        let mut distances = String::new();
        let mut stands = Position::new();
        for name in SENSOR_NAMES {
            let passing = world.sample_at(name, t_s).unwrap();
            match passing.output {
                SensorOutput::Distance(mm) => write!(distances, "{mm:+.6},").unwrap(),
                _ => distances += "OUT,",
            }
            stands = passing.displayed_position;
        }
        self.last_c_rad = stands.get_or_zero(Axis::C);
        let turns = self.last_c_rad.to_degrees() / 360.0;
        let count = COUNT_AT_ZERO + (turns * COUNTS_PER_TURN as f64).floor() as i64;
        format!("{distances}{}", count.rem_euclid(ENCODER_COUNT_MODULUS))
    }
}
