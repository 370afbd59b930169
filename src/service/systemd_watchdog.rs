//! Notifications to systemd: the daemon is ready, its status, the watchdog, the daemon ends. Without
//! `NOTIFY_SOCKET` none is sent, but hung work is still detected and its machine held.
//!
//! The watchdog is fed only while every machine's worker makes progress within the time that the worker has
//! announced ([`CommandGate::report_progress`]): a live thread does not mask a hung one.

use std::thread::sleep;
use std::time::{Duration, Instant};

use sd_notify::NotifyState::{self, Ready, Status, Stopping, Watchdog};

use super::command_gate::CommandGate;
use super::machine_state::ServiceState;
use super::{Log, ServeError, spawn_thread};

/// Maximum time between two checks of the workers.
const MAX_WORKER_CHECK_PERIOD: Duration = Duration::from_secs(1);

/// Watched machines: name and gate of each.
pub type WatchedMachines = Vec<(String, CommandGate)>;

/// Notifies systemd that the daemon is ready, and watches the workers for as long as the process lives.
///
/// # Errors
/// The thread cannot be started.
pub fn notify_ready_and_start_watchdog(machines: WatchedMachines, log: &Log) -> Result<(), ServeError> {
    notify_systemd(&[Ready, Status(&systemd_status_line(&machines))], log);
    let (mut watch, log) = (WorkerWatch::new(machines), log.clone());
    let feed_period = sd_notify::watchdog_enabled().map(|whole| whole / 3);
    spawn_thread("watchdog", move || watch_workers(&mut watch, feed_period, &log))
}

/// Checks the workers and notifies systemd, without end. `feed_period`: one third of systemd's watchdog timeout; `None`
/// if systemd's watchdog is not enabled.
fn watch_workers(watch: &mut WorkerWatch, feed_period: Option<Duration>, log: &Log) {
    let (mut last_feed, mut last_status) = (Instant::now(), String::new());
    loop {
        let live = watch.hold_late_machines_and_check_all_live(log);
        if live && feed_period.is_some_and(|feed_period| last_feed.elapsed() >= feed_period) {
            last_feed = Instant::now();
            notify_systemd(&[Watchdog], log);
        }
        let now = systemd_status_line(&watch.machines);
        if now != last_status {
            notify_systemd(&[Status(&now)], log);
            last_status = now;
        }
        sleep(feed_period.map_or(MAX_WORKER_CHECK_PERIOD, |feed_period| feed_period.min(MAX_WORKER_CHECK_PERIOD)));
    }
}

/// Notifies systemd that the daemon is ending.
pub fn notify_stopping(log: &Log) {
    notify_systemd(&[Stopping, Status("ending: runs in progress are held")], log);
}

/// Sends the notifications; does nothing without `NOTIFY_SOCKET`.
fn notify_systemd(states: &[NotifyState<'_>], log: &Log) {
    if let Err(error) = sd_notify::notify(states) {
        log.error(&format!("the notification to systemd failed: {error}"));
    }
}

/// Status of all machines in one line.
fn systemd_status_line(machines: &WatchedMachines) -> String {
    let each = machines.iter().map(|(name, gate)| {
        let machine_state = gate.machine_state();
        let name = name.replace(char::is_control, " ");
        match machine_state.state {
            ServiceState::Running => format!("{name}: run {}, {} %", machine_state.run, machine_state.progress_percent),
            state => format!("{name}: {}", state.label()),
        }
    });
    each.collect::<Vec<_>>().join("; ")
}

/// Detects workers that no longer make progress.
struct WorkerWatch {
    machines: WatchedMachines,
    /// Whether each worker was late at the last check.
    was_late: Vec<bool>,
}

impl WorkerWatch {
    fn new(machines: WatchedMachines) -> Self {
        let late = vec![false; machines.len()];
        Self { machines, was_late: late }
    }

    /// Logs each worker that has stopped making progress since the last check, and holds its machine: the hold reaches
    /// the control independently of the hung thread. Returns whether all workers make progress.
    fn hold_late_machines_and_check_all_live(&mut self, log: &Log) -> bool {
        for ((name, gate), was_late) in self.machines.iter().zip(&mut self.was_late) {
            let is_late = gate.is_progress_late();
            if is_late && !*was_late {
                let seconds = gate.progress_age().as_secs();
                log.error(&format!(
                    "{name}: no progress for {seconds} s: the machine is held, and the systemd watchdog is no longer notified"
                ));
                let _ = gate.hold_machine("the watchdog");
            } else if *was_late && !is_late {
                log.info(&format!("{name}: progress has resumed"));
            }
            *was_late = is_late;
        }
        !self.was_late.contains(&true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use devices::controllers::HaltHandle;

    const LONG_TIMEOUT: Duration = Duration::from_secs(3600);

    #[test]
    fn hanging_worker_fails_the_watchdog_check_and_its_machine_is_held() {
        let log: Log = Log::new(|_, _| {});
        let machines: WatchedMachines =
            ["mill", "lathe"].map(|name| (name.to_owned(), CommandGate::for_tests().0)).into();
        let mut watch = WorkerWatch::new(machines.clone());
        let halt = HaltHandle::new(|| {});
        let (_, mill) = &machines[0];
        mill.update_machine_state(|machine_state| machine_state.state = ServiceState::Running);
        mill.register_halt_handle(&halt);
        machines.iter().for_each(|(_, gate)| gate.report_progress(LONG_TIMEOUT));
        assert!(watch.hold_late_machines_and_check_all_live(&log) && !halt.is_halt_requested());
        mill.report_progress(Duration::ZERO);
        sleep(Duration::from_millis(1));
        // The live worker of the other machine does not mask the hung one.
        machines[1].1.report_progress(LONG_TIMEOUT);
        assert!(!watch.hold_late_machines_and_check_all_live(&log) && halt.is_halt_requested());
        assert!(!watch.hold_late_machines_and_check_all_live(&log));
        mill.report_progress(LONG_TIMEOUT);
        assert!(watch.hold_late_machines_and_check_all_live(&log));
    }

    #[test]
    fn machine_name_cannot_inject_notifications() {
        let machines = vec![("mill\nREADY=1".to_owned(), CommandGate::for_tests().0)];
        assert_eq!(systemd_status_line(&machines), "mill READY=1: starting");
    }
}
