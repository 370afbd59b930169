//! Notifications to systemd, received by a socket in its place.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::served_machine::served_machine;
use crate::support::daemon_process::DaemonProcess;
use crate::support::machine_shop::MachineShop;
use rusqlite::Connection;

/// Value of `WatchdogSec=`.
const WATCHDOG: Duration = Duration::from_secs(3);
const PATIENCE: Duration = Duration::from_secs(120);

/// Reads every notification at once, as systemd does.
struct Systemd(Receiver<String>);

impl Systemd {
    fn at(path: &Path) -> Self {
        let socket = UnixDatagram::bind(path).unwrap();
        let (told, heard) = channel();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(count) = socket.recv(&mut buffer) {
                let said = String::from_utf8_lossy(&buffer[..count]).into_owned();
                if told.send(said).is_err() {
                    return;
                }
            }
        });
        Self(heard)
    }

    fn supervises(path: &Path) -> impl FnOnce(&mut Command) {
        let path = path.to_owned();
        move |command| {
            command.env("NOTIFY_SOCKET", path);
            command.env("WATCHDOG_USEC", WATCHDOG.as_micros().to_string());
        }
    }

    fn hears_within(&self, time: Duration) -> Option<String> {
        self.0.recv_timeout(time).ok()
    }

    /// Waits for a notification; returns all that were received.
    fn until(&self, word: &str) -> Vec<String> {
        let (began, mut heard) = (Instant::now(), Vec::new());
        while began.elapsed() < PATIENCE {
            heard.extend(self.hears_within(Duration::from_secs(1)));
            if heard.last().is_some_and(|heard| heard.contains(word)) {
                return heard;
            }
        }
        panic!("no {word} in {heard:?}");
    }

    /// Whether a watchdog notification has been received so far, or is received within `time`.
    fn is_fed_within(&self, time: Duration) -> bool {
        let began = Instant::now();
        let mut fed = false;
        while let Some(left) = time.checked_sub(began.elapsed()).filter(|left| !left.is_zero()) {
            fed |= self.hears_within(left).is_some_and(|heard| heard.contains("WATCHDOG=1"));
        }
        fed
    }

    fn forget(&self) {
        while self.hears_within(Duration::from_millis(50)).is_some() {}
    }
}

fn supervised(shop: &MachineShop, speed: &str) -> (DaemonProcess, Systemd) {
    let path = shop.path("notify");
    let systemd = Systemd::at(&path);
    let machine = shop.path("machine.toml").display().to_string();
    let arguments = ["--machine", &machine, "--speed", speed];
    (shop.serve_as(&arguments, Systemd::supervises(&path)), systemd)
}

pub fn systemd_is_told_how_it_goes_and_misses_a_daemon_that_stands_still() {
    let shop = MachineShop::new(&served_machine(""));
    let (daemon, systemd) = supervised(&shop, "real");
    let first = systemd.until("READY=1");
    assert!(first.last().unwrap().contains("simulated five-axis machine: waiting"), "{first:?}");
    systemd.until("WATCHDOG=1");
    daemon.signal("STOP");
    systemd.forget();
    assert!(!systemd.is_fed_within(WATCHDOG));
    daemon.signal("CONT");
    systemd.until("WATCHDOG=1");
    assert_eq!(daemon.http().start(1), 202);
    systemd.until("STATUS=simulated five-axis machine: run 1, ");
    daemon.http().wait_until(|standing| standing["measured"].as_u64() > Some(0));
    // As `systemctl stop` does it; the unit treats exit code 5 as success.
    assert_eq!(daemon.terminate(), 5);
    systemd.until("STOPPING=1");
    let resumed = shop.trued(&["resume", "1"]);
    let told = String::from_utf8_lossy(&resumed.stderr);
    assert!(told.contains("the name of the operator who has checked the machine is missing"), "{told}");
    std::fs::remove_file(shop.path("notify")).unwrap();
    let (daemon, systemd) = supervised(&shop, "fast");
    systemd.until("STATUS=simulated five-axis machine: held");
    assert_eq!(daemon.terminate(), 0);
}

/// The disk of the journal does not respond, here because the database is locked: the worker waits, while all other
/// threads run. The watchdog is not fed, and the machine is held.
pub fn a_worker_that_hangs_is_fed_for_by_nobody() {
    let shop = MachineShop::new(&served_machine("patience_s = 1.0\n"));
    let (daemon, systemd) = supervised(&shop, "fast");
    systemd.until("WATCHDOG=1");
    let journal = Connection::open(shop.state().join("journal.sqlite")).unwrap();
    journal.execute_batch("BEGIN IMMEDIATE").unwrap();
    let client = daemon.http();
    // The response waits for the journal as well.
    let start = std::thread::spawn(move || client.start(1));
    let began = Instant::now();
    while !daemon.log().contains("the systemd watchdog is no longer notified") {
        assert!(began.elapsed() < PATIENCE, "{}", daemon.log());
        sleep(Duration::from_millis(10));
    }
    systemd.forget();
    assert!(!systemd.is_fed_within(WATCHDOG));
    // The daemon still responds.
    assert_eq!(daemon.http().machine()["state"], "running");
    journal.execute_batch("ROLLBACK").unwrap();
    systemd.until("WATCHDOG=1");
    start.join().unwrap();
    daemon.http().wait_for_state("held");
    assert!(daemon.log().contains("hold requested by the watchdog"));
    assert_eq!(daemon.terminate(), 0);
}
