//! Errors that the machine file declares by magnitude only, drawn from the seed. Each source has its own random
//! stream, so that a change of one source does not change the others.
use std::ops::RangeInclusive;

use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::sensor_truth::LinearityWave;
use super::true_round_part::FormHarmonic;
use estimation::random;

/// Random quantities, each with the meaning of its key. All are standard normal except `PlcScanPhase` and the phases
/// of `LinearAxisErrors`, which are uniform.
#[derive(Debug, Clone, Copy)]
pub(super) enum RandomSource {
    /// Scatter of one touch: N word, and occurrence of this N word.
    TouchScatter = 1,
    /// Harmonics of the pre-travel: order, part (0 cosine, 1 sine).
    Lobing,
    /// Offset of the stylus centre: 0 (X) or 1 (Y).
    StylusOffset,
    /// Error motions (component 0 to 2) and rotations (3 to 5) of a linear axis: axis, component.
    LinearAxisErrors,
    /// Initial rates of the drift: 0, 1, 3 (table along X, Y, Z) or 2 (radius of the artefact).
    DriftRate,
    /// Harmonics of the roughness of a cylinder: order, part (0 cosine, 1 sine).
    Roughness,
    /// Deviations of one ball from the stated ball: ball, part (0 to 2 centre, 3 diameter, 4 to 9 oval form).
    BallDeviation,
    /// Deviations of one certified length: length, and 0 (certificate) or 1 (temperature).
    CertifiedLengthError,
    /// Harmonics of a rotary axis: axis, component, order, part.
    RotaryAxisHarmonics,
    /// Phase, 0 to 1, of the PLC scan at which the contact of one touch occurs; same key as `TouchScatter`.
    PlcScanPhase,
    /// Noise of one sample of a displacement sensor: sensor, sample.
    SampleNoise,
    /// Waves of the linearity error: sensor, order, part (0 cosine, 1 sine).
    SensorLinearity,
    /// Deviation of the time of one sample: sensor, sample.
    SampleJitter,
    /// Squareness errors: pair of axes.
    Squareness,
    /// Error from a tilted surface: sensor, part (0 `incidence_um`, 1 and 2 `lean_um`).
    IncidenceError,
    /// Error of one thermometer reading: thermometer, second.
    ThermometerNoise,
    /// Harmonics of a datum cylinder: cross section (the largest number: the face), order, part.
    SectionForm,
    /// Error of one mounting of an artefact: mounting, part.
    MountingError,
    /// Repeatable part of a `[[simulated.rotary_motion]]`: axis, component, number of the order, part.
    SynchronousRotaryMotion,
    /// Part of a `[[simulated.rotary_motion]]` that does not repeat; same key as `SynchronousRotaryMotion`.
    AsynchronousRotaryMotion,
    /// Lost motion of a linear axis: axis.
    Backlash,
    /// Temperature error of the whole artefact.
    ArtefactTemperatureError,
}

/// Standard normal numbers of one source.
pub(super) fn standard_normals(seed: u64, source: RandomSource, key: &[u64]) -> impl Iterator<Item = f64> {
    let key: Vec<u64> = std::iter::once(source as u64).chain(key.iter().copied()).collect();
    StandardNormal.sample_iter(random::seeded_stream(seed, &key))
}

/// One standard normal number.
pub(super) fn draw_normal(seed: u64, source: RandomSource, key: &[u64]) -> f64 {
    standard_normals(seed, source, key).next().unwrap_or_default()
}

/// Phase, 0 to 1, of the PLC scan at which the contact of a touch occurs.
pub(super) fn draw_plc_scan_phase(seed: u64, n_word: u32, occurrence: u32) -> f64 {
    random::seeded_stream(seed, &[RandomSource::PlcScanPhase as u64, u64::from(n_word), u64::from(occurrence)]).random()
}

/// Five waves with two to six periods over the range `span_mm` of a displacement sensor, with a total standard
/// deviation `sigma_um` at every distance. A lower order would be a gain error.
pub(super) fn draw_linearity_waves(seed: u64, sensor_index: usize, sigma_um: f64, span_mm: f64) -> Vec<LinearityWave> {
    const LINEARITY_WAVE_ORDERS: RangeInclusive<u32> = 2..=6;
    if sigma_um == 0.0 {
        return Vec::new();
    }
    let term_sigma = sigma_um / (LINEARITY_WAVE_ORDERS.count() as f64).sqrt();
    let wave = |n: u32| {
        let draw = |part| draw_normal(seed, RandomSource::SensorLinearity, &[sensor_index as u64, n.into(), part]);
        let (cos, sin): (f64, f64) = (draw(0), draw(1));
        let phase_deg = cos.atan2(sin).to_degrees();
        LinearityWave { amplitude_um: term_sigma * cos.hypot(sin), period_mm: span_mm / f64::from(n), phase_deg }
    };
    LINEARITY_WAVE_ORDERS.map(wave).collect()
}

/// True minus stated stylus centre along X and Y, spindle frame, in the unit of `sigma`; Z is 0.
pub(super) fn draw_stylus_offset(seed: u64, sigma: f64) -> Vector3<f64> {
    let draw = |axis| sigma * draw_normal(seed, RandomSource::StylusOffset, &[axis]);
    Vector3::new(draw(0), draw(1), 0.0)
}

