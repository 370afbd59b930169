//! Acceptance tests G3 of METHODS.

use super::super::fit::SeparationFit;
use super::super::layout_prediction::{SeparationMethod, noise_gain_by_order, rms_noise_gain};
use super::super::model::ProbeLayout;
use super::determinant::{separation_determinant, suppressed_orders, weak_orders};
use super::simulated_motions::{ScanSize, SimulatedMotions};
use estimation::revolutions::{ChannelAtMounting, HarmonicBasis, HarmonicData};

const SENSOR_ANGLES_DEG: [f64; 3] = [0.0, 90.0, 230.0];
const SAMPLES_PER_REVOLUTION: usize = 360;
const NOISE_STD_MM: f64 = 0.05e-3;

#[test]
fn gate_g3_determinant_and_noise_gain() {
    assert!(
        (separation_determinant(SENSOR_ANGLES_DEG, 4) - 0.8158).abs() < 5e-5,
        "{}",
        separation_determinant(SENSOR_ANGLES_DEG, 4)
    );
    assert_eq!(suppressed_orders(SENSOR_ANGLES_DEG, 40), [1, 35, 37]);
    assert_eq!(weak_orders(SENSOR_ANGLES_DEG, 40), [4, 32, 40]);
    for order in [4, 32, 40] {
        assert!((separation_determinant(SENSOR_ANGLES_DEG, order) - 0.8158).abs() < 5e-5);
    }
    for beta in [100.0, 130.0, 200.0, 250.0, 310.0] {
        let zeros = suppressed_orders([0.0, 90.0, beta], 37);
        assert!([1, 35, 37].iter().all(|order| zeros.contains(order)), "{beta}: {zeros:?}");
    }
    let zeros = suppressed_orders([0.0, 90.0, 240.0], 20);
    assert!(zeros.contains(&11) && zeros.contains(&13), "{zeros:?}");
    // The least squares do not determine the harmonics with a zero determinant.
    for angles in [SENSOR_ANGLES_DEG, [0.0, 90.0, 240.0]] {
        let layout = ProbeLayout::with_radial_sensors(&angles, 1);
        let gains = noise_gain_by_order(&layout, SeparationMethod::Multiprobe, 2..=40).unwrap();
        let lost = gains.iter().filter(|(_, gain)| gain.is_infinite());
        let mut zeros = suppressed_orders(angles, 40);
        zeros.retain(|order| *order > 1);
        assert_eq!(lost.map(|(order, _)| *order).collect::<Vec<_>>(), zeros);
    }
    for (beta, expected) in [(220.0, 1.48), (230.0, 1.53), (250.0, 1.75), (260.0, 2.52)] {
        let layout = ProbeLayout::with_radial_sensors(&[0.0, 90.0, beta], 1);
        let gain = rms_noise_gain(&layout, SeparationMethod::Multiprobe).unwrap();
        assert!((gain - expected).abs() < 0.0051, "{beta}: {gain}");
    }
}

/// The paper's measurement: all three sensors at the first index, then the first two at ten indexes.
fn paper_channels_at_indexes() -> Vec<ChannelAtMounting> {
    let mut rows: Vec<ChannelAtMounting> =
        (0..3).map(|channel| ChannelAtMounting { mounting_index: 0, channel_index: channel }).collect();
    rows.extend(
        (0..10).flat_map(|n| [0, 1].map(|channel| ChannelAtMounting { mounting_index: n + 1, channel_index: channel })),
    );
    rows
}

fn paper_layout() -> ProbeLayout {
    let mut layout = ProbeLayout::with_radial_sensors(&SENSOR_ANGLES_DEG, 10);
    layout.index_angles_rad.insert(0, 0.0);
    layout
}

