//! The wall clock of the daemon and of the commands; and a machine that reports its state.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{sleep, spawn};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use jiff::Timestamp;

pub struct FakeClock {
    folder: tempfile::TempDir,
}

impl FakeClock {
    /// A clock that shows `now`.
    pub fn with_time(now: &str) -> Self {
        let wall = Self { folder: tempfile::tempdir().unwrap() };
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/clock/shim.c");
        let mut compiler = Command::new("cc");
        compiler.args(["-Wall", "-Werror", "-shared", "-fPIC", "-O1", "-o"]);
        let compiled = compiler.arg(wall.preload_library()).arg(source).output().unwrap();
        assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
        wall.set_time(now);
        wall
    }

    fn preload_library(&self) -> PathBuf {
        self.folder.path().join("clock.so")
    }

    fn offset_file(&self) -> PathBuf {
        self.folder.path().join("ahead")
    }

    /// Sets the time to `now`, from which it advances.
    pub fn set_time(&self, now: &str) {
        let now: Timestamp = now.parse().unwrap();
        let real = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
        // Replaced atomically: a reader gets the old or the new time.
        let new = self.folder.path().join("new");
        fs::write(&new, (now.as_second() - real as i64).to_string()).unwrap();
        fs::rename(&new, self.offset_file()).unwrap();
    }

    pub fn environment_variables(&self) -> Vec<(String, String)> {
        let text = |path: PathBuf| path.display().to_string();
        vec![
            ("LD_PRELOAD".to_owned(), text(self.preload_library())),
            ("SET_CLOCK".to_owned(), text(self.offset_file())),
        ]
    }
}

/// The machine's side of the text line over TCP: sends its interlocks every 200 ms.
pub struct InterlockServer {
    pub port: u16,
    interlock_line: Arc<Mutex<String>>,
    acknowledged_line_count: Arc<AtomicUsize>,
}

pub const READY_INTERLOCK_LINE: &str = "TELL ENABLE AUTO DOOR";

impl InterlockServer {
    pub fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let words = Arc::new(Mutex::new(READY_INTERLOCK_LINE.to_owned()));
        let told = Arc::clone(&words);
        let heard = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&heard);
        spawn(move || {
            for stream in listener.incoming() {
                let Ok(mut stream) = stream else { return };
                let mut answers = BufReader::new(stream.try_clone().unwrap());
                loop {
                    let words = told.lock().unwrap().clone();
                    let mut answer = String::new();
                    let sent = stream.write_all(format!("{words}\r\n").as_bytes());
                    if sent.is_err() || !answers.read_line(&mut answer).is_ok_and(|n| n > 0) {
                        break;
                    }
                    assert_eq!(answer.trim(), "OK");
                    count.fetch_add(1, Ordering::SeqCst);
                    sleep(Duration::from_millis(200));
                }
            }
        });
        Self { port, interlock_line: words, acknowledged_line_count: heard }
    }

    /// Sends `line` from now on; returns after the daemon has received them.
    pub fn set_interlocks(&self, line: &str) {
        *self.interlock_line.lock().unwrap() = line.to_owned();
        // One line that was already in transit, and one with the new text.
        let before = self.acknowledged_line_count.load(Ordering::SeqCst);
        while self.acknowledged_line_count.load(Ordering::SeqCst) < before + 2 {
            sleep(Duration::from_millis(20));
        }
    }
}
