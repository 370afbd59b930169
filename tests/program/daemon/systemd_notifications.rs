//! Notifications to systemd, received by a socket in its place.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::served_machine::served_machine_toml;
use crate::support::daemon_process::DaemonProcess;
use crate::support::machine_shop::MachineShop;
use rusqlite::Connection;

/// Value of `WatchdogSec=`.
const WATCHDOG_TIMEOUT: Duration = Duration::from_secs(3);
const NOTIFICATION_TIMEOUT: Duration = Duration::from_secs(120);

/// Reads every notification at once, as systemd does.
struct NotifySocket(Receiver<String>);

impl NotifySocket {
    fn bind(path: &Path) -> Self {
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

    fn set_environment(path: &Path) -> impl FnOnce(&mut Command) {
        let path = path.to_owned();
        move |command| {
            command.env("NOTIFY_SOCKET", path);
            command.env("WATCHDOG_USEC", WATCHDOG_TIMEOUT.as_micros().to_string());
        }
    }

    fn receive_within(&self, time: Duration) -> Option<String> {
        self.0.recv_timeout(time).ok()
    }

    /// Waits for a notification; returns all that were received.
    fn wait_for_notification(&self, word: &str) -> Vec<String> {
        let (began, mut heard) = (Instant::now(), Vec::new());
        while began.elapsed() < NOTIFICATION_TIMEOUT {
            heard.extend(self.receive_within(Duration::from_secs(1)));
            if heard.last().is_some_and(|heard| heard.contains(word)) {
                return heard;
            }
        }
        panic!("no {word} in {heard:?}");
    }

    /// Whether a watchdog notification has been received so far, or is received within `time`.
    fn receives_watchdog_within(&self, time: Duration) -> bool {
        let began = Instant::now();
        let mut fed = false;
        while let Some(left) = time.checked_sub(began.elapsed()).filter(|left| !left.is_zero()) {
            fed |= self.receive_within(left).is_some_and(|heard| heard.contains("WATCHDOG=1"));
        }
        fed
    }

    fn discard_received(&self) {
        while self.receive_within(Duration::from_millis(50)).is_some() {}
    }
}

fn start_daemon_with_notify_socket(shop: &MachineShop, speed: &str) -> (DaemonProcess, NotifySocket) {
    let path = shop.path("notify");
    let systemd = NotifySocket::bind(&path);
    let machine = shop.path("machine.toml").display().to_string();
    let arguments = ["--machine", &machine, "--speed", speed];
    (shop.start_prepared_daemon(&arguments, NotifySocket::set_environment(&path)), systemd)
}

pub fn systemd_gets_status_and_no_watchdog_from_a_stopped_process() {
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let (daemon, systemd) = start_daemon_with_notify_socket(&shop, "real");
    let first = systemd.wait_for_notification("READY=1");
    assert!(first.last().unwrap().contains("simulated five-axis machine: waiting"), "{first:?}");
    systemd.wait_for_notification("WATCHDOG=1");
    daemon.send_signal("STOP");
    systemd.discard_received();
    assert!(!systemd.receives_watchdog_within(WATCHDOG_TIMEOUT));
    daemon.send_signal("CONT");
    systemd.wait_for_notification("WATCHDOG=1");
    assert_eq!(daemon.http().start_cycle(1), 202);
    systemd.wait_for_notification("STATUS=simulated five-axis machine: run 1, ");
    daemon.http().wait_until_machine_state(|standing| standing["measured"].as_u64() > Some(0));
    // As `systemctl stop` does it; the unit treats exit code 5 as success.
    assert_eq!(daemon.terminate(), 5);
    systemd.wait_for_notification("STOPPING=1");
    let resumed = shop.run_trued(&["resume", "1"]);
    let told = String::from_utf8_lossy(&resumed.stderr);
    assert!(told.contains("the name of the operator who has checked the machine is missing"), "{told}");
    std::fs::remove_file(shop.path("notify")).unwrap();
    let (daemon, systemd) = start_daemon_with_notify_socket(&shop, "fast");
    systemd.wait_for_notification("STATUS=simulated five-axis machine: held");
    assert_eq!(daemon.terminate(), 0);
}

/// The disk of the journal does not respond, here because the database is locked: the worker waits, while all other
/// threads run. The watchdog is not fed, and the machine is held.
pub fn watchdog_is_not_notified_while_the_worker_hangs() {
    let shop = MachineShop::with_machine_file(&served_machine_toml("patience_s = 1.0\n"));
    let (daemon, systemd) = start_daemon_with_notify_socket(&shop, "fast");
    systemd.wait_for_notification("WATCHDOG=1");
    let journal = Connection::open(shop.state_folder().join("journal.sqlite")).unwrap();
    journal.execute_batch("BEGIN IMMEDIATE").unwrap();
    let client = daemon.http();
    // The response waits for the journal as well.
    let start = std::thread::spawn(move || client.start_cycle(1));
    let began = Instant::now();
    while !daemon.log().contains("the systemd watchdog is no longer notified") {
        assert!(began.elapsed() < NOTIFICATION_TIMEOUT, "{}", daemon.log());
        sleep(Duration::from_millis(10));
    }
    systemd.discard_received();
    assert!(!systemd.receives_watchdog_within(WATCHDOG_TIMEOUT));
    // The daemon still responds.
    assert_eq!(daemon.http().machine_state()["state"], "running");
    journal.execute_batch("ROLLBACK").unwrap();
    systemd.wait_for_notification("WATCHDOG=1");
    start.join().unwrap();
    daemon.http().wait_for_state("held");
    assert!(daemon.log().contains("hold requested by the watchdog"));
    assert_eq!(daemon.terminate(), 0);
}
