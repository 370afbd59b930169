//! The simulated control on a TCP port of this process. All received and sent bytes are recorded here, even if the
//! program at the other end fails.

use std::net::SocketAddr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;

use simulator::SimulatedWorld;
use simulator::controls::grbl::{Firmware, SimulatedGrblOptions};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use trued::setup::SimulationPace;
use trued::setup::{self, MachineFile};

/// Machine file of the built-in machine with its control at `address`, and few Monte Carlo trials.
pub fn machine_with_control(address: &str) -> String {
    let file = include_str!("../../config/simulated.toml");
    let wire = "kind = \"simulated\"";
    assert!(file.contains(wire) && file.contains("\nwire = \"memory\""));
    let file = file.replace(wire, &format!("kind = \"grbl\"\ntcp = \"{address}\""));
    let file = file.replace("\nwire = \"memory\"", "");
    format!("{file}\n[method.self-calibration]\nmonte_carlo_trials = 100\n")
}

#[derive(Clone, Default)]
pub struct WireRecord {
    received_bytes: Vec<u8>,
    sent_bytes: Vec<u8>,
}

impl WireRecord {
    pub fn transferred_byte_count(&self) -> usize {
        self.received_bytes.len() + self.sent_bytes.len()
    }

    /// The received lines, without status requests.
    pub fn received_lines(&self) -> Vec<String> {
        // Status requests can occur between the bytes of lines.
        let told = self.received_bytes.iter().filter(|byte| !matches!(byte, b'?' | 0x87));
        let told = String::from_utf8_lossy(&told.copied().collect::<Vec<u8>>()).into_owned();
        told.lines().map(str::to_owned).collect()
    }

    /// The largest N word of a line that moves: all steps before it were acknowledged.
    pub fn last_started_step(&self) -> usize {
        last_started_n_word(&self.received_bytes)
    }

    /// Axis positions, mm and degrees, of each touch. The driver requests each result twice; between any two
    /// touches there is a guarded move without contact.
    pub fn reported_touch_positions(&self) -> Vec<Vec<f64>> {
        let said = String::from_utf8_lossy(&self.sent_bytes);
        let (mut touches, mut again) = (Vec::new(), false);
        for told in said.lines().filter_map(|line| line.trim().strip_prefix("[PRB:")) {
            let hit = told.strip_suffix(":1]");
            if let Some(values) = hit.filter(|_| !again) {
                touches.push(values.split(',').map(|value| value.parse().unwrap()).collect());
            }
            again = hit.is_some();
        }
        touches
    }
}

/// The largest N word at the beginning of a line of `told`.
pub fn last_started_n_word(told: &[u8]) -> usize {
    let told = String::from_utf8_lossy(told);
    let number = |line: &str| line.trim_start_matches('?').strip_prefix('N')?.split(' ').next()?.parse().ok();
    told.lines().filter_map(number).max().unwrap_or(0)
}

#[derive(Default)]
struct SharedWireRecord {
    record: Mutex<WireRecord>,
    changed: Condvar,
}

impl SharedWireRecord {
    fn record(&self) -> MutexGuard<'_, WireRecord> {
        self.record.lock().unwrap()
    }

    fn extend_record(&self, add: impl FnOnce(&mut WireRecord)) {
        add(&mut self.record());
        self.changed.notify_all();
    }
}

pub struct RecordingControl {
    address: SocketAddr,
    shared: Arc<SharedWireRecord>,
    stop: tokio::sync::oneshot::Sender<()>,
    server: JoinHandle<()>,
}

impl RecordingControl {
    pub fn start() -> Self {
        let file = MachineFile::parse("machine.toml", machine_with_control("127.0.0.1:1")).unwrap();
        Self::start_with_world(Arc::new(Mutex::new(setup::build_world(&file).unwrap())))
    }

    /// The control of the built-in machine, acting on `world`.
    pub fn start_with_world(world: Arc<Mutex<SimulatedWorld>>) -> Self {
        let (shared, (stop, stopped)) = (Arc::<SharedWireRecord>::default(), tokio::sync::oneshot::channel());
        let (listening, address) = std::sync::mpsc::channel();
        let keeper = shared.clone();
        let server = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
                listening.send(listener.local_addr().unwrap()).unwrap();
                tokio::select! {
                    client = listener.accept() => serve_client(client.unwrap().0, world, &keeper).await,
                    // The program may end before it connects.
                    _ = stopped => {}
                }
            });
        });
        Self { address: address.recv().unwrap(), shared, stop, server }
    }

    pub fn address(&self) -> String {
        self.address.to_string()
    }

    /// Waits until `bytes` bytes have passed the wire, or until `give_up` returns true.
    pub fn wait_for_transferred_bytes(&self, bytes: usize, mut give_up: impl FnMut() -> bool) {
        let mut record = self.shared.record();
        while record.transferred_byte_count() < bytes {
            let poll_interval = Duration::from_millis(20);
            record = self.shared.changed.wait_timeout(record, poll_interval).unwrap().0;
            if give_up() {
                return;
            }
        }
    }

    /// The complete record, after the client has disconnected.
    pub fn stop_and_take_record(self) -> WireRecord {
        let _ = self.stop.send(());
        self.server.join().unwrap();
        self.shared.record().clone()
    }
}

async fn serve_client(client: TcpStream, world: Arc<Mutex<SimulatedWorld>>, shared: &SharedWireRecord) {
    let file = MachineFile::parse("machine.toml", machine_with_control("127.0.0.1:1")).unwrap();
    let mut firmware =
        Firmware::new(world, SimulatedGrblOptions::for_machine(&file.machine, SimulationPace::Immediate));
    client.set_nodelay(true).unwrap();
    let (near, far) = tokio::io::duplex(4096);
    let (from_client, to_client) = client.into_split();
    let (from_control, to_control) = tokio::io::split(near);
    let told = forward_bytes(from_client, to_control, |bytes| {
        shared.extend_record(|record| record.received_bytes.extend(bytes));
    });
    let said = forward_bytes(from_control, to_client, |bytes| {
        shared.extend_record(|record| record.sent_bytes.extend(bytes));
    });
    let (served, (), ()) = tokio::join!(firmware.serve(far), told, said);
    served.unwrap();
}

/// Copies until the source ends; bytes without a receiver are still read.
async fn forward_bytes(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin, mut seen: impl FnMut(&[u8])) {
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut buffer).await {
        seen(&buffer[..count]);
        let _ = to.write_all(&buffer[..count]).await;
    }
    let _ = to.shutdown().await;
}
