//! The built-in machine, changed, and measurements on it.

use machine::record::estimate::{Estimate, Parameter};
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::{IdentifyError, Method};
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::machine_text::{parsed, set};
use crate::support::plan_player;

/// The machine file as a table.
#[derive(Clone)]
pub struct World(Table);

impl World {
    pub fn with_a_round_part() -> Self {
        Self(include_str!("../../../config/simulated.toml").parse().unwrap())
    }

    pub fn with_balls() -> Self {
        Self(include_str!("../../../config/samba.toml").parse().unwrap())
    }

    /// Sets the value at `path`, keys joined by dots; missing tables are created.
    pub fn with(mut self, path: &str, value: impl Into<Value>) -> Self {
        set(&mut self.0, path, value.into());
        self
    }

    pub fn latched(self, delay_ms: f64, scan_ms: f64) -> Self {
        self.with("simulated.latch.delay_ms", delay_ms).with("simulated.latch.scan_ms", scan_ms)
    }

    pub fn file(&self, seed: u64) -> MachineFile {
        let seeded = self.clone().with("simulated.seed", seed as i64);
        parsed(&seeded.0)
    }

    pub fn header(&self) -> (Box<dyn Method>, Plan) {
        setup::plan_header(&self.file(1), "latch-delay", None).unwrap()
    }

    /// Plan and readings when the plan is played on the world itself.
    pub fn played(&self, seed: u64) -> (Plan, Vec<Reading>) {
        let file = self.file(seed);
        let (method, header) = setup::plan_header(&file, "latch-delay", None).unwrap();
        let mut world = setup::build_world(&file).unwrap();
        plan_player::measure(&mut world, method.as_ref(), header)
    }

    pub fn estimate(&self, seed: u64) -> Estimate {
        let (plan, readings) = self.played(seed);
        identified(&plan, &readings).unwrap_or_else(|error| panic!("seed {seed}: {error}"))
    }
}

pub fn identified(plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let method = methods::configure_method("latch-delay", plan.settings.clone()).unwrap();
    method.identify(plan, readings)
}

pub fn parameter<'a>(estimate: &'a Estimate, symbol: &str) -> &'a Parameter {
    let found = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
    found.unwrap_or_else(|| panic!("no {symbol}"))
}

/// Whether the parameter's interval contains the true value.
pub fn covers(estimate: &Estimate, symbol: &str, truth: f64) -> bool {
    let parameter = parameter(estimate, symbol);
    (parameter.value - truth).abs() <= parameter.expanded
}

pub fn says(lines: &[String], words: &str) -> bool {
    lines.iter().any(|line| line.contains(words))
}
