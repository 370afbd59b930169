//! Expanded uncertainties cover the truth: for noise alone, with its size from the scatter between revolutions, and
//! for all sources together.

use estimation::revolutions::{ChannelRevolutions, HarmonicData};
use std::f64::consts::TAU;

use super::super::model::{MeasuredSurface, ProbeLayout};
use super::super::outputs::ReportedMotions;
use super::super::settings::{MultiprobeSettings, TurnSampling};
use super::super::sources::SourceSizes;
use super::super::total_and_asynchronous::total_and_asynchronous_values;
use super::super::{SeparatedMotions, identify_motions};
use super::nullities::two_section_layout;
use super::simulated_motions::{ScanSize, SimulatedMotions, sum_of_terms};
use crate::identification::TrialSettings;
use estimation::coverage::coverage_factor;
use estimation::monte_carlo::{DrawDistribution, DrawStream, TrialCount};

const MAX_HARMONIC_ORDER: usize = 4;
const SAMPLES_PER_REVOLUTION: usize = 24;

fn peak_to_peak(values: &[f64]) -> f64 {
    let [largest, least] = [f64::max, f64::min].map(|pick| values.iter().copied().reduce(pick));
    largest.unwrap() - least.unwrap()
}

/// Settings with all declared values exactly known.
fn settings_without_uncertainty() -> MultiprobeSettings {
    MultiprobeSettings {
        sampling: TurnSampling::Continuous,
        u_gain: 0.0,
        u_sensor_angle_deg: 0.0,
        u_section_distance_mm: 0.0,
        u_face_radius_mm: 0.0,
        u_index_angle_deg: 0.0,
        ..MultiprobeSettings::default()
    }
}

const U_DRIFT_MM_PER_REVOLUTION: f64 = 0.02e-3;

/// Source sizes of the settings, with the drift in mm per revolution.
fn source_sizes(settings: &MultiprobeSettings, drift_mm_per_revolution: f64) -> SourceSizes<'_> {
    SourceSizes {
        settings,
        sensor_covariance: None,
        u_drift_mm_per_revolution: drift_mm_per_revolution,
        linearity_effects: Vec::new(),
    }
}

fn identify_revolutions(
    layout: &ProbeLayout,
    measured: &[ChannelRevolutions],
    sizes: &SourceSizes,
) -> SeparatedMotions {
    let data = HarmonicData::from_revolutions(measured, MAX_HARMONIC_ORDER).unwrap();
    identify_motions(layout, &data, sizes, None).unwrap()
}

/// Truth of a parameter such as `EXC_c2`, internal unit. `None` for a first harmonic, as a part of it is
/// eccentricity.
fn true_value(world: &SimulatedMotions, symbol: &str) -> Option<f64> {
    let (name, part) = symbol.split_once('_').filter(|(_, part)| part.len() > 2 || !part.ends_with('1'))?;
    let terms = match name {
        "EXC" => &world.x,
        "EYC" => &world.y,
        "EZC" => &world.z,
        "EAC" => &world.a,
        "EBC" => &world.b,
        _ => return None,
    };
    let term = terms[part[1..].parse::<usize>().ok()? - 1];
    Some(if part.starts_with('c') { term.cosine_amplitude } else { term.sine_amplitude })
}

#[derive(Default)]
struct CoverageCount {
    covered_count: usize,
    parameter_count: usize,
    /// Σ (error/u)².
    normalized_error_squares: f64,
}

impl CoverageCount {
    /// Counts the parameters whose symbols start with `prefix`.
    fn add_parameters(&mut self, separated: &SeparatedMotions, world: &SimulatedMotions, prefix: &str) {
        let parameters = &separated.identification.outputs.linear_parameters;
        for (i, output) in parameters.iter().enumerate() {
            let Some(truth) = true_value(world, &output.symbol) else { continue };
            if !output.symbol.starts_with(prefix) {
                continue;
            }
            let uncertainty = separated.identification.parameter_uncertainty(i).unwrap();
            let k = coverage_factor(uncertainty.dof.unwrap_or(f64::INFINITY));
            self.covered_count += usize::from((output.value - truth).abs() <= k * uncertainty.u);
            self.normalized_error_squares += ((output.value - truth) / uncertainty.u).powi(2);
            self.parameter_count += 1;
        }
    }

    fn covered_share(&self) -> f64 {
        self.covered_count as f64 / self.parameter_count as f64
    }
}

