//! Coverage of the stated intervals, and frequency of the alarms.

use machine::record::estimate::Estimate;
use rayon::prelude::*;
use statrs::distribution::{Binomial, DiscreteCDF};

use testing::population::coverage_seeds_and_share_limits;

use super::latch_delay_world::{LatchDelayWorld, contains_text, is_covered, parameter};

fn estimates_of_seeds(world: &LatchDelayWorld, seeds: u64) -> Vec<Estimate> {
    (0..seeds).into_par_iter().map(|seed| world.estimate(1000 + seed)).collect()
}

/// Upper bound of the number of events among `all`, each with `probability`; exceeded once in 1000 times.
fn binomial_upper_limit(probability: f64, all: u64) -> u64 {
    Binomial::new(probability, all).unwrap().inverse_cdf(0.999)
}

/// Share of the estimates whose interval contains the true value.
fn covered_share(estimates: &[Estimate], symbol: &str, truth: f64) -> f64 {
    let hits = estimates.iter().filter(|estimate| is_covered(estimate, symbol, truth)).count();
    hits as f64 / estimates.len() as f64
}

fn is_plc_scan_identified(estimate: &&Estimate) -> bool {
    parameter(estimate, "T_scan").identifiable
}

/// Display steps of 1 µm, drift, and an offset part, as in the built-in machine.
#[test]
fn sound_machine_has_no_delay_and_the_stated_false_alarm_rate() {
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let estimates = estimates_of_seeds(&LatchDelayWorld::with_a_round_part(), seeds);
    let truth = covered_share(&estimates, "t_latch", 0.0);
    assert!(shares.contains(&truth), "{truth}");
    // F test at 1 %.
    let alarms = estimates.iter().filter(is_plc_scan_identified).count() as u64;
    assert!(alarms <= binomial_upper_limit(0.01, seeds), "{alarms}");
    let too_good = |e: &&Estimate| contains_text(&e.warnings, "repeatability_um");
    let doubted = estimates.iter().filter(too_good).count() as u64;
    assert!(doubted <= binomial_upper_limit(0.001, seeds), "{doubted}");
}

#[test]
fn constant_delay_is_found_within_u_and_not_reported_as_a_plc_cycle() {
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let world = LatchDelayWorld::with_a_round_part().with_latch_delay(3.7, 0.0).with_key("probe.repeatability_um", 1.5);
    let estimates = estimates_of_seeds(&world, seeds);
    let (delay, overtravel) =
        (covered_share(&estimates, "t_latch", 3.7), covered_share(&estimates, "E_latch", 0.5 * 3.7));
    assert!(shares.contains(&delay), "{delay}");
    assert_eq!(delay, overtravel);
    let alarms = estimates.iter().filter(is_plc_scan_identified).count() as u64;
    assert!(alarms <= binomial_upper_limit(0.01, seeds), "{alarms}");
    assert!(estimates.iter().all(|e| contains_text(&e.warnings, "ms late")));
}

/// If the display step hides the scatter, the step must be in the uncertainty.
#[test]
fn display_steps_larger_than_the_scatter_are_in_u() {
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let mut world =
        LatchDelayWorld::with_a_round_part().with_latch_delay(0.3, 0.0).with_key("probe.repeatability_um", 0.05);
    for axis in ["X", "Y", "Z"] {
        world = world.with_key(&format!("axes.{axis}.resolution_um"), 2.0);
    }
    let place = |seed: u64| (seed as f64 * 0.618_034).fract() * 0.1;
    let of = |seed| world.clone().with_key("simulated.centre_offset_mm", vec![place(seed), 0.0]).estimate(seed);
    let estimates: Vec<Estimate> = (0..seeds).into_par_iter().map(of).collect();
    let delay = covered_share(&estimates, "t_latch", 0.3);
    assert!(delay >= *shares.start(), "{delay}");
}

/// The scan of a common PLC, at 300 mm/min: detected every time, with its period and its mean delay.
#[test]
fn plc_cycle_is_always_detected_and_u_has_the_stated_coverage() {
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let world = LatchDelayWorld::with_a_round_part().with_latch_delay(1.0, 10.0);
    let estimates = estimates_of_seeds(&world, seeds);
    assert_eq!(estimates.iter().filter(is_plc_scan_identified).count() as u64, seeds);
    assert!(estimates.iter().all(|e| contains_text(&e.warnings, "e.g. of a PLC")));
    let (scan, delay) = (covered_share(&estimates, "T_scan", 10.0), covered_share(&estimates, "t_latch", 6.0));
    assert!(shares.contains(&delay), "delay {delay}");
    // For a rectangular distribution the interval covers slightly more often.
    assert!(scan >= *shares.start(), "scan {scan}");
    // The part of the scan in the scatter of slow touches is not attributed to the probe.
    let too_good = |e: &&Estimate| contains_text(&e.warnings, "repeatability_um");
    let doubted = estimates.iter().filter(too_good).count() as u64;
    assert!(doubted <= binomial_upper_limit(0.01, seeds), "{doubted}");
}

/// A drift along the touch of 4 µm in a minute is neither delay nor scatter.
#[test]
fn drift_is_subtracted() {
    let world =
        LatchDelayWorld::with_a_round_part().with_latch_delay(1.0, 0.0).with_key("machine.drift_um_per_h", 240.0);
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let estimates = estimates_of_seeds(&world, seeds);
    let delay = covered_share(&estimates, "t_latch", 1.0);
    assert!(shares.contains(&delay), "{delay}");
    let scatter: f64 = estimates.iter().map(|e| parameter(e, "s_30").value).sum();
    assert!(scatter < 0.7 * seeds as f64, "{scatter}");
}

#[test]
fn balls_and_other_directions_give_the_same_delay() {
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let worlds = [
        LatchDelayWorld::with_balls(),
        LatchDelayWorld::with_balls().with_key("method.latch-delay.direction_deg", 45.0),
        LatchDelayWorld::with_a_round_part().with_key("method.latch-delay.direction_deg", 217.0),
    ];
    // A third of the seeds for each world: the coverage is that of all together.
    let each = seeds.div_ceil(3);
    let estimates: Vec<Estimate> =
        worlds.into_iter().flat_map(|world| estimates_of_seeds(&world.with_latch_delay(2.0, 0.0), each)).collect();
    let delay = covered_share(&estimates, "t_latch", 2.0);
    assert!(shares.contains(&delay), "{delay}");
}
