//! Changes the built-in machine, and measures its latch delay in the simulated world.

use machine::record::estimate::{Estimate, Parameter};
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::{IdentifyError, Method};
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::machine_text::{parse_machine_file, set_key};
use crate::support::plan_player;

/// Keys of the machine file from which plans and simulated worlds are built.
#[derive(Clone)]
pub struct LatchDelayWorld(Table);

impl LatchDelayWorld {
    pub fn with_a_round_part() -> Self {
        Self(include_str!("../../../config/simulated.toml").parse().unwrap())
    }

    pub fn with_balls() -> Self {
        Self(include_str!("../../../config/samba.toml").parse().unwrap())
    }

    /// Sets the value at `path`, keys joined by dots; missing tables are created.
    pub fn with_key(mut self, path: &str, value: impl Into<Value>) -> Self {
        set_key(&mut self.0, path, value.into());
        self
    }

    pub fn with_latch_delay(self, delay_ms: f64, scan_ms: f64) -> Self {
        self.with_key("simulated.latch.delay_ms", delay_ms).with_key("simulated.latch.scan_ms", scan_ms)
    }

    pub fn machine_file(&self, seed: u64) -> MachineFile {
        let seeded = self.clone().with_key("simulated.seed", seed as i64);
        parse_machine_file(&seeded.0)
    }

    pub fn method_and_plan_without_steps(&self) -> (Box<dyn Method>, Plan) {
        setup::configure_method_and_plan_without_steps(&self.machine_file(1), "latch-delay", None).unwrap()
    }

    /// Plan and readings when the plan is played on the world itself.
    pub fn play_plan(&self, seed: u64) -> (Plan, Vec<Reading>) {
        let file = self.machine_file(seed);
        let (method, header) = setup::configure_method_and_plan_without_steps(&file, "latch-delay", None).unwrap();
        let mut world = setup::build_world(&file).unwrap();
        plan_player::measure_all_stages(&mut world, method.as_ref(), header)
    }

    pub fn estimate(&self, seed: u64) -> Estimate {
        let (plan, readings) = self.play_plan(seed);
        identify(&plan, &readings).unwrap_or_else(|error| panic!("seed {seed}: {error}"))
    }
}

pub fn identify(plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let method = methods::configure_method("latch-delay", plan.settings.clone()).unwrap();
    method.identify(plan, readings)
}

pub fn parameter<'a>(estimate: &'a Estimate, symbol: &str) -> &'a Parameter {
    let found = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
    found.unwrap_or_else(|| panic!("no {symbol}"))
}

/// Whether the parameter's interval contains the true value.
pub fn is_covered(estimate: &Estimate, symbol: &str, truth: f64) -> bool {
    let parameter = parameter(estimate, symbol);
    (parameter.value - truth).abs() <= parameter.expanded
}

pub fn contains_text(lines: &[String], words: &str) -> bool {
    lines.iter().any(|line| line.contains(words))
}
