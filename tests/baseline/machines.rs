//! Machine files: the built-in ones, and shorter measurements on the same machines.

pub const SELF_CALIBRATION: &str = include_str!("../../config/simulated.toml");
pub const LASER: &str = include_str!("../../config/laser.toml");
pub const SAMBA: &str = include_str!("../../config/samba.toml");

/// One method on its built-in machine.
pub struct Case {
    pub method: &'static str,
    /// The built-in machine file.
    pub machine: &'static str,
    /// Settings of the run: the built-in ones, except the number of Monte Carlo trials. That number is fixed to
    /// save time; without it, it follows from JCGM 101, 7.9 (`--ignored` tests that).
    pub run_settings: &'static str,
    /// Settings of a short measurement, whose files are small.
    pub short_settings: &'static str,
    /// Whether readings, plan and capture of the run on the built-in machine are too large to be stored whole.
    pub is_large: bool,
}

pub const CASES: [Case; 4] = [
    Case {
        method: "self-calibration",
        machine: SELF_CALIBRATION,
        run_settings: "monte_carlo_trials = 1000\n",
        short_settings: "monte_carlo_trials = 1000\npositions = 5\nheights_mm = [60.0, 90.0]\n",
        is_large: false,
    },
    Case {
        method: "laser-r-test",
        machine: LASER,
        run_settings: "monte_carlo_trials = 1000\n",
        short_settings: "monte_carlo_trials = 1000\ntilt_deg = [-60.0, 0.0, 60.0]\n\
                         turn_deg = [0.0, 120.0, 240.0]\npoints = 9\nsamples = 4\n",
        is_large: true,
    },
    Case {
        method: "samba",
        machine: SAMBA,
        run_settings: "monte_carlo_trials = 1000\n",
        short_settings: "monte_carlo_trials = 1000\nballs = 24\nfind = \"once\"\n",
        is_large: true,
    },
    Case {
        method: "latch-delay",
        machine: SELF_CALIBRATION,
        run_settings: "",
        short_settings: "touches = 6\n",
        is_large: false,
    },
];

impl Case {
    pub fn run_machine(&self) -> String {
        with_method(self.machine, self.method, self.run_settings)
    }

    pub fn short_machine(&self) -> String {
        with_method(self.machine, self.method, self.short_settings)
    }
}

/// A machine file with settings of a method at its end.
pub fn with_method(machine: &str, method: &str, settings: &str) -> String {
    format!("{machine}\n[method.{method}]\n{settings}")
}
