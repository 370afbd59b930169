//! Independent test data: the readings come from `simulated_machine.rs`, which multiplies rotations and translations as
//! in paper 2 and intersects the sphere with a straight ray.

mod combined_fit;
mod continuous_scans;
mod coverage;
mod gate_g2;
mod harmonics;
mod interruptions;
mod refusals;
mod simulated_machine;
mod touch_probe;

use serde::Deserialize;

use crate::laser_r_test::settings::LaserRTestSettings;
use machine::record::plan::{PLAN_VERSION, Plan};
use machine::record::report_data::ReportData;
use machine::record::sensor::Sensor;

/// Plan of the built-in machine with sensor and sphere, without steps.
pub fn plan_without_steps() -> Plan {
    let file = include_str!("../../../../config/laser.toml");
    let mut file: toml::Table = file.parse().unwrap();
    let axes = file["axes"].clone();
    let mut part = |name: &str| file.remove(name).unwrap();
    let mut machine = part("machine");
    machine.as_table_mut().unwrap().insert("axes".to_owned(), axes);
    Plan {
        trued_plan: PLAN_VERSION,
        method: super::METHOD_NAME.into(),
        settings: serde_json::Value::Null,
        machine: machine.try_into().unwrap(),
        probe: part("probe").try_into().unwrap(),
        sensors: Vec::<Sensor>::deserialize(part("sensor")).unwrap(),
        keepout: Vec::new(),
        solids: Vec::deserialize(part("solid")).unwrap(),
        artefact: part("artefact").try_into().unwrap(),
        priors: Vec::new(),
        interruption_times_s: Vec::new(),
        assumed: Vec::new(),
        compensations_active: Vec::new(),
        report: ReportData::default(),
        steps: Vec::new(),
    }
}

/// The same plan on a machine without drift, resolution and error motions, and a sensor with this noise.
pub fn ideal_plan(noise_um: f64) -> Plan {
    let mut plan = plan_without_steps();
    plan.machine.drift_um_per_h = 0.0;
    for spec in plan.machine.axes.values_mut() {
        spec.resolution_um = 0.0;
        spec.error_motion_um = 0.0;
    }
    plan.sensors[0].noise_um = Some(noise_um);
    plan.sensors[0].linearity_um = 0.0;
    plan
}

/// Settings with few trials. The tests of Monte Carlo set more.
pub fn settings_with_few_trials() -> LaserRTestSettings {
    LaserRTestSettings { monte_carlo_trials: 100, ..LaserRTestSettings::default() }
}
