//! Settings of the method, the table `[method.laser-r-test]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;

/// Device that measures the sphere.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MeasuringDevice {
    /// A displacement sensor in the spindle (paper 2).
    #[default]
    Laser,
    /// The touch probe: chase-the-ball.
    Probe,
}

/// Sampling mode of the sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SamplingMode {
    /// At standstill, point by point.
    #[default]
    Dwell,
    /// In motion. The control must stamp positions. The search and the references still use dwell points.
    Continuous,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LaserRTestSettings {
    pub by: MeasuringDevice,
    /// Name of the sensor. Empty: the first one in the spindle.
    pub sensor: String,
    /// Id of the sphere. Empty: the first one of the artefact.
    pub ball: String,
    /// Machine errors to identify, by ISO names. Empty: all location errors of the table's rotary axes that one
    /// sphere separates.
    pub parameters: Vec<String>,
    /// Orders of the harmonics of the tilting axis' error motions to be identified as well, e.g. `[2]`.
    pub harmonics: Vec<u32>,
    /// Commanded positions of the rotary axis that tilts the table. Empty: -90 to 90 in steps of 30, limited to the
    /// axis' limits.
    pub tilt_deg: Vec<f64>,
    /// Commanded positions of the rotary axis that turns the table. Empty: 0 to 300 in steps of 60, limited to the
    /// axis' limits.
    pub turn_deg: Vec<f64>,
    /// Readings at the sphere's pole for the measurement of the beam's direction, three or more. Empty: the middle
    /// of the sensor's range and 0.7 of half the range to either side.
    pub heights_mm: Vec<f64>,
    pub sampling: SamplingMode,
    /// Dwell points on each of the two lines of a cross. For a continuous scan, number of cells over the longest
    /// side of the scan.
    pub points: usize,
    /// Largest distance of the sphere from its expected position after the search, mm.
    #[serde(rename = "margin_mm")]
    pub max_position_error_mm: f64,
    /// Feed of the scans.
    pub feed_mm_min: f64,
    /// Second feed of the continuous scans that determine the sensor's latency, at least 1.5 times `feed_mm_min`.
    pub fast_feed_mm_min: f64,
    /// Samples per second of a continuous scan. If the sensor is faster, some of its samples are skipped.
    pub rate_hz: f64,
    /// Dwell time at a point before its first sample.
    pub dwell_s: f64,
    /// Number of samples at each dwell point.
    pub samples: u32,
    /// Standard uncertainty of the sphere's stated radius, µm.
    pub radius_u_um: f64,
    /// Standard deviation of the sphere's form about its mean sphere, along any direction.
    pub form_u_um: f64,
    /// Limit of largest minus smallest residual of one pose group, µm, above which a warning is issued.
    pub form_limit_um: f64,
    /// Number of Monte Carlo trials. 0: adaptive as in JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for LaserRTestSettings {
    fn default() -> Self {
        Self {
            by: MeasuringDevice::Laser,
            sensor: String::new(),
            ball: String::new(),
            parameters: Vec::new(),
            harmonics: Vec::new(),
            tilt_deg: Vec::new(),
            turn_deg: Vec::new(),
            heights_mm: Vec::new(),
            sampling: SamplingMode::Dwell,
            points: 13,
            max_position_error_mm: 0.8,
            feed_mm_min: 600.0,
            fast_feed_mm_min: 1800.0,
            rate_hz: 1000.0,
            dwell_s: 0.1,
            samples: 20,
            radius_u_um: 0.5,
            form_u_um: 0.0,
            form_limit_um: 10.0,
            monte_carlo_trials: 0,
        }
    }
}

/// Minimum ratio of the second to the first feed of continuous scans. A smaller ratio is refused.
const MIN_FEED_RATIO: f64 = 1.5;
/// Readings at the pole that differ by at most this distance count as one height, mm.
pub const SAME_HEIGHT_TOLERANCE_MM: f64 = 0.5;

/// Upper bound of `samples`, which detects a wrong digit in the machine file.
const MAX_SAMPLES_PER_POINT: u32 = 10_000;
/// Upper bound of `dwell_s`, which detects a wrong digit or unit in the machine file.
const MAX_DWELL_S: f64 = 60.0;
/// Highest harmonic order. No set of poses determines higher ones.
const MAX_HARMONIC_ORDER: u32 = 36;

