//! Trials that wait for a program more than they compute: more of them at once than there are cores.

use libtest_mimic::{Arguments, Trial};

/// Unless the caller says how many (`--test-threads`).
const AT_ONCE: usize = 6;

pub fn alone(name: &str, run: fn()) -> Trial {
    Trial::test(name, move || {
        run();
        Ok(())
    })
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
