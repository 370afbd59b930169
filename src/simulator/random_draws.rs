//! Errors that the machine file declares by magnitude only, drawn from the seed. Each source has its own random
//! stream, so that a change of one source does not change the others.
use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::flank::FormHarmonic;
use super::sensor_truth::LinearityWave;
use estimation::random;

#[derive(Debug, Clone, Copy)]
pub(super) enum RandomSource {
    Repeatability = 1,
    Lobing,
    StylusOffset,
    ErrorMotion,
    Drift,
    Roughness,
    Ball,
    Length,
    RotaryMotion,
    ScanPhase,
    SampleNoise,
    Linearity,
    SampleDelay,
    Squareness,
    Incidence,
    Thermometer,
    SectionForm,
    Mounting,
    DeclaredMotion,
    Asynchronous,
    Backlash,
    ArtefactTemperature,
}

/// Standard normal numbers of one source.
pub(super) fn standard_normals(seed: u64, source: RandomSource, key: &[u64]) -> impl Iterator<Item = f64> {
    let key: Vec<u64> = std::iter::once(source as u64).chain(key.iter().copied()).collect();
    StandardNormal.sample_iter(random::seeded_stream(seed, &key))
}

pub(super) fn first_normal(seed: u64, source: RandomSource, key: &[u64]) -> f64 {
    standard_normals(seed, source, key).next().unwrap_or_default()
}

/// Deviation of one touch, in standard deviations.
pub(super) fn draw_touch_scatter(seed: u64, n: u32, occurrence: u32) -> f64 {
    first_normal(seed, RandomSource::Repeatability, &[u64::from(n), u64::from(occurrence)])
}

/// Phase, 0 to 1, of the PLC scan at which the contact of one touch occurs.
pub(super) fn draw_scan_phase(seed: u64, n: u32, occurrence: u32) -> f64 {
    random::seeded_stream(seed, &[RandomSource::ScanPhase as u64, u64::from(n), u64::from(occurrence)]).random()
}

/// Deviation of one sample of a displacement sensor, in standard deviations.
pub(super) fn draw_sample_noise(seed: u64, sensor: usize, sample: u64) -> f64 {
    first_normal(seed, RandomSource::SampleNoise, &[sensor as u64, sample])
}

/// Error of a thermometer reading, in standard deviations.
pub(super) fn draw_thermometer_noise(seed: u64, thermometer: usize, second: u64) -> f64 {
    first_normal(seed, RandomSource::Thermometer, &[thermometer as u64, second])
}

/// Delay of one sample, in standard deviations.
pub(super) fn draw_sample_delay(seed: u64, sensor: usize, sample: u64) -> f64 {
    first_normal(seed, RandomSource::SampleDelay, &[sensor as u64, sample])
}

/// Two to six waves over the range `span_mm` of a displacement sensor, with a total standard deviation
/// `sigma_um` at every distance. A lower order would be a gain error.
pub(super) fn draw_linearity_waves(seed: u64, sensor: usize, sigma_um: f64, span_mm: f64) -> Vec<LinearityWave> {
    const HARMONIC_ORDERS: std::ops::RangeInclusive<u32> = 2..=6;
    if sigma_um == 0.0 {
        return Vec::new();
    }
    let term_sigma = sigma_um / (HARMONIC_ORDERS.count() as f64).sqrt();
    let wave = |n: u32| {
        let draw = |part| first_normal(seed, RandomSource::Linearity, &[sensor as u64, n.into(), part]);
        let (cos, sin): (f64, f64) = (draw(0), draw(1));
        let phase_deg = cos.atan2(sin).to_degrees();
        LinearityWave { amplitude_um: term_sigma * cos.hypot(sin), period_mm: span_mm / f64::from(n), phase_deg }
    };
    HARMONIC_ORDERS.map(wave).collect()
}

/// Lost motion of a linear axis, in standard uncertainties.
pub(super) fn sample_backlash(seed: u64, axis: u64) -> f64 {
    first_normal(seed, RandomSource::Backlash, &[axis]).abs()
}

