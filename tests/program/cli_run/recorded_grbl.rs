//! The simulated control on a TCP port of this test, in real time. The test receives a copy of all bytes sent to
//! it.

use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use simulator::SimulatedWorld;
use simulator::controls::grbl::{Firmware, SimulatedGrblOptions};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::net::{TcpListener, TcpStream};
use trued::setup::SimulationPace;
use trued::setup::{self, MachineFile};

pub struct RecordedGrbl {
    pub address: SocketAddr,
    byte_receiver: Receiver<Vec<u8>>,
    server: JoinHandle<String>,
    /// All bytes received so far.
    pub received_bytes: Vec<u8>,
    pub world: Arc<Mutex<SimulatedWorld>>,
}

impl RecordedGrbl {
    /// The machine of the machine file `machine_text`, for one client.
    pub fn start(machine_text: &str) -> Self {
        Self::start_at_pace(machine_text, SimulationPace::RealTime)
    }

    pub fn start_at_pace(machine_text: &str, pace: SimulationPace) -> Self {
        let file = MachineFile::parse("machine.toml", machine_text.to_owned()).unwrap();
        let world = Arc::new(Mutex::new(setup::build_world(&file).unwrap()));
        let firmware = Firmware::new(world.clone(), SimulatedGrblOptions::for_machine(&file.machine, pace));
        let (tell, heard) = channel();
        let (listening, address) = channel();
        let server = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
                listening.send(listener.local_addr().unwrap()).unwrap();
                let (client, _) = listener.accept().await.unwrap();
                serve_client(firmware, client, tell).await
            })
        });
        Self { address: address.recv().unwrap(), byte_receiver: heard, server, received_bytes: Vec::new(), world }
    }

    /// Waits until `words` have been received.
    pub fn wait_for_text(&mut self, words: &str) {
        while !self.received_text().contains(words) {
            let more = self.byte_receiver.recv();
            self.received_bytes.extend(more.unwrap_or_else(|_| panic!("no {words} in {}", self.received_text())));
        }
    }

    /// Waits until the status has been requested `count` more times; each request was answered before the next.
    pub fn wait_for_status_requests(&mut self, count: usize) {
        let queries = |bytes: &[u8]| bytes.iter().filter(|byte| **byte == b'?').count();
        self.received_bytes.extend(self.byte_receiver.try_iter().flatten());
        let enough = queries(&self.received_bytes) + count;
        while queries(&self.received_bytes) < enough {
            self.received_bytes.extend(self.byte_receiver.recv().unwrap());
        }
    }

    /// Whether a line of a step has been received by now.
    pub fn has_moved(&mut self) -> bool {
        self.received_bytes.extend(self.byte_receiver.try_iter().flatten());
        self.received_text().contains("N0 ")
    }

    fn received_text(&self) -> String {
        String::from_utf8_lossy(&self.received_bytes).into_owned()
    }

    /// Waits until the client has disconnected; returns all bytes that it sent, and the status of the control.
    pub fn wait_for_disconnect(mut self) -> (Vec<u8>, String) {
        self.received_bytes.extend(self.byte_receiver.iter().flatten());
        (self.received_bytes, self.server.join().unwrap())
    }
}

/// Forwards the client's bytes until it disconnects; then requests the status.
async fn serve_client(mut firmware: Firmware, client: TcpStream, tell: Sender<Vec<u8>>) -> String {
    let (near, far) = tokio::io::duplex(4096);
    let (served, ()) = tokio::join!(firmware.serve(far), forward_bytes(client, near, tell));
    served.unwrap();
    let (mut near, far) = tokio::io::duplex(4096);
    let ask = async move {
        near.write_all(b"?").await.unwrap();
        let mut said = String::new();
        while !said.contains('>') {
            said.push(char::from(near.read_u8().await.unwrap()));
        }
        said
    };
    tokio::join!(firmware.serve(far), ask).1
}

async fn forward_bytes(client: TcpStream, control: DuplexStream, tell: Sender<Vec<u8>>) {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_control, mut to_control) = tokio::io::split(control);
    let requests = async move {
        let mut buffer = [0; 1024];
        // A client that was killed may reset the connection.
        while let Ok(count @ 1..) = from_client.read(&mut buffer).await {
            // The test may have stopped listening.
            let _ = tell.send(buffer[..count].to_vec());
            to_control.write_all(&buffer[..count]).await.unwrap();
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
