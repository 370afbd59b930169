//! What is due starts, if somebody has armed it and the machine tells that it is ready; else it is said
//! why not.
//!
//! [`window`](self::window::window) says what a look at the clock finds, [`judge`](self::judge::judge)
//! whether it may start: both are functions of what they are given. The [`Keeper`] looks once a second, on a
//! thread of its own, so that it does not matter whether the clock was set or the computer slept
//! meanwhile. What became of a slot is in the journal before anything moves.

mod books;
pub mod calendar;
pub mod entry;
mod judge;
mod keeper;
#[cfg(test)]
mod tests;
mod window;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use jiff::Timestamp;

use self::entry::Entry;
use self::keeper::Keeper;
pub use self::keeper::planned;
use super::config::Demand;
use super::desk::Desk;
use super::rota::Call;
use super::{Log, ServeError};
use crate::store::Journal;
use link::Clock;
use link::clock::HostClock;

/// How often the clock is looked at.
const TICK: Duration = Duration::from_secs(1);

/// Keep the schedule of `machine`, whose lock is held, until the desk ends. What an earlier service left is
/// written down when this returns.
///
/// # Errors
/// A journal that cannot be written; no thread.
pub fn start(
    machine: &str,
    (entries, demand): (&[Entry], &[Demand]),
    desk: &Desk,
    journal: &Arc<Journal>,
    log: &Log,
) -> Result<(), ServeError> {
    let (calls, todo) = channel();
    desk.rota().listens(calls);
    let (machine, entries, demand) = (machine.to_owned(), entries.to_vec(), demand.to_vec());
    let (desk, journal, log) = (desk.clone(), Arc::clone(journal), log.clone());
    let (begun, begins) = channel();
    let keep = move || match Keeper::begin(&machine, (&entries, &demand), &desk, &journal, &log) {
        Ok(keeper) => {
            let _ = begun.send(Ok(()));
            attend(keeper, &todo);
        }
        Err(error) => drop(begun.send(Err(error))),
    };
    // The journal is waited for on a thread without a runtime.
    let thread = std::thread::Builder::new().name("schedule".to_owned()).spawn(keep);
    thread.map_err(ServeError::Thread)?;
    let died = || ServeError::Thread(std::io::Error::other("that of the schedule has died"));
    Ok(begins.recv().map_err(|_| died())??)
}

fn attend(mut keeper: Keeper, calls: &Receiver<Call>) {
    let clock = HostClock::start();
    loop {
        let call = match calls.recv_timeout(TICK) {
            Ok(call) => Some(call),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        if keeper.ends() {
            return;
        }
        let (now, now_s) = (Timestamp::now(), clock.now_s());
        keeper.look(now, now_s);
        if let Some(call) = call {
            keeper.called(call, now);
        }
    }
}