/// True minus stated stylus centre, spindle frame, in the unit of `sigma`.
pub(super) fn draw_stylus_offset(seed: u64, sigma: f64) -> Vector3<f64> {
    let draw = |axis| sigma * first_normal(seed, RandomSource::StylusOffset, &[axis]);
    Vector3::new(draw(0), draw(1), 0.0)
}

/// Harmonics 16 to 64 of the artefact's form, with a total standard deviation `sigma_um`.
pub(super) fn draw_roughness(seed: u64, sigma_um: f64) -> Vec<FormHarmonic> {
    const HARMONIC_ORDERS: std::ops::RangeInclusive<u32> = 16..=64;
    if sigma_um == 0.0 {
        return Vec::new();
    }
    let term_sigma = sigma_um / (HARMONIC_ORDERS.count() as f64).sqrt();
    let draw = |n, part| term_sigma * first_normal(seed, RandomSource::Roughness, &[u64::from(n), part]);
    HARMONIC_ORDERS.map(|n| FormHarmonic { n, cos_um: draw(n, 0), sin_um: draw(n, 1) }).collect()
}

/// Harmonics 2 to 20 of one section of a datum cylinder, with a total standard deviation `sigma_um`.
pub(super) fn draw_section_form(seed: u64, section: u64, sigma_um: f64) -> Vec<FormHarmonic> {
    const HARMONIC_ORDERS: std::ops::RangeInclusive<u32> = 2..=20;
    if sigma_um == 0.0 {
        return Vec::new();
    }
    let term_sigma = sigma_um / (HARMONIC_ORDERS.count() as f64).sqrt();
    let draw = |n, part| term_sigma * first_normal(seed, RandomSource::SectionForm, &[section, u64::from(n), part]);
    HARMONIC_ORDERS.map(|n| FormHarmonic { n, cos_um: draw(n, 0), sin_um: draw(n, 1) }).collect()
}

/// Error of one mounting of an artefact, in standard deviations.
pub(super) fn draw_mounting_error(seed: u64, number: u32, part: u64) -> f64 {
    first_normal(seed, RandomSource::Mounting, &[u64::from(number), part])
}

/// Deviations of one ball from the stated ball, in standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BallDraw {
    /// Deviation of each coordinate of the centre.
    pub centre: Vector3<f64>,
    pub diameter: f64,
    /// Symmetric and without trace: uᵀ·oval·u has mean 0 and, over all balls, variance 1 for every u.
    pub oval: Matrix3<f64>,
}

pub(super) fn sample_ball_form(seed: u64, index: usize) -> BallDraw {
    let draw = |part| first_normal(seed, RandomSource::Ball, &[index as u64, part]);
    // For S with variance 1 on and 1/2 off the diagonal, uᵀSu has variance 1; removing a third of the trace
    // leaves 2/3.
    let full = Matrix3::from_diagonal(&Vector3::new(draw(4), draw(5), draw(6)))
        + symmetric_off_diagonal([draw(7), draw(8), draw(9)]) * 0.5_f64.sqrt();
    let oval = (full - Matrix3::from_diagonal_element(full.trace() / 3.0)) * 1.5_f64.sqrt();
    BallDraw { centre: Vector3::new(draw(0), draw(1), draw(2)), diameter: draw(3), oval }
}

fn symmetric_off_diagonal([xy, xz, yz]: [f64; 3]) -> Matrix3<f64> {
    Matrix3::from([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
}

/// Deviations of one certified length from its certificate, in standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LengthDraw {
    pub certificate: f64,
    pub temperature: f64,
}

pub(super) fn draw_length(seed: u64, number: usize) -> LengthDraw {
    let draw = |part| first_normal(seed, RandomSource::Length, &[number as u64, part]);
    LengthDraw { certificate: draw(0), temperature: draw(1) }
}

/// Temperature error of the whole artefact, in standard uncertainties.
pub(super) fn draw_artefact_temperature(seed: u64) -> f64 {
    first_normal(seed, RandomSource::ArtefactTemperature, &[])
}

/// Pre-travel of the probe as a function of the direction of the contact normal, spindle frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lobing {
    /// (harmonic, cosine, sine), mm.
    terms: Vec<(f64, f64, f64)>,
}

