//! Chase-the-ball uses the same identification.

use nalgebra::Vector3;

use super::g2::{FIVE_PARAMETERS, TABLE_FACTORS};
use super::played::{PAPER_TABLE_5, SimulatedMachine, run, table_5_machine};
use super::{ideal, settings};
use crate::laser_r_test::LaserRTestSettings;
use crate::laser_r_test::identify::identify;
use crate::laser_r_test::settings::MeasuringDevice;
use crate::laser_r_test::setup::LaserSetup;
use machine::record::estimate::Estimate;

fn estimate_from_touches(noise_um: f64, seed: u64) -> Estimate {
    let zero = Vector3::new(0.012, -0.009, -200.03);
    let world = SimulatedMachine { zero, radius: 10.004, ..table_5_machine(noise_um, seed) };
    let mut plan = ideal(0.5);
    plan.probe.repeatability_um = Some(0.5);
    plan.probe.lobing_um = 0.0;
    let own = LaserRTestSettings { by: MeasuringDevice::Probe, tilt_deg: vec![-60.0, -30.0, 30.0, 60.0], ..settings() };
    let (plan, done, readings) = run(plan, &own, &world, 9).unwrap();
    assert_eq!(done.len(), 6);
    let setup = LaserSetup::new(&plan, &own).unwrap();
    identify(&setup, &readings).unwrap()
}

/// The diameter includes the pre-travel, and the stylus is far from its position in the machine file.
#[test]
fn paper_table_5_comes_back_by_touch() {
    let estimate = estimate_from_touches(0.0, 1);
    println!("{:?}", estimate.warnings);
    assert_eq!((estimate.rank, estimate.unknowns), (11, 11));
    for (i, name) in FIVE_PARAMETERS.into_iter().enumerate() {
        let found = estimate.parameters.iter().find(|p| p.symbol == name).unwrap();
        let error = found.value - PAPER_TABLE_5[i] * TABLE_FACTORS[i];
        assert!(error.abs() < 1e-2, "{name}: off by {error}");
    }
}

/// The texts must not mention a sensor.
#[test]
fn touch_estimate_lists_what_is_not_identifiable() {
    let estimate = estimate_from_touches(0.5, 1);
    let told = [estimate.not_identifiable, estimate.gauge, estimate.warnings].concat().join("; ");
    assert!(told.contains("mean pre-travel") && told.contains("stylus centre"), "{told}");
    for word in ["sensor", "zero position", "noise_um", "incidence"] {
        assert!(!told.contains(word), "{word}: {told}");
    }
}

#[test]
fn regress_touches_scatter_as_predicted() {
    let mut ratio = 0.0;
    for seed in 0..20 {
        let estimate = estimate_from_touches(0.5, seed);
        for (i, name) in FIVE_PARAMETERS.into_iter().enumerate() {
            let found = estimate.parameters.iter().find(|p| p.symbol == name).unwrap();
            ratio += ((found.value - PAPER_TABLE_5[i] * TABLE_FACTORS[i]) / found.u).powi(2) / 100.0;
        }
    }
    // 100 correlated squares: within about four standard deviations of 1.
    println!("{ratio}");
    assert!((0.4..=1.7).contains(&ratio), "{ratio}");
}
