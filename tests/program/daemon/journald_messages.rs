//! Messages to journald: a socket replaces it, in a separate mount namespace of the daemon, decoded by systemd's
//! "Native Journal Protocol". Without the right to mount (root) the tests are skipped; with `TRUED_REQUIRE_PEERS=1`
//! they fail.

use std::collections::BTreeSet;
use std::os::unix::net::UnixDatagram;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::served_machine::served_machine_toml;
use crate::support::daemon_process::DaemonProcess;
use crate::support::machine_shop::MachineShop;
use serde_json::json;
use trued::store::{Journal, RunId};

const ENTRY_TIMEOUT: Duration = Duration::from_secs(60);
/// As under systemd: standard error is the journal's, and an environment variable identifies that file.
const JOURNALD_SCRIPT: &str = "mount -t tmpfs none /run && mkdir -p /run/systemd/journal && \
                      mount --bind \"$0\" /run/systemd/journal && \
                      export JOURNAL_STREAM=$(stat -L -c %d:%i /proc/self/fd/2) && exec \"$@\"";

/// The simulated control restarts during the run.
const RESET_FAULT: &str = "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 3\n";

/// Name and value of each field.
type JournaldEntry = Vec<(String, String)>;

/// Parses fields `NAME=value`, or the name, the value's length in eight bytes, and the value; one field per line.
fn parse_journald_entry(mut bytes: &[u8]) -> JournaldEntry {
    let mut fields = Vec::new();
    while let Some(end) = bytes.iter().position(|byte| *byte == b'\n') {
        let (line, rest) = (String::from_utf8(bytes[..end].to_vec()).unwrap(), &bytes[end + 1..]);
        if let Some((name, value)) = line.split_once('=') {
            fields.push((name.to_owned(), value.to_owned()));
            bytes = rest;
            continue;
        }
        let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
        fields.push((line, String::from_utf8(rest[8..8 + length].to_vec()).unwrap()));
        bytes = &rest[8 + length + 1..];
    }
    fields
}

fn entry_field<'a>(entry: &'a [(String, String)], name: &str) -> Option<&'a str> {
    entry.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
}

#[derive(Clone)]
struct JournaldReceiver(Arc<Mutex<Vec<JournaldEntry>>>);

impl JournaldReceiver {
    fn receive_from(socket: UnixDatagram) -> Self {
        let heard = Self(Arc::default());
        let keeps = heard.clone();
        std::thread::spawn(move || {
            let mut buffer = vec![0; 1 << 16];
            while let Ok(count) = socket.recv(&mut buffer) {
                keeps.0.lock().unwrap().push(parse_journald_entry(&buffer[..count]));
            }
        });
        heard
    }