impl Lobing {
    /// Draws the declared harmonics, or 2 to 6: the first is a stylus offset, the zeroth is part of the ball's
    /// radius.
    pub fn draw(seed: u64, sigma_mm: f64, declared: &[u32]) -> Self {
        let orders = if declared.is_empty() { &[2, 3, 4, 5, 6] } else { declared };
        let term_sigma = sigma_mm / (orders.len() as f64).sqrt();
        let draw = |n, part| term_sigma * first_normal(seed, RandomSource::Lobing, &[u64::from(n), part]);
        Self { terms: orders.iter().map(|n| (f64::from(*n), draw(*n, 0), draw(*n, 1))).collect() }
    }

    /// Pre-travel, mm, for the unit contact normal `n` in the spindle frame. It falls to zero towards the axis
    /// of the stylus, where the azimuth is undefined.
    pub fn pre_travel_mm(&self, n: Vector3<f64>) -> f64 {
        let (radial_component, phi) = (n.x.hypot(n.y), n.y.atan2(n.x));
        let sum: f64 = self.terms.iter().map(|(k, c, s)| c * (k * phi).cos() + s * (k * phi).sin()).sum();
        radial_component * sum
    }
}

/// Error from a tilted surface, um: one term with the squared tangent of the tilt, and one term with the
/// tangent along each of the two directions across the beam.
pub(super) fn draw_incidence_errors(seed: u64, sensor: usize, sigma_um: f64) -> (f64, [f64; 2]) {
    let draw = |part| sigma_um * first_normal(seed, RandomSource::Incidence, &[sensor as u64, part]);
    (draw(0), [draw(1), draw(2)])
}

/// Coefficients of an error motion of a rotary axis, in standard deviations; `key`: axis, component, order, part.
pub(super) fn draw_rotary_motion(seed: u64, key: [u64; 4]) -> f64 {
    first_normal(seed, RandomSource::RotaryMotion, &key)
}

/// Coefficients of a `[[simulated.rotary_motion]]`, with the same key.
pub(super) fn draw_declared_motion(seed: u64, key: [u64; 4]) -> f64 {
    first_normal(seed, RandomSource::DeclaredMotion, &key)
}

/// Coefficients of the part of a `[[simulated.rotary_motion]]` that does not repeat, with the same key.
pub(super) fn draw_asynchronous_motion(seed: u64, key: [u64; 4]) -> f64 {
    first_normal(seed, RandomSource::Asynchronous, &key)
}

/// Slow thermal motion of the table against the spindle, and thermal growth of the artefact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drift {
    table_mm_per_s: Vector3<f64>,
    radius_mm_per_s: f64,
}

/// Time constant of the warm-up of the machine, s.
const WARM_UP_TIME_CONSTANT_S: f64 = 7200.0;

/// Share of the change to thermal equilibrium that is complete at `t_s`.
pub(super) fn equilibrium_share(t_s: f64) -> f64 {
    1.0 - (-t_s / WARM_UP_TIME_CONSTANT_S).exp()
}

impl Drift {
    pub fn draw(seed: u64, sigma_um_per_h: f64) -> Self {
        let sigma = sigma_um_per_h * 1e-3 / 3600.0;
        let draw = |part| sigma * first_normal(seed, RandomSource::Drift, &[part]);
        let table_mm_per_s = Vector3::new(draw(0), draw(1), draw(3));
        Self { table_mm_per_s, radius_mm_per_s: draw(2) }
    }

    /// Displacement of the table, machine frame, mm.
    pub fn table_displacement(&self, t_s: f64) -> Vector3<f64> {
        self.table_mm_per_s * Self::equivalent_time_s(t_s)
    }

    /// Growth of the artefact's radius, mm.
    pub fn radius_growth(&self, t_s: f64) -> f64 {
        self.radius_mm_per_s * Self::equivalent_time_s(t_s)
    }

    /// Time for which the initial rate gives the same change, s: the machine approaches thermal equilibrium.
    fn equivalent_time_s(t_s: f64) -> f64 {
        WARM_UP_TIME_CONSTANT_S * equilibrium_share(t_s)
    }
}