#[test]
fn gate_g3_scatter_of_the_combined_separation_is_as_predicted() {
    let (layout, rows) = (paper_layout(), paper_channels_at_indexes());
    let basis = HarmonicBasis::new(SAMPLES_PER_REVOLUTION, 20);
    let (mut squares, mut predicted, mut trials) = (vec![0.0; 20], vec![0.0; 20], 0.0);
    for seed in 0..200 {
        let mut world = SimulatedMotions::with_random_terms(seed, 20, 1, NOISE_STD_MM);
        world.a.clear();
        world.b.clear();
        let measured = world.simulate_revolutions(
            &layout,
            &rows,
            ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 1 },
            seed,
        );
        let of = |k: usize| measured.iter().map(|row| basis.harmonics(&row.revolutions[0])[k]).collect();
        let means = (0..20).map(of).collect();
        let data = HarmonicData::from_declared_uncertainty(rows.clone(), means, NOISE_STD_MM, SAMPLES_PER_REVOLUTION);
        let fit = SeparationFit::new(&layout, &data).unwrap();
        trials += 1.0;
        for (k, harmonic) in fit.blocks.iter().enumerate() {
            assert!(harmonic.undetermined_names.is_empty(), "{:?}", harmonic.undetermined_names);
            let truth = [
                world.x[k].cosine_amplitude,
                world.x[k].sine_amplitude,
                world.y[k].cosine_amplitude,
                world.y[k].sine_amplitude,
            ];
            let errors = harmonic.solution.x.iter().zip(truth).map(|(x, truth)| x - truth);
            // Squared error of the complex harmonic, mean of X and Y.
            squares[k] += errors.map(|error| error * error).sum::<f64>() / 2.0;
            let variance = |j| harmonic.solution.covariance[(j, j)];
            predicted[k] = (0..4).map(variance).sum::<f64>() / 2.0;
        }
    }
    let (mut observed_sum, mut predicted_sum) = (0.0, 0.0);
    for k in 1..=20 {
        let expected_um = match k {
            1 | 4 => 0.0016,
            10 => 0.0052,
            20 => 0.0032,
            _ => 0.0015,
        };
        let rms_um = (squares[k - 1] / trials).sqrt() * 1e3;
        println!("k {k} rms {rms_um:.5} predicted {:.5}", predicted[k - 1].sqrt() * 1e3);
        assert!((rms_um / expected_um - 1.0).abs() < 0.15, "{k}: {rms_um} {expected_um}");
        observed_sum += squares[k - 1] / trials / predicted[k - 1];
        predicted_sum += 1.0;
    }
    let ratio = (predicted_sum / observed_sum).sqrt();
    println!("predicted/observed {ratio:.4}");
    assert!((ratio - 1.0).abs() < 0.05, "predicted/observed {ratio}");
}

#[test]
fn gate_g3_noise_free_separation_is_exact() {
    let (layout, rows) = (paper_layout(), paper_channels_at_indexes());
    let mut world = SimulatedMotions::with_random_terms(7, 20, 1, 0.0);
    world.a.clear();
    world.b.clear();
    let measured = world.simulate_revolutions(
        &layout,
        &rows,
        ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 2 },
        1,
    );
    let data = HarmonicData::from_revolutions(&measured, 20).unwrap();
    let fit = SeparationFit::new(&layout, &data).unwrap();
    let mut worst: f64 = 0.0;
    for (k, harmonic) in fit.blocks.iter().enumerate() {
        // Harmonic of w(−q): the sine part has the opposite sign.
        let form = world.section_forms[0][k];
        let [x, y] = [world.x[k], world.y[k]];
        let truth = [
            x.cosine_amplitude,
            x.sine_amplitude,
            y.cosine_amplitude,
            y.sine_amplitude,
            form.cosine_amplitude,
            -form.sine_amplitude,
        ];
        let errors = harmonic.solution.x.iter().zip(truth).map(|(x, truth)| (x - truth).abs());
        worst = errors.fold(worst, f64::max);
        assert!(harmonic.undetermined_names.is_empty());
    }
    println!("noise-free {worst:e} mm");
    assert!(worst < 1e-9, "{worst}");
}