/// Sensor noise, and an asynchronous motion along X that affects all radial sensors together.
#[test]
fn expanded_uncertainty_covers_noise_and_asynchronous_motion() {
    let layout = two_section_layout(3, -1.0);
    let rows = layout.all_row_keys();
    for (asynchronous_mm, prefix) in [(0.0, "E"), (0.5e-3, "EXC"), (0.5e-3, "EB")] {
        let mut covered = CoverageCount::default();
        for seed in 0..300 {
            let world = SimulatedMotions::with_random_terms(seed, MAX_HARMONIC_ORDER, 2, 0.1e-3);
            let mut measured = world.simulate_revolutions(
                &layout,
                &rows,
                ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 4 },
                seed,
            );
            let mut random = DrawStream::from_key(seed, &[5]);
            let count = layout.index_angles_rad.len() * 4 * SAMPLES_PER_REVOLUTION;
            let together = random.unit_variance_draws(count, &[DrawDistribution::Normal]);
            for row in &mut measured {
                let channel = &layout.channels[row.key.channel_index];
                let MeasuredSurface::Section(_) = channel.surface else { continue };
                let own = &together[row.key.mounting_index * 4 * SAMPLES_PER_REVOLUTION..];
                let values = row.revolutions.iter_mut().flatten().zip(own);
                values.for_each(|(m, x)| *m += asynchronous_mm * x * channel.angle_rad.cos());
            }
            covered.add_parameters(
                &identify_revolutions(&layout, &measured, &source_sizes(&settings_without_uncertainty(), 0.0)),
                &world,
                prefix,
            );
        }
        let (share, squares) =
            (covered.covered_share(), covered.normalized_error_squares / covered.parameter_count as f64);
        println!("asynchronous {asynchronous_mm} {prefix}: {share:.4}, χ² {squares:.3}");
        assert!(share > 0.93 && share < 0.975, "{share}");
        assert!(squares > 0.9 && squares < 1.2, "{squares}");
    }
}

/// All sources: the measurement is generated with a drawn layout and identified with the nominal one.
#[test]
fn expanded_uncertainty_covers_all_sources() {
    let declared = MultiprobeSettings {
        u_gain: 2e-3,
        u_sensor_angle_deg: 0.1,
        u_section_distance_mm: 0.1,
        u_face_radius_mm: 0.1,
        u_index_angle_deg: 0.1,
        ..settings_without_uncertainty()
    };
    let sizes = source_sizes(&declared, U_DRIFT_MM_PER_REVOLUTION);
    let nominal = two_section_layout(3, -1.0);
    let (mut covered, mut ratios) = (CoverageCount::default(), Vec::new());
    for seed in 0..300 {
        let drawn = DrawnLayout::new(&nominal, &declared, seed);
        let world = SimulatedMotions::with_random_terms(seed, MAX_HARMONIC_ORDER, 2, 0.01e-3);
        let measured = drawn.simulate_revolutions(&world, seed);
        let separated = identify_revolutions(&nominal, &measured, &sizes);
        let misfit = &separated.identification.propagation.misfit;
        ratios.push(misfit.chi2 / misfit.expected_chi2);
        covered.add_parameters(&separated, &world, "E");
    }
    let CoverageCount { normalized_error_squares: squares, parameter_count: all, .. } = covered;
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    println!("all {:.4}, χ² {:.3}, misfit {mean:.3}", covered.covered_share(), squares / all as f64);
    assert!(covered.covered_share() > 0.93 && covered.covered_share() < 0.975, "{}", covered.covered_share());
    assert!((squares / all as f64 - 1.0).abs() < 0.1 && (mean - 1.0).abs() < 0.1);
}

/// A layout with errors drawn from the declared uncertainties.
struct DrawnLayout {
    layout: ProbeLayout,
    gains: Vec<f64>,
    drift_mm: [f64; 3],
}

impl DrawnLayout {
    fn new(nominal: &ProbeLayout, declared_settings: &MultiprobeSettings, seed: u64) -> Self {
        let mut units =
            DrawStream::from_key(seed, &[9]).unit_variance_draws(64, &[DrawDistribution::Normal]).into_iter();
        let mut draw = |size: f64| size * units.next().unwrap();
        let mut layout = nominal.clone();
        layout.section_z_mm[1] += draw(declared_settings.u_section_distance_mm);
        let face = draw(declared_settings.u_face_radius_mm);
        for channel in &mut layout.channels {
            channel.angle_rad += draw(declared_settings.u_sensor_angle_rad());
            if let MeasuredSurface::Face { radius_mm } = &mut channel.surface {
                *radius_mm += face;
            }
        }
        for angle in &mut layout.index_angles_rad[1..] {
            *angle += draw(declared_settings.u_index_angle_deg.to_radians());
        }
        let gains = layout.channels.iter().map(|_| 1.0 + draw(declared_settings.u_gain)).collect();
        let drift = [U_DRIFT_MM_PER_REVOLUTION; 3].map(draw);
        Self { layout, gains, drift_mm: drift }
    }

