//! Machine files: the built-in ones, and shorter measurements on the same machines.

pub const SIMULATED_MACHINE_FILE: &str = include_str!("../../config/simulated.toml");
pub const LASER_MACHINE_FILE: &str = include_str!("../../config/laser.toml");
pub const SAMBA_MACHINE_FILE: &str = include_str!("../../config/samba.toml");

/// One method on its built-in machine.
pub struct MethodCase {
    pub method: &'static str,
    /// Text of the built-in machine file.
    pub machine_file: &'static str,
    /// Settings of the run: the built-in ones, except the number of Monte Carlo trials. That number is fixed to
    /// save time; without it, it follows from JCGM 101, 7.9 (`--ignored` tests that).
    pub full_run_settings: &'static str,
    /// Settings of a short measurement, whose files are small.
    pub short_run_settings: &'static str,
    /// Whether readings, plan and capture of the run on the built-in machine are too large to be stored whole.
    pub has_large_output: bool,
}

pub const METHOD_CASES: [MethodCase; 4] = [
    MethodCase {
        method: "self-calibration",
        machine_file: SIMULATED_MACHINE_FILE,
        full_run_settings: "monte_carlo_trials = 1000\n",
        short_run_settings: "monte_carlo_trials = 1000\npositions = 5\nheights_mm = [60.0, 90.0]\n",
        has_large_output: false,
    },
    MethodCase {
        method: "laser-r-test",
        machine_file: LASER_MACHINE_FILE,
        full_run_settings: "monte_carlo_trials = 1000\n",
        short_run_settings: "monte_carlo_trials = 1000\ntilt_deg = [-60.0, 0.0, 60.0]\n\
                         turn_deg = [0.0, 120.0, 240.0]\npoints = 9\nsamples = 4\n",
        has_large_output: true,
    },
    MethodCase {
        method: "samba",
        machine_file: SAMBA_MACHINE_FILE,
        full_run_settings: "monte_carlo_trials = 1000\n",
        short_run_settings: "monte_carlo_trials = 1000\nballs = 24\nfind = \"once\"\n",
        has_large_output: true,
    },
    MethodCase {
        method: "latch-delay",
        machine_file: SIMULATED_MACHINE_FILE,
        full_run_settings: "",
        short_run_settings: "touches = 6\n",
        has_large_output: false,
    },
];

impl MethodCase {
    pub fn full_run_machine_file(&self) -> String {
        append_method_settings(self.machine_file, self.method, self.full_run_settings)
    }

    pub fn short_run_machine_file(&self) -> String {
        append_method_settings(self.machine_file, self.method, self.short_run_settings)
    }
}

/// Returns the machine file with the settings of a method at its end.
pub fn append_method_settings(machine: &str, method: &str, settings: &str) -> String {
    format!("{machine}\n[method.{method}]\n{settings}")
}
