//! The button on the control: LinuxCNC requests a cycle from `trued serve` through mb2hal and a user M code, and
//! reads the progress in HAL. The cycle is measured on the same LinuxCNC.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::Child;
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;

use super::rig::{LinuxCncRig, free_port, halcmd, lock_rig, run_component_halcmd};
use super::run_workspace::RunWorkspace;

const MB2HAL_INI_FILE: &str = include_str!("../../peers/linuxcnc/mb2hal.ini");
const TRUED_HAL_FILE: &str = include_str!("../../peers/linuxcnc/trued.hal");
const PIN_TIMEOUT: Duration = Duration::from_secs(20);
const CYCLE_TIMEOUT: Duration = Duration::from_secs(240);
/// Maximum time after which HAL detects that the daemon is dead.
const MAX_DEAD_DAEMON_DETECTION_TIME: Duration = Duration::from_secs(2);

/// The daemon and its HAL components; both end with this value.
struct DaemonWithHal {
    daemon: Child,
    rig_directory: PathBuf,
}

impl Drop for DaemonWithHal {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
        let undo: [&[&str]; 6] = [
            &["unloadusr", "mb2hal"],
            &["delf", "trued", "servo-thread"],
            &["unloadrt", "trued_watch"],
            &["delsig", "trued-heartbeat"],
            &["delsig", "trued-beat"],
            &["delsig", "trued-auto"],
        ];
        for arguments in undo {
            if let Err(failed) = run_component_halcmd(&self.rig_directory, arguments) {
                eprintln!("{}", failed.message().unwrap_or_default());
            }
        }
    }
}

impl DaemonWithHal {
    /// Starts the daemon; loads mb2hal and the watchdog.
    fn start_daemon_and_hal(rig: &LinuxCncRig) -> Result<(Self, RunWorkspace), Failed> {
        let port = free_port().map_err(|error| error.to_string())?;
        let workspace = RunWorkspace::with_modbus_trigger(rig, port)?;
        let mut button = Self { daemon: workspace.start_daemon()?, rig_directory: rig.directory.clone() };
        wait_until_daemon_is_ready(&mut button.daemon)?;
        let ini = MB2HAL_INI_FILE.replace("TCP_PORT=1502", &format!("TCP_PORT={port}"));
        std::fs::write(rig.directory.join("mb2hal.ini"), ini)?;
        std::fs::write(rig.directory.join("trued.hal"), TRUED_HAL_FILE)?;
        run_component_halcmd(&rig.directory, &["loadusr", "-Wn", "mb2hal", "mb2hal", "config=mb2hal.ini"])?;
        run_component_halcmd(&rig.directory, &["-f", "trued.hal"])?;
        wait_for_hal_pin("trued.alive", PIN_TIMEOUT, |alive| alive == "TRUE")?;
        Ok((button, workspace))
    }
}

/// Waits until the daemon is ready; then continues to read its log, so that it never blocks.
fn wait_until_daemon_is_ready(daemon: &mut Child) -> Result<(), Failed> {
    let mut told = BufReader::new(daemon.stderr.take().ok_or("no log")?).lines();
    let mut all = String::new();
    for line in told.by_ref() {
        let line = line?;
        eprintln!("  {line}");
        if line == "ready" {
            std::thread::spawn(move || told.map_while(Result::ok).for_each(|l| eprintln!("  {l}")));
            return Ok(());
        }
        all += &line;
    }
    Err(format!("it does not serve: {all}").into())
}

fn hal_pin_value(name: &str) -> Result<String, Failed> {
    halcmd(&["getp", name])
}

fn status_pin_value(name: &str) -> Result<i64, Failed> {
    Ok(hal_pin_value(&format!("mb2hal.status.{name}.int"))?.parse()?)
}

fn set_mb2hal_bit(name: &str, value: &str) -> Result<(), Failed> {
    halcmd(&["setp", &format!("mb2hal.{name}.bit"), value]).map(drop)
}