    /// Simulated revolutions of this layout. The drift starts again in each revolution.
    fn simulate_revolutions(&self, world: &SimulatedMotions, seed: u64) -> Vec<ChannelRevolutions> {
        let rows = self.layout.all_row_keys();
        let mut measured = world.simulate_revolutions(
            &self.layout,
            &rows,
            ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 4 },
            seed,
        );
        for row in &mut measured {
            let channel = &self.layout.channels[row.key.channel_index];
            let (sin, cos) = channel.angle_rad.sin_cos();
            let along = match channel.surface {
                MeasuredSurface::Section(_) => self.drift_mm[0] * cos + self.drift_mm[1] * sin,
                MeasuredSurface::Face { .. } => self.drift_mm[2],
            };
            for (i, value) in row.revolutions.iter_mut().flatten().enumerate() {
                let part = (i % SAMPLES_PER_REVOLUTION) as f64 / SAMPLES_PER_REVOLUTION as f64 - 0.5;
                *value = self.gains[row.key.channel_index] * (*value + along * part);
            }
        }
        measured
    }
}

#[test]
fn co_rotating_motion_is_reported_as_eccentricity() {
    let layout = two_section_layout(3, -1.0);
    let world = SimulatedMotions::with_random_terms(2, MAX_HARMONIC_ORDER, 2, 1e-7);
    let measured = world.simulate_revolutions(
        &layout,
        &layout.all_row_keys(),
        ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 2 },
        1,
    );
    let separated = identify_revolutions(&layout, &measured, &source_sizes(&settings_without_uncertainty(), 0.0));
    assert!(
        ReportedMotions::new(&layout, &separated.fit).gauge_text.contains("(EXC, EYC) and (EAC, EBC)"),
        "{}",
        ReportedMotions::new(&layout, &separated.fit).gauge_text
    );
    assert_eq!(
        ReportedMotions::new(&layout, &separated.fit).describe_not_identifiable()[..2],
        ["EZC harmonic 3", "F harmonic 3"]
    );
    let outputs = &separated.identification.outputs;
    let value =
        |symbol: &str| outputs.all_parameters().find(|output| output.symbol == symbol).map(|output| output.value);
    // The counter-rotating part of x alone remains: half of it along X and half along Y.
    let sign = layout.turn_sign;
    let (x, y) = (world.x[0], world.y[0]);
    let counter_rotating =
        [(x.cosine_amplitude - sign * y.sine_amplitude) / 2.0, (x.sine_amplitude + sign * y.cosine_amplitude) / 2.0];
    assert!((value("EXC_c1").unwrap() - counter_rotating[0]).abs() < 1e-6);
    assert!((value("EXC_s1").unwrap() - counter_rotating[1]).abs() < 1e-6);
    assert_eq!(value("EZC_c3"), None);
    let height = layout.section_z_mm[1];
    let form = world.section_forms[1][0];
    let co_x = (x.cosine_amplitude
        + height * world.b[0].cosine_amplitude
        + sign * (y.sine_amplitude - height * world.a[0].sine_amplitude))
        / 2.0;
    assert!((value("ecc_X2").unwrap() - co_x - form.cosine_amplitude).abs() < 1e-6);
    let exy = |q: f64| {
        sum_of_terms(&world.z, q)
            - world.z[2].cosine_amplitude * (3.0 * q).cos()
            - world.z[2].sine_amplitude * (3.0 * q).sin()
    };
    let values: Vec<f64> = (0..360).map(|i| exy(f64::from(i) * TAU / 360.0)).collect();
    let range = peak_to_peak(&values);
    assert!((value("EZC_synchronous").unwrap() - range).abs() < 1e-6);
    let amplitude = world.z[0].cosine_amplitude.hypot(world.z[0].sine_amplitude);
    assert!((value("EZC_fundamental").unwrap() - 2.0 * amplitude).abs() < 1e-6);
}

#[test]
fn trials_give_nonlinear_values_an_uncertainty() {
    let layout = two_section_layout(3, -1.0);
    let world = SimulatedMotions::with_random_terms(2, MAX_HARMONIC_ORDER, 2, 0.1e-3);
    let measured = world.simulate_revolutions(
        &layout,
        &layout.all_row_keys(),
        ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 4 },
        1,
    );
    let data = HarmonicData::from_revolutions(&measured, MAX_HARMONIC_ORDER).unwrap();
    let plan = TrialSettings { seed: 1, trial_count: TrialCount::Fixed(20_000) };
    let separated =
        identify_motions(&layout, &data, &source_sizes(&settings_without_uncertainty(), 0.0), Some(plan)).unwrap();
    let estimate = separated.identification.estimate("multiprobe");
    for parameter in &estimate.parameters {
        let trials = parameter.u_monte_carlo.unwrap();
        assert!(trials.is_finite() && trials > 0.0);
        if !parameter.budget.is_empty() {
            assert!((trials / parameter.u - 1.0).abs() < 0.03, "{}", parameter.symbol);
        }
    }
    let roundness = estimate.parameters.iter().find(|p| p.symbol == "RONt_1").unwrap();
    assert!(roundness.u.is_finite() && roundness.value > 0.0);
    assert_eq!(estimate.functions.len(), 7);
}

