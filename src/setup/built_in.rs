//! The machine files that are built in.

use methods::{laser_r_test, samba};

/// A machine file that serves a method when the user gives none.
#[derive(Debug, Clone, Copy)]
pub struct BuiltIn {
    /// Its name in error messages.
    pub file: &'static str,
    pub text: &'static str,
}

/// The machine file for the method `name`; most methods measure the cylinder of the first.
pub fn built_in(name: &str) -> BuiltIn {
    match name {
        samba::NAME => {
            BuiltIn { file: "samba.toml (built in)", text: include_str!("../../config/samba.toml") }
        }
        laser_r_test::NAME => {
            BuiltIn { file: "laser.toml (built in)", text: include_str!("../../config/laser.toml") }
        }
        _ => BuiltIn {
            file: "simulated.toml (built in)",
            text: include_str!("../../config/simulated.toml"),
        },
    }
}
