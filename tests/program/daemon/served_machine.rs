//! The machine file of the daemon suite.

use crate::support::machine_shop::built_in_machine_text;

const SERVE_SECTIONS_TOML: &str = "[serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
                     [[serve.cycle]]\nnumber = 2\nmethod = \"latch-delay\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n";
const FEW_POSITIONS_SETTINGS: &str = "[method.self-calibration]\nmonte_carlo_trials = 100\npositions = 5\n";

/// The built-in machine with few touches and two cycles; `serve_keys` are added to `[serve]`.
pub fn served_machine_toml(serve_keys: &str) -> String {
    let machine = built_in_machine_text();
    format!(
        "{machine}\n{FEW_POSITIONS_SETTINGS}{}",
        SERVE_SECTIONS_TOML.replacen("[serve]\n", &format!("[serve]\n{serve_keys}"), 1)
    )
}
