//! Chase-the-ball uses the same identification.

use nalgebra::Vector3;

use super::gate_g2::{TABLE_5_SYMBOLS, TABLE_5_UNIT_FACTORS};
use super::simulated_machine::{PAPER_TABLE_5, SimulatedMachine, simulate_run, table_5_machine};
use super::{ideal_plan, settings_with_few_trials};
use crate::laser_r_test::LaserRTestSettings;
use crate::laser_r_test::identify::identify;
use crate::laser_r_test::settings::MeasuringDevice;
use crate::laser_r_test::setup::LaserSetup;
use machine::record::estimate::Estimate;

fn estimate_from_touches(noise_um: f64, seed: u64) -> Estimate {
    let zero = Vector3::new(0.012, -0.009, -200.03);
    let world = SimulatedMachine { zero_point: zero, sphere_radius_mm: 10.004, ..table_5_machine(noise_um, seed) };
    let mut plan = ideal_plan(0.5);
    plan.probe.repeatability_um = Some(0.5);
    plan.probe.lobing_um = 0.0;
    let own = LaserRTestSettings {
        by: MeasuringDevice::Probe,
        tilt_deg: vec![-60.0, -30.0, 30.0, 60.0],
        ..settings_with_few_trials()
    };
    let (plan, done, readings) = simulate_run(plan, &own, &world, 9).unwrap();
    assert_eq!(done.len(), 6);
    let setup = LaserSetup::new(&plan, &own).unwrap();
    identify(&setup, &readings).unwrap()
}

/// The diameter includes the pre-travel, and the stylus is far from its position in the machine file.
#[test]
fn noise_free_touches_give_the_values_of_table_5() {
    let estimate = estimate_from_touches(0.0, 1);
    println!("{:?}", estimate.warnings);
    assert_eq!((estimate.rank, estimate.unknowns), (11, 11));
    for (i, name) in TABLE_5_SYMBOLS.into_iter().enumerate() {
        let found = estimate.parameters.iter().find(|p| p.symbol == name).unwrap();
        let error = found.value - PAPER_TABLE_5[i] * TABLE_5_UNIT_FACTORS[i];
        assert!(error.abs() < 1e-2, "{name}: off by {error}");
    }
}

/// The texts must not mention a sensor.
#[test]
fn texts_of_a_touch_estimate_do_not_mention_a_sensor() {
    let estimate = estimate_from_touches(0.5, 1);
    let told = [estimate.not_identifiable, estimate.gauge, estimate.warnings].concat().join("; ");
    assert!(told.contains("mean pre-travel") && told.contains("stylus centre"), "{told}");
    for word in ["sensor", "zero position", "noise_um", "incidence"] {
        assert!(!told.contains(word), "{word}: {told}");
    }
}

#[test]
fn parameters_by_touch_scatter_as_predicted() {
    let mut ratio = 0.0;
    for seed in 0..20 {
        let estimate = estimate_from_touches(0.5, seed);
        for (i, name) in TABLE_5_SYMBOLS.into_iter().enumerate() {
            let found = estimate.parameters.iter().find(|p| p.symbol == name).unwrap();
            ratio += ((found.value - PAPER_TABLE_5[i] * TABLE_5_UNIT_FACTORS[i]) / found.u).powi(2) / 100.0;
        }
    }
    // 100 correlated squares: within about four standard deviations of 1.
    println!("{ratio}");
    assert!((0.4..=1.7).contains(&ratio), "{ratio}");
}