/// Waits for the condition; returns the duration.
fn wait_for_hal_pin(name: &str, most: Duration, right: impl Fn(&str) -> bool) -> Result<Duration, Failed> {
    let started = Instant::now();
    loop {
        let value = hal_pin_value(name)?;
        if right(&value) {
            return Ok(started.elapsed());
        }
        if started.elapsed() > most {
            return Err(format!("after {most:?} {name} is {value}").into());
        }
        sleep(Duration::from_millis(10));
    }
}

fn wait_for_status_pin(name: &str, wanted: i64, most: Duration) -> Result<Duration, Failed> {
    let pin = format!("mb2hal.status.{name}.int");
    wait_for_hal_pin(&pin, most, |value| value == wanted.to_string())
}

fn check_status_pin(name: &str, wanted: i64) -> Result<(), Failed> {
    match status_pin_value(name)? {
        found if found == wanted => Ok(()),
        found => Err(format!("{name} is {found}, not {wanted}").into()),
    }
}

pub fn hal_starts_a_cycle_and_detects_a_dead_daemon() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let (mut button, workspace) = DaemonWithHal::start_daemon_and_hal(&rig)?;
    wait_for_status_pin("state", 1, PIN_TIMEOUT)?;
    let mut person = rig.connect_client()?;

    // The door is closed and the machine enabled; the key switch is off.
    set_mb2hal_bit("machine.door", "1")?;
    person.run_mdi("M110")?;
    wait_for_status_pin("refusal", 5, PIN_TIMEOUT)?;
    check_status_pin("accepted", 0)?;

    set_mb2hal_bit("machine.enable", "1")?;
    wait_for_hal_pin("mb2hal.status.said.int", PIN_TIMEOUT, |said| said == "15")?;
    sleep(Duration::from_millis(500));
    person.run_mdi("M110")?;
    wait_for_status_pin("state", 2, PIN_TIMEOUT)?;
    wait_for_status_pin("run", 1, PIN_TIMEOUT)?;
    check_status_pin("verdict", 0)?;

    // The button is pressed again.
    sleep(Duration::from_millis(500));
    set_mb2hal_bit("start.cycle-1", "1")?;
    wait_for_status_pin("refused", 2, PIN_TIMEOUT)?;
    check_status_pin("refusal", 1)?;
    set_mb2hal_bit("start.cycle-1", "0")?;

    wait_for_cycle_end_with_rising_progress()?;
    wait_for_status_pin("state", 1, PIN_TIMEOUT)?;
    check_status_pin("verdict", 1)?;
    check_status_pin("progress", 100)?;
    check_status_pin("accepted", 1)?;
    workspace.check_last_run_state("finished")?;

    if hal_pin_value("trued.alive")? != "TRUE" {
        return Err("HAL takes a living daemon for dead".into());
    }
    button.daemon.kill()?;
    let seen = wait_for_hal_pin("trued.alive", PIN_TIMEOUT, |alive| alive == "FALSE")?;
    eprintln!("HAL knows that the daemon is dead after {seen:?}");
    // The pins of mb2hal do not show it.
    check_status_pin("state", 1)?;
    if seen > MAX_DEAD_DAEMON_DETECTION_TIME {
        Err(format!("a dead daemon is seen after {seen:?}").into())
    } else {
        Ok(())
    }
}

/// Waits for the end of the run: its progress increases in steps.
fn wait_for_cycle_end_with_rising_progress() -> Result<(), Failed> {
    let (started, mut seen) = (Instant::now(), vec![0]);
    while status_pin_value("state")? == 2 {
        if started.elapsed() > CYCLE_TIMEOUT {
            return Err(format!("it does not end; progress {seen:?}").into());
        }
        let progress = status_pin_value("progress")?;
        if seen.last() != Some(&progress) {
            seen.push(progress);
        }
        sleep(Duration::from_millis(100));
    }
    eprintln!("progress {seen:?} in {:.0} s", started.elapsed().as_secs_f64());
    match seen.len() > 10 && seen.is_sorted() {
        true => Ok(()),
        false => Err(format!("progress {seen:?}").into()),
    }
}
