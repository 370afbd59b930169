//! Trials that wait for a program more than they compute: more of them at once than there are cores.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use libtest_mimic::{Arguments, Trial};

/// Unless the caller says how many (`--test-threads`).
const AT_ONCE: usize = 6;
/// A trial that takes longer hangs: it is named, and everything ends.
const LONGEST: Duration = Duration::from_secs(25 * 60);

pub fn alone(name: &str, run: fn()) -> Trial {
    let own = name.to_owned();
    Trial::test(name, move || {
        watched(own, run);
        Ok(())
    })
}

/// `run`, as long as it does not hang.
pub fn watched<T>(name: String, run: impl FnOnce() -> T) -> T {
    let (_over, ended) = channel::<()>();
    std::thread::spawn(move || {
        if ended.recv_timeout(LONGEST) == Err(RecvTimeoutError::Timeout) {
            eprintln!("{name} hangs: given up");
            std::process::exit(101);
        }
    });
    run()
}

/// Trials with the names of their functions. One that nobody lists here is dead code, and refused as such.
#[allow(unused_macros, reason = "some have other names")]
macro_rules! named {
    ($($trial:path),* $(,)?) => {
        vec![$(crate::waiting::alone(stringify!($trial), $trial)),*]
    };
}
#[allow(unused_imports, reason = "some have other names")]
pub(crate) use named;

pub fn run(trials: Vec<Trial>) -> ! {
    let mut arguments = Arguments::from_args();
    arguments.test_threads.get_or_insert(AT_ONCE);
    libtest_mimic::run(&arguments, trials).exit()
}
