//! A TCP proxy between `trued` and the firmware. Its address does not change when the firmware is restarted, and all
//! bytes to the firmware are recorded.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use libtest_mimic::Failed;

#[derive(Clone)]
pub struct RecordingProxy {
    pub listen_port: u16,
    firmware_port: Arc<AtomicU16>,
    sent_bytes: Arc<Mutex<Vec<u8>>>,
}

impl RecordingProxy {
    pub fn start(firmware_port: u16) -> Result<Self, Failed> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let wire = Self {
            listen_port: listener.local_addr()?.port(),
            firmware_port: Arc::new(AtomicU16::new(firmware_port)),
            sent_bytes: Arc::default(),
        };
        let served = wire.clone();
        // The thread ends with this process.
        thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                // A client of a firmware that is not running sees its connection closed.
                let _ = served.forward_client(client);
            }
        });
        Ok(wire)
    }

    pub fn set_firmware_port(&self, firmware_port: u16) {
        self.firmware_port.store(firmware_port, Ordering::SeqCst);
    }

    fn forward_client(&self, client: TcpStream) -> std::io::Result<()> {
        let port = self.firmware_port.load(Ordering::SeqCst);
        let firmware = TcpStream::connect(("127.0.0.1", port))?;
        let sent = Arc::clone(&self.sent_bytes);
        let record = move |bytes: &[u8]| {
            sent.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        };
        forward_bytes(client.try_clone()?, firmware.try_clone()?, record);
        forward_bytes(firmware, client, |_| {});
        Ok(())
    }

    /// The lines to the firmware since the last call of `clear_record`, without real-time commands.
    pub fn sent_lines(&self) -> Vec<String> {
        let sent = self.sent_bytes.lock().unwrap_or_else(PoisonError::into_inner);
        let is_text = |byte: &&u8| **byte == b'\n' || (b' '..=b'~').contains(*byte);
        let text = sent.iter().filter(is_text).filter(|byte| !b"?!~".contains(*byte));
        let text = String::from_utf8_lossy(&text.copied().collect::<Vec<u8>>()).into_owned();
        text.lines().map(str::to_owned).collect()
    }

    /// The recorded lines that move an axis.
    pub fn sent_motions(&self) -> Vec<String> {
        let is_motion = |line: &String| {
            let moves = |word: &str| ["G0", "G1", "G2", "G3", "G28", "G30"].contains(&word) || word.starts_with("G38");
            line.starts_with("$H")
                || line.starts_with("$J")
                || (!line.starts_with('(') && line.split_whitespace().any(moves))
        };
        self.sent_lines().into_iter().filter(is_motion).collect()
    }

    pub fn clear_record(&self) {
        self.sent_bytes.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// Copies bytes until one side closes, then closes both.
fn forward_bytes(mut from: TcpStream, mut to: TcpStream, record: impl Fn(&[u8]) + Send + 'static) {
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            record(&bytes[..count]);
            if to.write_all(&bytes[..count]).is_err() {
                break;
            }
        }
        let _ = from.shutdown(Shutdown::Both);
        let _ = to.shutdown(Shutdown::Both);
    });
}
