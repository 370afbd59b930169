//! A machine with a laser in its spindle, a journal, and the program that uses both.

use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::time::Duration;

use machine::Axis;
use machine::record::estimate::{Estimate, Parameter};
use machine::record::reading::Reading;

use super::tcp_sensor::{self, TcpDisplacementSensor};
use crate::support::grbl_control::GrblControl;
use crate::support::machine_shop::{MachineShop, stderr};
use crate::support::terminal_operator;

/// Steps: the prompt (0), the search of the sphere (1), the direction of the beam at three heights (2 to 4), the
/// reference (5); then the poses, and the reference again.
pub const SPHERE_SEARCH_STEP: u32 = 1;
pub const FIRST_REFERENCE_STEP: u32 = 5;

/// Settings of the method, and the size of the measurement that follows from them.
pub struct ScanDesign {
    settings: &'static str,
    /// Number of dwell points of a scan.
    pub dwell_points_per_scan: usize,
    /// Number of samples at each dwell point.
    pub samples_per_dwell_point: usize,
    /// Number of steps of the plan, with the prompt.
    pub step_count: u32,
}

/// The minimum number of poses and points.
pub const MIN_POINTS_DESIGN: ScanDesign = ScanDesign {
    settings: MIN_POINTS_DESIGN_SETTINGS,
    dwell_points_per_scan: 10,
    samples_per_dwell_point: 60,
    step_count: 12,
};
/// Enough poses and points for a sound estimate.
pub const SOUND_ESTIMATE_DESIGN: ScanDesign = ScanDesign {
    settings: SOUND_ESTIMATE_DESIGN_SETTINGS,
    dwell_points_per_scan: 26,
    samples_per_dwell_point: 20,
    step_count: 15,
};

const MIN_POINTS_DESIGN_SETTINGS: &str = "
[method.laser-r-test]
tilt_deg = [60.0]
turn_deg = [120.0, 240.0]
points = 5
samples = 60
dwell_s = 0.02
feed_mm_min = 2400.0
monte_carlo_trials = 100
";

const SOUND_ESTIMATE_DESIGN_SETTINGS: &str = "
[method.laser-r-test]
tilt_deg = [-60.0, 60.0]
turn_deg = [120.0, 240.0]
monte_carlo_trials = 100
";

impl ScanDesign {
    /// Machine file of the built-in machine with these settings.
    pub fn machine_file_text(&self) -> String {
        include_str!("../../../config/laser.toml").to_owned() + self.settings
    }
}

pub struct LaserShop {
    shop: MachineShop,
    design: ScanDesign,
    pub bench: GrblControl,
    pub sender: TcpDisplacementSensor,
}

impl LaserShop {
    /// `bench`: simulated control of a machine with the settings of `design`.
    pub fn with_control(design: ScanDesign, bench: GrblControl) -> Self {
        let sender = TcpDisplacementSensor::start(bench.world.clone());
        let file = replace_control_and_sensor(
            &design.machine_file_text(),
            &format!("tcp = \"{}\"", bench.address),
            &tcp_sensor::sensor_section(sender.address),
        );
        Self { shop: MachineShop::with_machine_file(&file), design, bench, sender }
    }

    pub fn run_trued(&self, arguments: &[&str]) -> Output {
        self.shop.run_trued(arguments)
    }

    pub fn machine_path(&self) -> String {
        self.shop.machine_path()
    }

    /// Starts a run; the operator has confirmed the tool in the spindle.
    pub fn start_run(&self) -> Child {
        let machine = self.shop.machine_path();
        let run = ["run", "laser-r-test", "--json", "--machine", &machine];
        let mut command = self.shop.trued_command(&run);
        terminal_operator::confirm_prompts_with_enter(&mut command).stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().unwrap()
    }

    pub fn resume(&self) -> Output {
        self.run_trued(&["resume", "1", "--acknowledge", "Ada", "--json"])
    }

