//! Notifications to systemd: the daemon is ready, its status, the watchdog, the daemon ends. Without
//! `NOTIFY_SOCKET` none is sent, but hung work is still detected and its machine held.
//!
//! The watchdog is fed only while every machine's worker makes progress within the time that the worker has
//! announced ([`CommandGate::report_progress`]): a live thread does not mask a hung one.

use std::thread::{Builder, sleep};
use std::time::{Duration, Instant};

use sd_notify::NotifyState::{self, Ready, Status, Stopping, Watchdog};

use super::command_gate::CommandGate;
use super::machine_state::State;
use super::{Log, ServeError};

/// Maximum time between two checks of the workers.
const TICK: Duration = Duration::from_secs(1);

/// Watched machines: name and gate of each.
pub type Watched = Vec<(String, CommandGate)>;

/// Notifies systemd that the daemon is ready, and watches the workers for as long as the process lives.
///
/// # Errors
/// The thread cannot be started.
pub fn ready(watched: Watched, log: &Log) -> Result<(), ServeError> {
    tell(&[Ready, Status(&status(&watched))], log);
    let (mut watch, log) = (Watch::new(watched), log.clone());
    let third = sd_notify::watchdog_enabled().map(|whole| whole / 3);
    let thread = Builder::new().name("watchdog".to_owned());
    let thread = thread.spawn(move || look(&mut watch, third, &log));
    thread.map(drop).map_err(ServeError::Thread)
}

/// `third`: one third of systemd's watchdog timeout; `None` without a watchdog.
fn look(watch: &mut Watch, third: Option<Duration>, log: &Log) {
    let (mut fed, mut told) = (Instant::now(), String::new());
    loop {
        let live = watch.all_live(log);
        if live && third.is_some_and(|third| fed.elapsed() >= third) {
            fed = Instant::now();
            tell(&[Watchdog], log);
        }
        let now = status(&watch.watched);
        if now != told {
            tell(&[Status(&now)], log);
            told = now;
        }
        sleep(third.map_or(TICK, |third| third.min(TICK)));
    }
}

/// Notifies systemd that the daemon is ending.
pub fn stopping(log: &Log) {
    tell(&[Stopping, Status("ending: machines are held where they stand")], log);
}

fn tell(states: &[NotifyState<'_>], log: &Log) {
    if let Err(error) = sd_notify::notify(states) {
        log.fault(&format!("systemd cannot be told: {error}"));
    }
}

/// Status of all machines in one line.
fn status(watched: &Watched) -> String {
    let each = watched.iter().map(|(name, gate)| {
        let machine_state = gate.machine_state();
        let name = name.replace(char::is_control, " ");
        match machine_state.state {
            State::Running => {
                format!("{name}: run {}, {} %", machine_state.run, machine_state.progress_percent)
            }
            state => format!("{name}: {}", state.word()),
        }
    });
    each.collect::<Vec<_>>().join("; ")
}

struct Watch {
    watched: Watched,
    /// Whether each worker was late at the last check.
    late: Vec<bool>,
}

impl Watch {
    fn new(watched: Watched) -> Self {
        let late = vec![false; watched.len()];
        Self { watched, late }
    }

    /// Whether all workers make progress. A worker that no longer does is logged, and its machine is held: the hold
    /// reaches the control independently of the hung thread.
    fn all_live(&mut self, log: &Log) -> bool {
        for ((name, gate), was_late) in self.watched.iter().zip(&mut self.late) {
            let is_late = gate.is_progress_late();
            if is_late && !*was_late {
                let seconds = gate.progress_age().as_secs();
                log.fault(&format!(
                    "{name}: no progress for {seconds} s: the watchdog is fed no more"
                ));
                let _ = gate.stop("the watchdog");
            } else if *was_late && !is_late {
                log.say(&format!("{name}: progress again"));
            }
            *was_late = is_late;
        }
        !self.late.contains(&true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use devices::controllers::Halt;

    const LONG: Duration = Duration::from_secs(3600);

    #[test]
    fn one_that_hangs_stops_the_feed_and_is_held() {
        let log: Log = Log::new(|_, _| {});
        let machines: Watched =
            ["mill", "lathe"].map(|name| (name.to_owned(), CommandGate::for_tests().0)).into();
        let mut watch = Watch::new(machines.clone());
        let halt = Halt::new(|| {});
        let (_, mill) = &machines[0];
        mill.update(|machine_state| machine_state.state = State::Running);
        mill.register_halt(&halt);
        machines.iter().for_each(|(_, gate)| gate.report_progress(LONG));
        assert!(watch.all_live(&log) && !halt.is_halted());
        mill.report_progress(Duration::ZERO);
        sleep(Duration::from_millis(1));
        // The live worker of the other machine does not mask the hung one.
        machines[1].1.report_progress(LONG);
        assert!(!watch.all_live(&log) && halt.is_halted());
        assert!(!watch.all_live(&log));
        mill.report_progress(LONG);
        assert!(watch.all_live(&log));
    }

    #[test]
    fn a_name_cannot_say_more_than_a_name() {
        let machines = vec![("mill\nREADY=1".to_owned(), CommandGate::for_tests().0)];
        assert_eq!(status(&machines), "mill READY=1: starting");
    }
}
