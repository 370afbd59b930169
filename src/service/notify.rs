//! What systemd is told: that the daemon is ready, how it goes, that it lives, that it ends. Without
//! `NOTIFY_SOCKET` nobody is told, but work that hangs is still found out, and its machine held.
//!
//! The watchdog is fed only while each machine's worker makes progress within the time that it said
//! itself ([`Pulse`](super::pulse::Pulse)): a thread that hangs is not covered up by another that lives.

use std::thread::{Builder, sleep};
use std::time::{Duration, Instant};

use sd_notify::NotifyState::{self, Ready, Status, Stopping, Watchdog};

use super::board::State;
use super::desk::Desk;
use super::{Log, ServeError};

/// How often the workers are looked at, at least.
const TICK: Duration = Duration::from_secs(1);

/// Who is watched: a machine's name, and its desk.
pub type Watched = Vec<(String, Desk)>;

/// Ready from now on; watch for as long as the process lives.
///
/// # Errors
/// No thread.
pub fn ready(watched: Watched, log: &Log) -> Result<(), ServeError> {
    tell(&[Ready, Status(&status(&watched))], log);
    let (mut watch, log) = (Watch::new(watched), log.clone());
    let third = sd_notify::watchdog_enabled().map(|whole| whole / 3);
    let thread = Builder::new().name("watchdog".to_owned());
    let thread = thread.spawn(move || look(&mut watch, third, &log));
    thread.map(drop).map_err(ServeError::Thread)
}

/// `third`: of the time within which systemd expects a beat, if it does.
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

/// The daemon ends from now on.
pub fn stopping(log: &Log) {
    tell(&[Stopping, Status("ending: machines are held where they stand")], log);
}

fn tell(states: &[NotifyState<'_>], log: &Log) {
    if let Err(error) = sd_notify::notify(states) {
        log.fault(&format!("systemd cannot be told: {error}"));
    }
}

/// In one line.
fn status(watched: &Watched) -> String {
    let each = watched.iter().map(|(name, desk)| {
        let board = desk.board();
        let name = name.replace(char::is_control, " ");
        match board.state {
            State::Running => {
                format!("{name}: run {}, {} %", board.run, board.progress_percent)
            }
            state => format!("{name}: {}", state.word()),
        }
    });
    each.collect::<Vec<_>>().join("; ")
}

struct Watch {
    watched: Watched,
    /// Of each, as of the last look.
    late: Vec<bool>,
}

impl Watch {
    fn new(watched: Watched) -> Self {
        let late = vec![false; watched.len()];
        Self { watched, late }
    }

    /// Whether all make progress. Who does not any more is told, and its machine is held: the hold goes
    /// to the control beside whatever hangs.
    fn all_live(&mut self, log: &Log) -> bool {
        for ((name, desk), was_late) in self.watched.iter().zip(&mut self.late) {
            let is_late = desk.pulse().is_late();
            if is_late && !*was_late {
                let seconds = desk.pulse().age().as_secs();
                log.fault(&format!(
                    "{name}: no progress for {seconds} s: the watchdog is fed no more"
                ));
                let _ = desk.stop("the watchdog");
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
            ["mill", "lathe"].map(|name| (name.to_owned(), Desk::for_tests().0)).into();
        let mut watch = Watch::new(machines.clone());
        let halt = Halt::new(|| {});
        let (_, mill) = &machines[0];
        mill.show(|board| board.state = State::Running);
        mill.under_way(&halt);
        machines.iter().for_each(|(_, desk)| desk.pulse().beat(LONG));
        assert!(watch.all_live(&log) && !halt.is_halted());
        mill.pulse().beat(Duration::ZERO);
        sleep(Duration::from_millis(1));
        // The other lives and beats, and that covers nothing up.
        machines[1].1.pulse().beat(LONG);
        assert!(!watch.all_live(&log) && halt.is_halted());
        assert!(!watch.all_live(&log));
        mill.pulse().beat(LONG);
        assert!(watch.all_live(&log));
    }

    #[test]
    fn a_name_cannot_say_more_than_a_name() {
        let machines = vec![("mill\nREADY=1".to_owned(), Desk::for_tests().0)];
        assert_eq!(status(&machines), "mill READY=1: starting");
    }
}
