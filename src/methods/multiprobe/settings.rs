//! Settings of the method, the table `[method.multiprobe]` of the machine file.

use estimation::revolutions::{AngleRange, ResampleFilter};
use serde::{Deserialize, Serialize};

use crate::MethodRefusal;
use machine::Position;

/// Sampling mode during a turn of the table.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TurnSampling {
    /// The table stops at each of `positions` angles.
    #[default]
    Dwell,
    /// The table turns without a stop. The control stamps positions, or the samples contain the count of an
    /// encoder.
    Continuous,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MultiprobeSettings {
    /// Names of the sensors. Empty: all sensors of the machine file.
    pub sensors: Vec<String>,
    /// Positions of the linear axes during the measurement, machine coordinates, mm; also of rotary axes other than
    /// the measured one, which are otherwise at 0°. All linear axes are required.
    #[serde(rename = "at")]
    pub linear_axis_positions: Position,
    /// Number of mountings of the artefact in equal steps of 360°/N. 1: the artefact is not indexed.
    pub indexes: usize,
    /// Revolutions in each direction at one mounting.
    pub revolutions: usize,
    /// Whether each turn is repeated backward, with as many revolutions.
    pub both_directions: bool,
    /// Number of equal angles per revolution: stops, or results of the resampling.
    pub positions: usize,
    /// Highest harmonic of the error motions and of the form of the artefact.
    pub harmonics: usize,
    pub sampling: TurnSampling,
    /// Dwell time at a stop before its samples, s.
    pub dwell_s: f64,
    /// Number of samples of each sensor at a stop.
    pub samples: u32,
    /// Minimum number of samples per second from each sensor in a continuous turn. Additional samples are used too.
    pub rate_hz: f64,
    /// Feed, degrees per minute.
    pub feed_deg_min: f64,
    /// Centring ends when each section is at most this far from the axis, µm.
    pub eccentricity_limit_um: f64,
    /// Ranges of angles, counter-clockwise seen from +Z, in which no sensor can be mounted: they are not suggested as
    /// sensor positions. All readings are evaluated.
    #[serde(rename = "excluded_deg")]
    pub obstructed_ranges_deg: Vec<[f64; 2]>,
    /// Standard uncertainty of the gain of a sensor, relative (1 = 100 %).
    pub u_gain: f64,
    /// Standard uncertainty of the declared angle of a sensor.
    pub u_sensor_angle_deg: f64,
    /// Standard uncertainty of the declared distance between the two sections.
    pub u_section_distance_mm: f64,
    /// Standard uncertainty of the radius on the face at which the axial sensors measure.
    pub u_face_radius_mm: f64,
    /// Standard uncertainty of the angle of one mounting relative to the first one.
    pub u_index_angle_deg: f64,
    /// Number of Monte Carlo trials. 0: adaptive as in JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for MultiprobeSettings {
    fn default() -> Self {
        Self {
            sensors: Vec::new(),
            linear_axis_positions: Position::new(),
            indexes: 10,
            revolutions: 2,
            both_directions: true,
            positions: 90,
            harmonics: 20,
            sampling: TurnSampling::Dwell,
            dwell_s: 0.3,
            samples: 4,
            rate_hz: 1000.0,
            feed_deg_min: 1080.0,
            eccentricity_limit_um: 20.0,
            obstructed_ranges_deg: Vec::new(),
            u_gain: 1e-3,
            u_sensor_angle_deg: 0.1,
            u_section_distance_mm: 0.05,
            u_face_radius_mm: 0.1,
            u_index_angle_deg: 0.02,
            monte_carlo_trials: 0,
        }
    }
}

/// Upper bound of the setting `indexes`. Larger values are refused: they would need a day, and more memory than the
/// computer has. The same applies to the two bounds below.
const MAX_MOUNTING_ANGLES: usize = 72;
/// Upper bound of the setting `revolutions`.
const MAX_REVOLUTIONS: usize = 100;
/// Upper bound of the setting `positions`.
const MAX_POSITIONS_PER_REVOLUTION: usize = 3600;

impl MultiprobeSettings {
    /// # Errors
    /// The numbers do not describe a possible measurement.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        let (positions, harmonics) = (self.positions, self.harmonics);
        MethodRefusal::require(
            harmonics > 0 && self.highest_determined_harmonic() >= harmonics,
            format!("{positions} positions per revolution do not determine {harmonics} harmonics"),
            format!("choose positions = {}, or fewer harmonics", (9 * harmonics.max(1)).div_ceil(2)),
        )?;
        MethodRefusal::require(
            (1..=MAX_MOUNTING_ANGLES).contains(&self.indexes)
                && (1..=MAX_REVOLUTIONS).contains(&self.revolutions)
                && positions <= MAX_POSITIONS_PER_REVOLUTION,
            "indexes, revolutions or positions are outside their limits",
            format!(
                "choose 1 to {MAX_MOUNTING_ANGLES} indexes, 1 to {MAX_REVOLUTIONS} revolutions, at most \
                 {MAX_POSITIONS_PER_REVOLUTION} positions"
            ),
        )?;
        MethodRefusal::check_number_ranges(
            &[
                ("feed_deg_min", self.feed_deg_min),
                ("rate_hz", self.rate_hz),
                ("eccentricity_limit_um", self.eccentricity_limit_um),
                ("samples", self.samples.into()),
            ],
            &[
                ("dwell_s", self.dwell_s),
                ("u_gain", self.u_gain),
                ("u_sensor_angle_deg", self.u_sensor_angle_deg),
                ("u_section_distance_mm", self.u_section_distance_mm),
                ("u_face_radius_mm", self.u_face_radius_mm),
                ("u_index_angle_deg", self.u_index_angle_deg),
            ],
        )?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)?;
        MethodRefusal::require(
            self.revolutions > 1 || self.both_directions,
            "one revolution has no scatter, so the uncertainty cannot be estimated",
            "choose revolutions = 2, or both_directions = true",
        )?;
        self.check_sample_spacing()
    }

    pub fn obstructed_ranges(&self) -> Vec<AngleRange> {
        let range = |[from_deg, to_deg]: &[f64; 2]| AngleRange { from_deg: *from_deg, to_deg: *to_deg };
        self.obstructed_ranges_deg.iter().map(range).collect()
    }

    /// Highest harmonic that the positions of one revolution determine; for a continuous turn the highest that the
    /// resampling filter passes.
    fn highest_determined_harmonic(&self) -> usize {
        match self.sampling {
            TurnSampling::Dwell => self.positions.saturating_sub(1) / 2,
            TurnSampling::Continuous => ResampleFilter::new(self.positions).max_passed_harmonic(),
        }
    }

    /// Checks that the samples of a continuous turn are at most half as far apart as the angles to which they are
    /// resampled.
    fn check_sample_spacing(&self) -> Result<(), MethodRefusal> {
        let spacing_deg = self.feed_deg_min / 60.0 / self.rate_hz;
        let step_deg = 360.0 / self.positions.max(1) as f64;
        MethodRefusal::require(
            self.sampling == TurnSampling::Dwell || spacing_deg <= step_deg / 2.0,
            format!(
                "the samples are {spacing_deg:.2}° apart, more than half of the {step_deg:.2}° \
                     between positions"
            ),
            format!("choose feed_deg_min = {:.0} or less", step_deg * self.rate_hz * 30.0),
        )
    }

    pub fn u_sensor_angle_rad(&self) -> f64 {
        self.u_sensor_angle_deg.to_radians()
    }
}
