//! Gate G4 of METHODS section 4: the part for the dome.

use nalgebra::Vector3;

use super::super::measured_points::MeasuredPoints;
use super::super::prior_machine_errors::machine_errors_from_prior;
use super::super::variant::DomeVariant;
use super::super::variant_computation::compute_variants;
use super::{DOME_HEIGHT_OFFSET_MM, built_in_plan, paper_certified_positions, simulate_observed_balls};
use crate::ball_measurement::artefact_balls;
use crate::samba::tests::exact_estimate;
use estimation::random::seeded_stream;
use machine::kinematics::KinematicChain;
use machine::record::plan::Plan;
use rand_distr::{Distribution, StandardNormal};

/// Largest and mean deviation, µm, and stylus, mm, of each variant.
fn max_mean_and_stylus_of_variants(noise: impl FnMut() -> f64) -> Vec<(&'static str, f64, f64, Vector3<f64>)> {
    let mut plan = built_in_plan();
    plan.machine.tool_mm = [0.0, 0.0, -326.717];
    plan.priors = vec![exact_estimate()];
    let observed = simulate_observed_balls(&plan, noise);
    println!("{} measurements", observed.centres.len());
    let chain = KinematicChain::new(&plan.machine).unwrap();
    let stylus = Vector3::from(plan.machine.tool_mm);
    let points = MeasuredPoints::new(chain, stylus, &observed, artefact_balls(&plan).unwrap());
    let known = machine_errors_from_prior(&plan).unwrap();
    let (variants, lost) = compute_variants(&points, known.as_ref(), 0);
    assert_eq!((variants.len(), lost.len()), (7, 0), "{lost:?}");
    let result = |variant: &DomeVariant| {
        let norms: Vec<f64> = variant.certified_to_measured_fit.deviations.iter().map(|d| d.norm() * 1e3).collect();
        let largest = norms.iter().copied().fold(0.0, f64::max);
        let mean = norms.iter().sum::<f64>() / norms.len() as f64;
        println!("{}: {largest:.3} {mean:.3} µm, {:?}", variant.kind.name, variant.stylus.vector_mm);
        (variant.kind.name, largest, mean, variant.stylus.vector_mm)
    };
    variants.iter().map(result).collect()
}

#[test]
fn built_in_ball_dome_file_has_the_positions_of_paper_table_3() {
    let Plan { artefact, .. } = built_in_plan();
    let balls = artefact_balls(&Plan { artefact, ..built_in_plan() }).unwrap().clone();
    let certified = paper_certified_positions();
    assert_eq!((balls.balls.len(), certified.len()), (32, 32));
    for (ball, centre) in balls.balls.iter().zip(certified) {
        let raised = centre + Vector3::new(0.0, 0.0, DOME_HEIGHT_OFFSET_MM);
        assert!((Vector3::from(ball.centre_mm) - raised).norm() < 1e-9, "{}", ball.id);
    }
}

#[test]
fn g4_calibrated_machine_with_fitted_stylus_has_no_deviations() {
    let all = max_mean_and_stylus_of_variants(|| 0.0);
    let of = |name: &str| *all.iter().find(|(own, ..)| *own == name).unwrap();
    let largest = |name: &str| of(name).1;
    assert!((165.0..190.0).contains(&largest("N1")));
    assert!((125.0..134.0).contains(&largest("N3")) && (of("N3").3.x + 0.05).abs() < 0.01);
    assert!((42.0..45.0).contains(&largest("S1")));
    for name in ["S2", "S3", "S4"] {
        assert!(largest(name) < 0.01, "{name}: {}", largest(name));
        assert!((of(name).3 - Vector3::new(-0.012, -0.012, -326.746)).norm() < 1e-5);
    }
}

#[test]
fn g4_calibrated_machine_reduces_noisy_deviations_fivefold() {
    let mut random = seeded_stream(1, &[4]);
    let all = max_mean_and_stylus_of_variants(|| 1e-3 * Distribution::<f64>::sample(&StandardNormal, &mut random));
    let of = |name: &str| all.iter().find(|(own, ..)| *own == name).unwrap();
    assert!((165.0..190.0).contains(&of("N1").1) && (45.0..65.0).contains(&of("S1").1));
    assert!((125.0..150.0).contains(&of("N3").1) && (of("N3").3.x + 0.05).abs() < 0.01);
    assert!(of("S3").1 < 0.2 * of("N1").1 && of("S3").2 < 0.2 * of("N1").2);
}