/// Harmonics of the form of a round part, whose sum has the standard deviation `sigma_um` at every angle. `key`
/// identifies the part among all parts of the same source.
pub(super) fn draw_form_harmonics(
    seed: u64,
    source: RandomSource,
    key: &[u64],
    orders: RangeInclusive<u32>,
    sigma_um: f64,
) -> Vec<FormHarmonic> {
    if sigma_um == 0.0 {
        return Vec::new();
    }
    let term_sigma = sigma_um / (orders.clone().count() as f64).sqrt();
    let draw = |n, part| term_sigma * draw_normal(seed, source, &[key, &[u64::from(n), part]].concat());
    orders.map(|n| FormHarmonic { n, cos_um: draw(n, 0), sin_um: draw(n, 1) }).collect()
}

/// Oval form of a ball: symmetric and without trace; uᵀ·oval·u has mean 0 and, over all balls, variance 1 for every
/// u.
pub(super) fn draw_ball_oval(seed: u64, ball_index: usize) -> Matrix3<f64> {
    let draw = |part| draw_normal(seed, RandomSource::BallDeviation, &[ball_index as u64, part]);
    // For S with variance 1 on and 1/2 off the diagonal, uᵀSu has variance 1. Subtracting a third of the trace
    // reduces the variance to 2/3.
    let full = Matrix3::from_diagonal(&Vector3::new(draw(4), draw(5), draw(6)))
        + symmetric_off_diagonal([draw(7), draw(8), draw(9)]) * 0.5_f64.sqrt();
    (full - Matrix3::from_diagonal_element(full.trace() / 3.0)) * 1.5_f64.sqrt()
}

fn symmetric_off_diagonal([xy, xz, yz]: [f64; 3]) -> Matrix3<f64> {
    Matrix3::from([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
}

/// Pre-travel of the probe as a function of the direction of the contact normal, spindle frame; positive: the probe
/// triggers after the contact.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ProbeLobing {
    /// (order, cosine, sine) of the azimuth of the contact normal, mm.
    order_and_cos_sin_mm: Vec<(f64, f64, f64)>,
}

impl ProbeLobing {
    /// Draws the declared orders, or 2 to 6 if none is declared. Order 1 would be a stylus offset, order 0 a part of
    /// the ball's radius.
    pub fn draw(seed: u64, sigma_mm: f64, declared_orders: &[u32]) -> Self {
        let orders = if declared_orders.is_empty() { &[2, 3, 4, 5, 6] } else { declared_orders };
        let term_sigma = sigma_mm / (orders.len() as f64).sqrt();
        let draw = |n, part| term_sigma * draw_normal(seed, RandomSource::Lobing, &[u64::from(n), part]);
        Self { order_and_cos_sin_mm: orders.iter().map(|n| (f64::from(*n), draw(*n, 0), draw(*n, 1))).collect() }
    }

    /// Pre-travel, mm, for the unit contact normal in the spindle frame. It falls to zero towards the axis
    /// of the stylus, where the azimuth is undefined.
    pub fn pre_travel_mm(&self, contact_normal: Vector3<f64>) -> f64 {
        let radial_component = contact_normal.x.hypot(contact_normal.y);
        let phi = contact_normal.y.atan2(contact_normal.x);
        let sum: f64 =
            self.order_and_cos_sin_mm.iter().map(|(k, c, s)| c * (k * phi).cos() + s * (k * phi).sin()).sum();
        radial_component * sum
    }
}

/// Slow thermal motion of the table against the spindle, and thermal growth of the artefact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ThermalDrift {
    /// Initial velocity of the table against the spindle, machine frame; it decays with the warm-up.
    initial_table_velocity_mm_per_s: Vector3<f64>,
    /// Initial growth rate of the artefact's radius; it decays with the warm-up.
    initial_artefact_radius_growth_mm_per_s: f64,
}

/// Time constant of the warm-up of the machine, s.
const WARM_UP_TIME_CONSTANT_S: f64 = 7200.0;

/// Share of the change to thermal equilibrium that is complete at `t_s`.
pub(super) fn equilibrium_share(t_s: f64) -> f64 {
    1.0 - (-t_s / WARM_UP_TIME_CONSTANT_S).exp()
}

impl ThermalDrift {
    /// Draws the initial rates; each has the standard deviation `sigma_um_per_h`.
    pub fn draw(seed: u64, sigma_um_per_h: f64) -> Self {
        let sigma = sigma_um_per_h * 1e-3 / 3600.0;
        let draw = |part| sigma * draw_normal(seed, RandomSource::DriftRate, &[part]);
        let table_mm_per_s = Vector3::new(draw(0), draw(1), draw(3));
        Self { initial_table_velocity_mm_per_s: table_mm_per_s, initial_artefact_radius_growth_mm_per_s: draw(2) }
    }

    /// Displacement of the table, machine frame, mm.
    pub fn table_displacement_mm(&self, t_s: f64) -> Vector3<f64> {
        self.initial_table_velocity_mm_per_s * Self::equivalent_time_at_initial_rate_s(t_s)
    }

    /// Growth of the artefact's radius, mm.
    pub fn artefact_radius_growth_mm(&self, t_s: f64) -> f64 {
        self.initial_artefact_radius_growth_mm_per_s * Self::equivalent_time_at_initial_rate_s(t_s)
    }

    /// Time for which the initial rate gives the same change, s: the machine approaches thermal equilibrium.
    fn equivalent_time_at_initial_rate_s(t_s: f64) -> f64 {
        WARM_UP_TIME_CONSTANT_S * equilibrium_share(t_s)
    }
}