    /// Waits for the entry whose message starts with `words`.
    fn wait_for_entry(&self, words: &str) -> JournaldEntry {
        let began = Instant::now();
        loop {
            let all = self.0.lock().unwrap().clone();
            let begins =
                |entry: &&JournaldEntry| entry_field(entry, "MESSAGE").is_some_and(|said| said.starts_with(words));
            if let Some(entry) = all.iter().find(begins) {
                return entry.clone();
            }
            assert!(began.elapsed() < ENTRY_TIMEOUT, "no {words} in {all:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn can_mount() -> bool {
    let mounts = Command::new("unshare")
        .args(["--mount", "sh", "-c", "mount -t tmpfs none /run"])
        .stderr(Stdio::null())
        .status();
    let may = mounts.is_ok_and(|status| status.success());
    let required = std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1");
    assert!(may || !required, "no mount namespace: run this as root");
    may
}

/// Starts the daemon with a separate journald socket.
fn start_daemon_with_journald(shop: &MachineShop, speed: &str) -> (DaemonProcess, JournaldReceiver) {
    let folder = shop.path("journald");
    std::fs::create_dir(&folder).unwrap();
    let journald = JournaldReceiver::receive_from(UnixDatagram::bind(folder.join("socket")).unwrap());
    let mut command = Command::new("unshare");
    command.args(["--mount", "sh", "-c", JOURNALD_SCRIPT]).arg(&folder).arg(env!("CARGO_BIN_EXE_trued"));
    command.args(["serve", "--speed", speed, "--machine"]).arg(shop.path("machine.toml"));
    let child = command.arg("--state").arg(shop.state_folder()).stderr(Stdio::piped()).spawn().unwrap();
    let daemon = DaemonProcess { child, log: Arc::default() };
    let page = journald.wait_for_entry("the page is at http://127.0.0.1:");
    // Nothing is written to standard error if journald is connected.
    let message = entry_field(&page, "MESSAGE").unwrap();
    daemon.log.lock().unwrap().push_str(&format!("{message}\n"));
    journald.wait_for_entry("ready");
    (daemon, journald)
}

/// Each step in the run's journal has a log entry with the number of its run and the type of the step.
pub fn each_step_has_a_journald_entry_of_its_run() {
    if !can_mount() {
        println!("skipped, for this is not root");
        return;
    }
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let (daemon, journald) = start_daemon_with_journald(&shop, "fast");
    assert_eq!(daemon.http().start_cycle(1), 202);
    daemon.http().wait_for_state("waiting");
    assert_eq!(daemon.terminate(), 0);
    let readings = Journal::open(&shop.state_folder()).unwrap().load_run(RunId(1)).unwrap().readings;
    let measured: BTreeSet<String> = readings.iter().map(|one| one.step.to_string()).collect();
    assert!(measured.len() > 10);
    let all = journald.0.lock().unwrap().clone();
    let steps = all.iter().filter(|entry| entry_field(entry, "TRUED_RUN") == Some("1"));
    let steps = steps.filter_map(|entry| Some((entry_field(entry, "TRUED_STEP")?, entry)));
    let mut told = BTreeSet::new();
    for (step, entry) in steps {
        assert_eq!(entry_field(entry, "TRUED_MACHINE"), Some("simulated five-axis machine"));
        // Informational: below the daemon's regular messages.
        assert_eq!(entry_field(entry, "PRIORITY"), Some("6"), "{entry:?}");
        told.insert(step.to_owned());
    }
    assert!(told.is_superset(&measured), "{told:?} {measured:?}");
}

/// Syslog priorities.
const PRIORITY_ERR: Option<&str> = Some("3");
const PRIORITY_NOTICE: Option<&str> = Some("5");

/// A hold comes from the thread of the page and is found by the number of the run that it held; it is not a fault.
pub fn hold_and_fault_have_run_and_priority_in_journald() {
    if !can_mount() {
        println!("skipped, for this is not root");
        return;
    }
    let told = |entry: &JournaldEntry| {
        let [run, priority] = ["TRUED_RUN", "PRIORITY"].map(|name| entry_field(entry, name));
        (run.map(str::to_owned), priority.map(str::to_owned))
    };
    let is = |run: Option<&str>, priority: Option<&str>| (run.map(str::to_owned), priority.map(str::to_owned));
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let (daemon, journald) = start_daemon_with_journald(&shop, "real");
    assert_eq!(daemon.http().start_cycle(1), 202);
    daemon.http().wait_until_machine_state(|standing| standing["measured"].as_u64().unwrap() > 0);
    assert_eq!(daemon.http().post_action("hold", &json!({})).0, 202);
    assert_eq!(
        told(&journald.wait_for_entry("hold requested by an unnamed person at the page")),
        is(Some("1"), PRIORITY_NOTICE)
    );
    assert_eq!(told(&journald.wait_for_entry("run 1: ")), is(Some("1"), PRIORITY_NOTICE));
    assert_eq!(told(&journald.wait_for_entry("ready")), is(None, PRIORITY_NOTICE));
    let shop = MachineShop::with_machine_file(&served_machine_toml("").replacen(
        "[serve]",
        &format!("{RESET_FAULT}[serve]"),
        1,
    ));
    let (daemon, journald) = start_daemon_with_journald(&shop, "fast");
    assert_eq!(daemon.http().start_cycle(1), 202);
    daemon.http().wait_for_state("held");
    assert_eq!(told(&journald.wait_for_entry("run 1: ")), is(Some("1"), PRIORITY_ERR));
    assert_eq!(told(&journald.wait_for_entry("run 1 begins")), is(Some("1"), PRIORITY_NOTICE));
}