impl LaserRTestSettings {
    /// Rejects settings that would fail during the run.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::require(
            (3..=1000).contains(&self.points),
            format!("points = {} is outside 3 to 1000", self.points),
            "choose points = 13 (3 to 1000)",
        )?;
        MethodRefusal::require(
            is_positive_and_finite(self.max_position_error_mm)
                && is_positive_and_finite(self.feed_mm_min)
                && self.samples > 0,
            "margin_mm, feed_mm_min and samples must be greater than 0",
            "omit them, or choose about 0.8, 600 and 20",
        )?;
        self.check_continuous_sampling_settings()?;
        MethodRefusal::require(
            self.samples <= MAX_SAMPLES_PER_POINT,
            format!("samples = {} is more than {MAX_SAMPLES_PER_POINT} per dwell point", self.samples),
            "choose samples = 20: during a longer dwell the machine drifts",
        )?;
        MethodRefusal::require(
            (0.0..=MAX_DWELL_S).contains(&self.dwell_s) && self.radius_u_um >= 0.0 && self.form_u_um >= 0.0,
            format!("dwell_s must be 0 to {MAX_DWELL_S}; radius_u_um and form_u_um must be 0 or more"),
            "omit them, or choose about 0.1 and 0.5",
        )?;
        self.check_harmonic_range_and_repeats()?;
        MethodRefusal::require(
            is_positive_and_finite(self.form_limit_um),
            "form_limit_um must be greater than 0",
            "omit it, or choose about 10",
        )?;
        self.check_none_or_at_least_three_heights()?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)
    }

    fn check_none_or_at_least_three_heights(&self) -> Result<(), MethodRefusal> {
        let count = count_different_heights(&self.heights_mm);
        MethodRefusal::require(
            self.heights_mm.is_empty() || count >= 3,
            format!("heights_mm has {count} different heights; the beam direction needs three"),
            "state three or more heights, well apart within the sensor's range, or omit heights_mm",
        )
    }

    fn check_continuous_sampling_settings(&self) -> Result<(), MethodRefusal> {
        if self.sampling == SamplingMode::Dwell {
            return Ok(());
        }
        MethodRefusal::require(
            self.by == MeasuringDevice::Laser,
            "sampling = \"continuous\" is not possible with a touch probe",
            "omit sampling, or set by = \"laser\"",
        )?;
        MethodRefusal::require(
            is_positive_and_finite(self.rate_hz),
            format!("rate_hz = {} is not a positive number", self.rate_hz),
            "omit it, or choose the sample rate of the sensor, about 1000",
        )?;
        let (feed, fast) = (self.feed_mm_min, self.fast_feed_mm_min);
        MethodRefusal::require(
            fast.is_finite() && fast >= MIN_FEED_RATIO * feed,
            format!(
                "fast_feed_mm_min is {fast}, feed_mm_min is {feed}: feeds with a ratio below {MIN_FEED_RATIO} do not \
                 separate the latency of the sensor from the lost motion of the axes at reversals"
            ),
            "choose fast_feed_mm_min about three times feed_mm_min",
        )
    }

    fn check_harmonic_range_and_repeats(&self) -> Result<(), MethodRefusal> {
        for order in &self.harmonics {
            MethodRefusal::require(
                (1..=MAX_HARMONIC_ORDER).contains(order),
                format!("harmonics contains order {order}; allowed are 1 to {MAX_HARMONIC_ORDER}"),
                "choose orders that the positions of tilt_deg separate, e.g. harmonics = [2]",
            )?;
        }
        let repeated = self.harmonics.iter().enumerate().find(|(i, order)| self.harmonics[..*i].contains(order));
        repeated.map_or(Ok(()), |(_, order)| {
            Err(MethodRefusal::new(format!("harmonics contains order {order} twice"), "list each order once"))
        })
    }
}

fn is_positive_and_finite(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

/// Number of different heights among these readings at the pole.
pub fn count_different_heights(pole_readings_mm: &[f64]) -> usize {
    let mut heights: Vec<f64> = pole_readings_mm.iter().copied().filter(|pole| pole.is_finite()).collect();
    heights.sort_by(f64::total_cmp);
    heights.dedup_by(|higher, kept| *higher - *kept <= SAME_HEIGHT_TOLERANCE_MM);
    heights.len()
}
