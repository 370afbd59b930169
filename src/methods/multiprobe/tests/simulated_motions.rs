//! Simulated table and cylinder as functions of the angle. They use no formula of the estimator, but displacements
//! of points in space and the form over the angle on the artefact.

use estimation::revolutions::{ChannelAtMounting, ChannelRevolutions};
use std::f64::consts::TAU;

use estimation::random::seeded_stream;
use rand::RngExt;

use super::super::model::{MeasuredSurface, ProbeLayout};

/// Term a·cos kq + b·sin kq.
#[derive(Debug, Clone, Copy)]
pub struct HarmonicTerm {
    pub order: f64,
    pub cosine_amplitude: f64,
    pub sine_amplitude: f64,
}

pub fn sum_of_terms(terms: &[HarmonicTerm], angle: f64) -> f64 {
    terms
        .iter()
        .map(|t| t.cosine_amplitude * (t.order * angle).cos() + t.sine_amplitude * (t.order * angle).sin())
        .sum()
}

/// Error motions over the commanded angle (mm, rad), form over the angle on the artefact (mm).
#[derive(Debug, Clone, Default)]
pub struct SimulatedMotions {
    pub x: Vec<HarmonicTerm>,
    pub y: Vec<HarmonicTerm>,
    pub z: Vec<HarmonicTerm>,
    pub a: Vec<HarmonicTerm>,
    pub b: Vec<HarmonicTerm>,
    pub section_forms: Vec<Vec<HarmonicTerm>>,
    pub face_form: Vec<HarmonicTerm>,
    /// Standard deviation of a sample, mm.
    pub noise_std_mm: f64,
}

/// Samples per revolution, and number of revolutions of a scan.
#[derive(Debug, Clone, Copy)]
pub struct ScanSize {
    pub samples_per_revolution: usize,
    pub revolutions: usize,
}

/// Terms of orders 1..=`orders` with random amplitudes up to `max_amplitude`.
pub fn random_terms(seed: u64, key: u64, orders: usize, max_amplitude: f64) -> Vec<HarmonicTerm> {
    let mut random = seeded_stream(seed, &[key]);
    let mut draw = || max_amplitude * (2.0 * random.random::<f64>() - 1.0);
    (1..=orders)
        .map(|order| HarmonicTerm { order: order as f64, cosine_amplitude: draw(), sine_amplitude: draw() })
        .collect()
}

impl SimulatedMotions {
    /// Random motions and forms with harmonics up to `orders`.
    pub fn with_random_terms(seed: u64, orders: usize, sections: usize, noise_mm: f64) -> Self {
        let terms = |key, size| random_terms(seed, key, orders, size);
        Self {
            x: terms(1, 1e-3),
            y: terms(2, 1e-3),
            z: terms(3, 1e-3),
            a: terms(4, 1e-5),
            b: terms(5, 1e-5),
            section_forms: (0..sections).map(|i| terms(10 + i as u64, 2e-3)).collect(),
            face_form: terms(6, 2e-3),
            noise_std_mm: noise_mm,
        }
    }

    /// Displacement of the surface towards the sensor at the table angle `q`, without noise.
    pub fn surface_deviation_mm(&self, layout: &ProbeLayout, row: ChannelAtMounting, q: f64) -> f64 {
        let channel = &layout.channels[row.channel_index];
        let gamma = channel.angle_rad;
        let on_artefact = gamma - layout.turn_sign * q - layout.index_angles_rad[row.mounting_index];
        let (a, b) = (sum_of_terms(&self.a, q), sum_of_terms(&self.b, q));
        match channel.surface {
            MeasuredSurface::Section(section) => {
                // The rotation vector (a, b, 0) moves the centre of the section by (a, b, 0) × (0, 0, h).
                let height = layout.section_z_mm[section] - layout.reference_z_mm;
                let centre = [sum_of_terms(&self.x, q) + b * height, sum_of_terms(&self.y, q) - a * height];
                let along = centre[0] * gamma.cos() + centre[1] * gamma.sin();
                along + sum_of_terms(&self.section_forms[section], on_artefact)
            }
            MeasuredSurface::Face { radius_mm } => {
                let point = [radius_mm * gamma.cos(), radius_mm * gamma.sin()];
                let tilted = a * point[1] - b * point[0];
                sum_of_terms(&self.z, q) + tilted + sum_of_terms(&self.face_form, on_artefact)
            }
        }
    }

    /// Sampled revolutions of the `rows`.
    pub fn simulate_revolutions(
        &self,
        layout: &ProbeLayout,
        rows: &[ChannelAtMounting],
        size: ScanSize,
        seed: u64,
    ) -> Vec<ChannelRevolutions> {
        let ScanSize { samples_per_revolution: samples, revolutions } = size;
        let mut noise = estimation::monte_carlo::DrawStream::from_key(seed, &[77]);
        let normal = [estimation::monte_carlo::DrawDistribution::Normal];
        let of = |row: &ChannelAtMounting| {
            let clean: Vec<f64> = (0..samples)
                .map(|i| self.surface_deviation_mm(layout, *row, i as f64 * TAU / samples as f64))
                .collect();
            let mut revolution = || {
                let units = noise.unit_variance_draws(samples, &normal);
                clean.iter().zip(units).map(|(m, unit)| m + self.noise_std_mm * unit).collect()
            };
            let revolutions: Vec<Vec<f64>> = (0..revolutions).map(|_| revolution()).collect();
            ChannelRevolutions { key: *row, revolutions }
        };
        rows.iter().map(of).collect()
    }
}
