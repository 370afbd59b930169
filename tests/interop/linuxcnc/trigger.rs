//! The button on the control: LinuxCNC requests a cycle from `trued serve` through mb2hal and a user M code, and
//! reads the progress in HAL. The cycle is measured on the same LinuxCNC.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::Child;
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;

use super::desk::Desk;
use super::rig::{Rig, free_port, halcmd, load, rig};

const MB2HAL: &str = include_str!("../../peers/linuxcnc/mb2hal.ini");
const HAL: &str = include_str!("../../peers/linuxcnc/trued.hal");
const PATIENCE: Duration = Duration::from_secs(20);
const CYCLE: Duration = Duration::from_secs(240);
/// Maximum time after which HAL detects that the daemon is dead.
const DEAD: Duration = Duration::from_secs(2);

/// The daemon and its HAL components; both end with this value.
struct Button {
    daemon: Child,
    directory: PathBuf,
}

impl Drop for Button {
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
            if let Err(failed) = load(&self.directory, arguments) {
                eprintln!("{}", failed.message().unwrap_or_default());
            }
        }
    }
}

impl Button {
    /// Starts the daemon; loads mb2hal and the watchdog.
    fn wired(rig: &Rig) -> Result<(Self, Desk), Failed> {
        let port = free_port().map_err(|error| error.to_string())?;
        let desk = Desk::serving(rig, port)?;
        let mut button = Self { daemon: desk.serve()?, directory: rig.directory.clone() };
        listen(&mut button.daemon)?;
        let ini = MB2HAL.replace("TCP_PORT=1502", &format!("TCP_PORT={port}"));
        std::fs::write(rig.directory.join("mb2hal.ini"), ini)?;
        std::fs::write(rig.directory.join("trued.hal"), HAL)?;
        load(&rig.directory, &["loadusr", "-Wn", "mb2hal", "mb2hal", "config=mb2hal.ini"])?;
        load(&rig.directory, &["-f", "trued.hal"])?;
        until("trued.alive", PATIENCE, |alive| alive == "TRUE")?;
        Ok((button, desk))
    }
}

/// Waits until the daemon is ready; then continues to read its log, so that it never blocks.
fn listen(daemon: &mut Child) -> Result<(), Failed> {
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

fn pin(name: &str) -> Result<String, Failed> {
    halcmd(&["getp", name])
}

fn status(name: &str) -> Result<i64, Failed> {
    Ok(pin(&format!("mb2hal.status.{name}.int"))?.parse()?)
}

fn set(name: &str, value: &str) -> Result<(), Failed> {
    halcmd(&["setp", &format!("mb2hal.{name}.bit"), value]).map(drop)
}

/// Waits for the condition; returns the duration.
fn until(name: &str, most: Duration, right: impl Fn(&str) -> bool) -> Result<Duration, Failed> {
    let started = Instant::now();
    loop {
        let value = pin(name)?;
        if right(&value) {
            return Ok(started.elapsed());
        }
        if started.elapsed() > most {
            return Err(format!("after {most:?} {name} is {value}").into());
        }
        sleep(Duration::from_millis(10));
    }
}

fn until_status(name: &str, wanted: i64, most: Duration) -> Result<Duration, Failed> {
    let pin = format!("mb2hal.status.{name}.int");
    until(&pin, most, |value| value == wanted.to_string())
}

fn equal(name: &str, wanted: i64) -> Result<(), Failed> {
    match status(name)? {
        found if found == wanted => Ok(()),
        found => Err(format!("{name} is {found}, not {wanted}").into()),
    }
}

pub fn a_hal_bit_starts_a_cycle() -> Result<(), Failed> {
    let rig = rig()?;
    let (mut button, desk) = Button::wired(&rig)?;
    until_status("state", 1, PATIENCE)?;
    let mut person = rig.person()?;

    // The door is closed and the machine enabled; the key switch is off.
    set("machine.door", "1")?;
    person.mdi("M110")?;
    until_status("refusal", 5, PATIENCE)?;
    equal("accepted", 0)?;

    set("machine.enable", "1")?;
    until("mb2hal.status.said.int", PATIENCE, |said| said == "15")?;
    sleep(Duration::from_millis(500));
    person.mdi("M110")?;
    until_status("state", 2, PATIENCE)?;
    until_status("run", 1, PATIENCE)?;
    equal("verdict", 0)?;

    // The button is pressed again.
    sleep(Duration::from_millis(500));
    set("start.cycle-1", "1")?;
    until_status("refused", 2, PATIENCE)?;
    equal("refusal", 1)?;
    set("start.cycle-1", "0")?;

    follow()?;
    until_status("state", 1, PATIENCE)?;
    equal("verdict", 1)?;
    equal("progress", 100)?;
    equal("accepted", 1)?;
    desk.is("finished")?;

    if pin("trued.alive")? != "TRUE" {
        return Err("HAL takes a living daemon for dead".into());
    }
    button.daemon.kill()?;
    let seen = until("trued.alive", PATIENCE, |alive| alive == "FALSE")?;
    eprintln!("HAL knows that the daemon is dead after {seen:?}");
    // The pins of mb2hal do not show it.
    equal("state", 1)?;
    if seen > DEAD { Err(format!("a dead daemon is seen after {seen:?}").into()) } else { Ok(()) }
}

/// Waits for the end of the run: its progress increases in steps.
fn follow() -> Result<(), Failed> {
    let (started, mut seen) = (Instant::now(), vec![0]);
    while status("state")? == 2 {
        if started.elapsed() > CYCLE {
            return Err(format!("it does not end; progress {seen:?}").into());
        }
        let progress = status("progress")?;
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
