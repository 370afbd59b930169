//! A simulated control that outlives its clients, as a machine does: on a TCP port of this test, by default without
//! waiting times. A session can be cut at a given line; a test can reset the control and move the part.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use simulator::SimulatedWorld;
use simulator::controls::grbl::{Firmware, SimulatedGrblOptions};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use trued::setup::SimulationPace;
use trued::setup::{self, MachineFile};

pub struct GrblControl {
    pub address: SocketAddr,
    /// The true machine, shared with other readers.
    pub world: Arc<Mutex<SimulatedWorld>>,
    pace: SimulationPace,
    session: Arc<Mutex<ClientSession>>,
    change_requests: UnboundedSender<(ControlChange, std::sync::mpsc::Sender<()>)>,
}

/// Text that the current client has sent, and the words at which its session is cut.
#[derive(Default)]
struct ClientSession {
    received_text: String,
    cut_words: Vec<String>,
}

impl ClientSession {
    fn is_cut(&self) -> bool {
        let after = |rest: &mut &str, words: &String| {
            *rest = rest.split_once(words.as_str())?.1;
            Some(())
        };
        let mut rest = self.received_text.as_str();
        !self.cut_words.is_empty() && self.cut_words.iter().all(|words| after(&mut rest, words).is_some())
    }
}

enum ControlChange {
    ResetAndHome,
    ReplaceFirmware(Box<Firmware>),
}

fn parse_machine_file(file: &str) -> MachineFile {
    MachineFile::parse("machine.toml", file.to_owned()).unwrap()
}

/// The probe is removed from the spindle if the file has sensors.
fn build_world(file: &MachineFile) -> SimulatedWorld {
    let mut world = setup::build_world(file).unwrap();
    world.set_probe_removed(!file.sensors.is_empty());
    world
}

impl GrblControl {
    /// The machine with the truth of the machine file `machine_text`, without waiting times.
    pub fn start(machine_text: &str) -> Self {
        Self::start_at_pace(machine_text, SimulationPace::Immediate)
    }

    pub fn start_at_pace(machine_text: &str, pace: SimulationPace) -> Self {
        let file = parse_machine_file(machine_text);
        let world = Arc::new(Mutex::new(build_world(&file)));
        let session = Arc::new(Mutex::new(ClientSession::default()));
        let (wishes, wished) = unbounded_channel();
        let (listening, address) = std::sync::mpsc::channel();
        let machine = Firmware::new(world.clone(), SimulatedGrblOptions::for_machine(&file.machine, pace));
        let shared = session.clone();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
                listening.send(listener.local_addr().unwrap()).unwrap();
                serve_control(machine, listener, wished, shared).await;
            });
        });
        Self { address: address.recv().unwrap(), world, pace, session, change_requests: wishes }
    }

    /// Drops the next client's lines from the one on that contains the last of these words, after the others in
    /// their order; real-time commands still pass.
    pub fn cut_session_at(&self, words: &[&str]) {
        self.session.lock().unwrap().cut_words = words.iter().map(|&words| words.to_owned()).collect();
    }

    /// Waits until the client has sent all of these words.
    pub fn wait_for_session_cut(&self, client: &mut std::process::Child) {
        while !self.session.lock().unwrap().is_cut() {
            assert!(client.try_wait().unwrap().is_none(), "it ended by itself");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// All bytes that the last client sent.
    pub fn received_text(&self) -> String {
        self.session.lock().unwrap().received_text.clone()
    }

    /// Resets the control and homes the machine, as an operator does.
    pub fn reset_and_home(&self) {
        self.request_change(ControlChange::ResetAndHome);
    }

    /// Replaces the true machine.
    pub fn replace_true_machine(&self, file: &str) {
        let file = parse_machine_file(file);
        *self.world.lock().unwrap() = build_world(&file);
        let firmware = Firmware::new(self.world.clone(), SimulatedGrblOptions::for_machine(&file.machine, self.pace));
        self.request_change(ControlChange::ReplaceFirmware(Box::new(firmware)));
    }

    fn request_change(&self, wish: ControlChange) {
        let (done, granted) = std::sync::mpsc::channel();
        assert!(self.change_requests.send((wish, done)).is_ok());
        granted.recv().unwrap();
        self.session.lock().unwrap().received_text.clear();
    }
}

async fn serve_control(
    mut machine: Firmware,
    listener: TcpListener,
    mut wished: UnboundedReceiver<(ControlChange, std::sync::mpsc::Sender<()>)>,
    session: Arc<Mutex<ClientSession>>,
) {
    loop {
        tokio::select! {
            client = listener.accept() => {
                session.lock().unwrap().received_text.clear();
                let (near, far) = tokio::io::duplex(4096);
                let (served, ()) = tokio::join!(machine.serve(far), forward_bytes(client.unwrap().0, near, &session));
                served.unwrap();
                session.lock().unwrap().cut_words.clear();
            }
            wish = wished.recv() => match wish {
                None => return,
                Some((ControlChange::ReplaceFirmware(other), done)) => { machine = *other; done.send(()).unwrap(); }
                Some((ControlChange::ResetAndHome, done)) => {
                    let (mut near, far) = tokio::io::duplex(4096);
                    near.write_all(b"\x18$H\n").await.unwrap();
                    near.shutdown().await.unwrap();
                    machine.serve(far).await.unwrap();
                    done.send(()).unwrap();
                }
            },
        }
    }
}

async fn forward_bytes(client: TcpStream, control: DuplexStream, session: &Mutex<ClientSession>) {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_control, mut to_control) = tokio::io::split(control);
    let requests = async move {
        let mut buffer = [0; 1024];
        // A client that was killed may reset the connection.
        while let Ok(count @ 1..) = from_client.read(&mut buffer).await {
            let mut bytes = buffer[..count].to_vec();
            {
                let mut session = session.lock().unwrap();
                session.received_text.push_str(&String::from_utf8_lossy(&bytes));
                if session.is_cut() {
                    bytes.retain(|byte| b"!?".contains(byte));
                }
            }
            to_control.write_all(&bytes).await.unwrap();
        }
        to_control.shutdown().await.unwrap();
    };
    let answers = async move {
        let _ = tokio::io::copy(&mut from_control, &mut to_client).await;
        // Drains output that has no reader.
        let _ = tokio::io::copy(&mut from_control, &mut tokio::io::sink()).await;
    };
    tokio::join!(requests, answers);
}
