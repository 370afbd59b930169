//! The machine file of the daemon suite.

use crate::support::machine_shop::built_in_machine;

const SERVE_SECTIONS: &str = "[serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
                     [[serve.cycle]]\nnumber = 2\nmethod = \"latch-delay\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n";
const SHORT_SETTINGS: &str = "[method.self-calibration]\nmonte_carlo_trials = 100\npositions = 5\n";

/// The built-in machine with few touches and its cycles; `before`: other keys of [serve].
pub fn served_machine(before: &str) -> String {
    let machine = built_in_machine();
    format!("{machine}\n{SHORT_SETTINGS}{}", SERVE_SECTIONS.replacen("[serve]\n", &format!("[serve]\n{before}"), 1))
}