    /// Waits until the control has received `count` lines with these words.
    pub fn wait_until_control_receives(&self, words: &str, count: usize, client: &mut Child) {
        while self.bench.received_text().matches(words).count() < count {
            if client.try_wait().unwrap().is_some() {
                let mut told = String::new();
                let _ = client.stderr.take().unwrap().read_to_string(&mut told);
                panic!("it ended before `{words}`: {told}");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn run_state(&self) -> String {
        self.shop.run_states()[0].clone()
    }

    pub fn exported_readings(&self) -> Vec<Reading> {
        let to = self.shop.path("export");
        let exported = self.run_trued(&["export", "1", "--to", &to.display().to_string()]);
        assert!(exported.status.success(), "{}", stderr(&exported));
        read_readings_csv(&to.join("run-1-readings.csv"))
    }

    /// Asserts that each measured step has all of its samples, and that the sensor sent each in this order, at
    /// consecutive points, with the machine at the position of the reading. Returns the steps.
    pub fn check_readings_and_return_steps(&self) -> Vec<u32> {
        let (readings, said) = (self.exported_readings(), self.sender.sent_samples());
        let ScanDesign { dwell_points_per_scan: points, samples_per_dwell_point: samples, .. } = self.design;
        let same = |one: &Reading, other: &Reading| (one.step, one.repeat) == (other.step, other.repeat);
        let mut behind = 0;
        let mut steps = Vec::new();
        for scan in readings.chunk_by(same) {
            assert_eq!(scan.len(), points * samples, "step {}", scan[0].step);
            steps.push(scan[0].step);
            for taken in scan.chunks(samples) {
                let was_said = |at: &usize| {
                    let there = said[*at..].iter().zip(taken);
                    said.len() >= at + samples
                        && there.into_iter().all(|(said, taken)| is_reading_of_sent_sample(said, taken))
                };
                let found = (behind..said.len()).find(was_said);
                let made_up = || panic!("not said: {:?} and what follows", taken[0]);
                behind = found.unwrap_or_else(made_up) + samples;
            }
        }
        steps
    }
}

/// `text` with another control and another sensor.
pub fn replace_control_and_sensor(text: &str, control: &str, sensor: &str) -> String {
    let changes = [
        ("kind = \"simulated\"\nwire = \"memory\"\n", format!("kind = \"grbl\"\n{control}\n")),
        ("[sensor.simulated]\nspeaks = \"can\"\nwire = \"memory\"\n", sensor.to_owned()),
    ];
    changes.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    })
}

fn read_readings_csv(csv: &Path) -> Vec<Reading> {
    trued::report::readings_csv::read_readings(&std::fs::read(csv).unwrap()).unwrap()
}

/// The control displays positions to a micrometre and a thousandth of a degree; the commanded position is known to
/// a tenth of that.
fn is_reading_of_sent_sample((value_mm, position): &tcp_sensor::SentSample, reading: &Reading) -> bool {
    let stands = |axis| (position.get_or_zero(axis) - reading.position.get_or_zero(axis)).abs() < 2e-4;
    reading.value_mm == Some(*value_mm)
        && Axis::ALL.into_iter().filter(|axis| position.get(*axis).is_some()).all(stands)
}

pub fn estimate_of_output(output: &Output) -> Estimate {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// True errors of the built-in machine, by symbol (paper 2, Table 5), um and urad.
pub const TRUE_ERRORS_UM_AND_URAD: [(&str, f64); 5] =
    [("EA0B", -3.5), ("EB0B", -42.0), ("EC0B", -3.5), ("EX0C", -1.0), ("EA0C", 5.2)];

pub fn parameter<'a>(estimate: &'a Estimate, symbol: &str) -> &'a Parameter {
    let found = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
    found.unwrap_or_else(|| panic!("no {symbol}"))
}

/// Asserts that each deviation from the true error is below `max_deviation_in_u` standard uncertainties.
pub fn assert_near_truth(estimate: &Estimate, max_deviation_in_u: f64) {
    for (symbol, truth) in TRUE_ERRORS_UM_AND_URAD {
        let Parameter { value, u, .. } = parameter(estimate, symbol);
        assert!((value - truth).abs() < max_deviation_in_u * u, "{symbol}: {value}, u {u}");
    }
}