/// The revolutions are displaced by +0.5 µm and −0.5 µm along X in alternation, at every third sample only.
#[test]
fn asynchronous_and_total_values_agree_with_the_simulation() {
    let layout = two_section_layout(4, -1.0);
    let mut world = SimulatedMotions::with_random_terms(2, MAX_HARMONIC_ORDER, 2, 0.0);
    // Motion that turns with the table is not reported as error motion.
    for term in [&mut world.x[0], &mut world.y[0]] {
        (term.cosine_amplitude, term.sine_amplitude) = (0.0, 0.0);
    }
    let mut measured = world.simulate_revolutions(
        &layout,
        &layout.all_row_keys(),
        ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 4 },
        1,
    );
    for row in &mut measured {
        let channel = &layout.channels[row.key.channel_index];
        let MeasuredSurface::Section(_) = channel.surface else { continue };
        for (r, revolution) in row.revolutions.iter_mut().enumerate() {
            let by_mm = if r % 2 == 0 { 0.5e-3 } else { -0.5e-3 };
            let moved = revolution.iter_mut().step_by(3);
            moved.for_each(|m| *m += by_mm * channel.angle_rad.cos());
        }
    }
    let separated = identify_revolutions(&layout, &measured, &source_sizes(&settings_without_uncertainty(), 0.0));
    let motions = ReportedMotions::new(&layout, &separated.fit);
    let values = total_and_asynchronous_values(&layout, &motions, &measured);
    let value = |symbol: &str| values.iter().find(|p| p.symbol == symbol).unwrap();
    assert!((value("EXC_asynchronous").value - 1.0).abs() < 1e-9);
    assert!(value("EYC_asynchronous").value < 1e-9 && value("EBC_asynchronous").value < 1e-6);
    assert!(value("EXC_asynchronous").u < 1e-9 && value("EXC_total").dof == Some(3.0));
    let angles = || (0..SAMPLES_PER_REVOLUTION).map(|i| i as f64 * TAU / SAMPLES_PER_REVOLUTION as f64);
    let moved = angles().step_by(3).flat_map(|q| [-0.5e-3, 0.5e-3].map(|by| sum_of_terms(&world.x, q) + by));
    let all: Vec<f64> = angles().map(|q| sum_of_terms(&world.x, q)).chain(moved).collect();
    let expected_um = peak_to_peak(&all) * 1e3;
    println!("total {} {expected_um}", value("EXC_total").value);
    assert!((value("EXC_total").value - expected_um).abs() < 1e-6);
}

/// With one mounting, axial motion and form of the face are inseparable, and EZC is not reported.
#[test]
fn one_mounting_reports_no_axial_motion() {
    let layout = two_section_layout(1, -1.0);
    let world = SimulatedMotions::with_random_terms(2, MAX_HARMONIC_ORDER, 2, 1e-7);
    let size = ScanSize { samples_per_revolution: SAMPLES_PER_REVOLUTION, revolutions: 3 };
    let measured = world.simulate_revolutions(&layout, &layout.all_row_keys(), size, 1);
    let separated = identify_revolutions(&layout, &measured, &source_sizes(&settings_without_uncertainty(), 0.0));
    let outputs = &separated.identification.outputs;
    assert!(outputs.all_parameters().all(|output| !output.symbol.starts_with("EZC")));
    assert!(outputs.curves.iter().all(|curve| curve.symbol != "EZC"));
    assert_eq!(outputs.curves.len(), 6);
    let lost = &ReportedMotions::new(&layout, &separated.fit).describe_not_identifiable();
    println!("{lost:?}");
    assert!(lost.contains(&"EZC harmonic 2".to_owned()) && lost.contains(&"R1 harmonic 1".to_owned()));
    assert!(
        ReportedMotions::new(&layout, &separated.fit).gauge_text.contains("(EXC, EYC) and (EAC, EBC)"),
        "{}",
        ReportedMotions::new(&layout, &separated.fit).gauge_text
    );
    let all = outputs.all_parameters();
    let of_x: Vec<f64> = all.filter(|o| o.symbol == "EXC_c2").map(|o| o.value).collect();
    assert!((of_x[0] - world.x[1].cosine_amplitude).abs() < 1e-6);
}
