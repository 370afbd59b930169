//! Coverage of the stated intervals, and frequency of the alarms.

use machine::record::estimate::Estimate;
use rayon::prelude::*;
use statrs::distribution::{Binomial, DiscreteCDF};

use testing::population::coverage_population;

use super::bench::{World, covers, parameter, says};

fn estimates(world: &World, seeds: u64) -> Vec<Estimate> {
    (0..seeds).into_par_iter().map(|seed| world.estimate(1000 + seed)).collect()
}

/// Upper bound of the number of events among `all`, each with `probability`; exceeded once in 1000 times.
fn at_most(probability: f64, all: u64) -> u64 {
    Binomial::new(probability, all).unwrap().inverse_cdf(0.999)
}

/// Share of the estimates whose interval contains the true value.
fn covered(estimates: &[Estimate], symbol: &str, truth: f64) -> f64 {
    let hits = estimates.iter().filter(|estimate| covers(estimate, symbol, truth)).count();
    hits as f64 / estimates.len() as f64
}

fn is_scan(estimate: &&Estimate) -> bool {
    parameter(estimate, "T_scan").identifiable
}

/// Display steps of 1 µm, drift, and an offset part, as in the built-in machine.
#[test]
fn a_sound_machine_has_no_delay_and_raises_the_alarm_as_often_as_stated() {
    let (seeds, shares) = coverage_population();
    let estimates = estimates(&World::with_a_round_part(), seeds);
    let truth = covered(&estimates, "t_latch", 0.0);
    assert!(shares.contains(&truth), "{truth}");
    // F test at 1 %.
    let alarms = estimates.iter().filter(is_scan).count() as u64;
    assert!(alarms <= at_most(0.01, seeds), "{alarms}");
    let too_good = |e: &&Estimate| says(&e.warnings, "repeatability_um");
    let doubted = estimates.iter().filter(too_good).count() as u64;
    assert!(doubted <= at_most(0.001, seeds), "{doubted}");
}

#[test]
fn a_constant_delay_is_found_within_its_uncertainty_and_is_no_scan() {
    let (seeds, shares) = coverage_population();
    let world = World::with_a_round_part().latched(3.7, 0.0).with("probe.repeatability_um", 1.5);
    let estimates = estimates(&world, seeds);
    let (delay, overtravel) = (covered(&estimates, "t_latch", 3.7), covered(&estimates, "E_latch", 0.5 * 3.7));
    assert!(shares.contains(&delay), "{delay}");
    assert_eq!(delay, overtravel);
    let alarms = estimates.iter().filter(is_scan).count() as u64;
    assert!(alarms <= at_most(0.01, seeds), "{alarms}");
    assert!(estimates.iter().all(|e| says(&e.warnings, "ms late")));
}

/// If the display step hides the scatter, the step must be in the uncertainty.
#[test]
fn steps_of_the_display_larger_than_the_scatter_are_in_the_uncertainty() {
    let (seeds, shares) = coverage_population();
    let mut world = World::with_a_round_part().latched(0.3, 0.0).with("probe.repeatability_um", 0.05);
    for axis in ["X", "Y", "Z"] {
        world = world.with(&format!("axes.{axis}.resolution_um"), 2.0);
    }
    let place = |seed: u64| (seed as f64 * 0.618_034).fract() * 0.1;
    let of = |seed| world.clone().with("simulated.centre_offset_mm", vec![place(seed), 0.0]).estimate(seed);
    let estimates: Vec<Estimate> = (0..seeds).into_par_iter().map(of).collect();
    let delay = covered(&estimates, "t_latch", 0.3);
    assert!(delay >= *shares.start(), "{delay}");
}

/// The scan of a common PLC, at 300 mm/min: detected every time, with its period and its mean delay.
#[test]
fn a_scan_is_always_seen_and_its_time_found_within_its_uncertainty() {
    let (seeds, shares) = coverage_population();
    let world = World::with_a_round_part().latched(1.0, 10.0);
    let estimates = estimates(&world, seeds);
    assert_eq!(estimates.iter().filter(is_scan).count() as u64, seeds);
    assert!(estimates.iter().all(|e| says(&e.warnings, "e.g. of a PLC")));
    let (scan, delay) = (covered(&estimates, "T_scan", 10.0), covered(&estimates, "t_latch", 6.0));
    assert!(shares.contains(&delay), "delay {delay}");
    // For a rectangular distribution the interval covers slightly more often.
    assert!(scan >= *shares.start(), "scan {scan}");
    // The part of the scan in the scatter of slow touches is not attributed to the probe.
    let too_good = |e: &&Estimate| says(&e.warnings, "repeatability_um");
    let doubted = estimates.iter().filter(too_good).count() as u64;
    assert!(doubted <= at_most(0.01, seeds), "{doubted}");
}

/// A drift along the touch of 4 µm in a minute is neither delay nor scatter.
#[test]
fn drift_is_taken_off() {
    let world = World::with_a_round_part().latched(1.0, 0.0).with("machine.drift_um_per_h", 240.0);
    let (seeds, shares) = coverage_population();
    let estimates = estimates(&world, seeds);
    let delay = covered(&estimates, "t_latch", 1.0);
    assert!(shares.contains(&delay), "{delay}");
    let scatter: f64 = estimates.iter().map(|e| parameter(e, "s_30").value).sum();
    assert!(scatter < 0.7 * seeds as f64, "{scatter}");
}

#[test]
fn balls_and_other_directions_serve_as_well() {
    let (seeds, shares) = coverage_population();
    let worlds = [
        World::with_balls(),
        World::with_balls().with("method.latch-delay.direction_deg", 45.0),
        World::with_a_round_part().with("method.latch-delay.direction_deg", 217.0),
    ];
    // A third of the seeds for each world: the coverage is that of all together.
    let each = seeds.div_ceil(3);
    let estimates: Vec<Estimate> =
        worlds.into_iter().flat_map(|world| estimates(&world.latched(2.0, 0.0), each)).collect();
    let delay = covered(&estimates, "t_latch", 2.0);
    assert!(shares.contains(&delay), "{delay}");
}
