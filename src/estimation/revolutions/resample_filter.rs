//! Antialiasing low-pass filter over the angle: a sinc with cutoff at half the output rate, bounded by a Kaiser
//! window.

use std::f64::consts::PI;
use std::fmt;

/// Half width of the kernel in output steps. It is also the run-in before the first revolution and the run-out
/// after the last.
pub const KERNEL_HALF_WIDTH_OUTPUT_STEPS: usize = 6;
/// Shape of the Kaiser window: −100 dB above [`ResampleFilter::min_suppressed_harmonic`] (Kaiser's formula β =
/// 0.1102·(A − 8.7)).
const KAISER_BETA: f64 = 10.06;
/// Half of the transition band relative to the output rate: (A −
/// 8)/(2.285·2π)/(2·2·[`KERNEL_HALF_WIDTH_OUTPUT_STEPS`]).
const HALF_TRANSITION_BAND_PER_OUTPUT_RATE: f64 = 0.267;
/// Kernel values per output step. Linear interpolation between them is exact to 1e-7.
const KERNEL_VALUES_PER_STEP: usize = 2048;

/// Antialiasing low-pass filter of samples that are resampled to equal angles of a revolution. Orders are in
/// undulations per revolution.
#[derive(Debug, Clone)]
pub struct ResampleFilter {
    steps_per_revolution: usize,
    /// Kernel from its centre outwards on one side, [`KERNEL_VALUES_PER_STEP`] values per output step.
    kernel_values: Vec<f64>,
}

impl fmt::Display for ResampleFilter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "samples are resampled to {} equal angles: orders up to {} pass, {} is halved, those from {} on are \
             suppressed by 100 dB",
            self.steps_per_revolution,
            self.max_passed_harmonic(),
            self.cutoff_harmonic(),
            self.min_suppressed_harmonic()
        )
    }
}

impl ResampleFilter {
    /// Filter of a revolution with `steps` output angles.
    pub fn new(steps: usize) -> Self {
        let half = KERNEL_HALF_WIDTH_OUTPUT_STEPS as f64;
        let value = |i: usize| {
            let u = i as f64 / KERNEL_VALUES_PER_STEP as f64;
            let sinc = if i == 0 { 1.0 } else { (PI * u).sin() / (PI * u) };
            let inside = (1.0 - (u / half).powi(2)).max(0.0).sqrt();
            sinc * bessel_i0(KAISER_BETA * inside) / bessel_i0(KAISER_BETA)
        };
        Self {
            steps_per_revolution: steps,
            kernel_values: (0..=KERNEL_HALF_WIDTH_OUTPUT_STEPS * KERNEL_VALUES_PER_STEP + 1).map(value).collect(),
        }
    }

    pub fn steps_per_revolution(&self) -> usize {
        self.steps_per_revolution
    }

    /// Highest order that passes unchanged to 1e-5.
    pub fn max_passed_harmonic(&self) -> usize {
        ((0.5 - HALF_TRANSITION_BAND_PER_OUTPUT_RATE) * self.steps_per_revolution as f64) as usize
    }

    /// Order of the −6 dB attenuation.
    pub fn cutoff_harmonic(&self) -> usize {
        self.steps_per_revolution / 2
    }

    /// Lowest order that is suppressed by 100 dB. Only orders from `steps_per_revolution` − k on alias into the
    /// harmonic k, so no order aliases into a harmonic up to [`max_passed_harmonic`](Self::max_passed_harmonic).
    pub fn min_suppressed_harmonic(&self) -> usize {
        ((0.5 + HALF_TRANSITION_BAND_PER_OUTPUT_RATE) * self.steps_per_revolution as f64).ceil() as usize
    }

    /// Value of the filter kernel, 1 at its centre, at a distance of `u` output steps.
    pub fn kernel_value(&self, u: f64) -> f64 {
        let position = u.abs() * KERNEL_VALUES_PER_STEP as f64;
        let i = position as usize;
        match (self.kernel_values.get(i), self.kernel_values.get(i + 1)) {
            (Some(low), Some(high)) => low + (high - low) * (position - i as f64),
            _ => 0.0,
        }
    }
}

/// Modified Bessel function of order zero (Abramowitz & Stegun 9.6.12).
fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let (mut term, mut sum, mut n) = (1.0, 1.0, 1.0);
    while term > 1e-17 * sum {
        term *= quarter / (n * n);
        sum += term;
        n += 1.0;
    }
    sum
}
