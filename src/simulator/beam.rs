//! The beam of a displacement sensor, and the output of its electronics.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::WorldError;
use super::drawn;
use super::sensor_truth::{SensorTruth, Wave};
use super::sensor_view::{Hit, SensorView};
use machine::frame::unit_vector;
use machine::record::sensor::Sensor;

/// Output of a sensor for one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sensed {
    /// Distance from the zero point to the surface, mm.
    Distance(f64),
    /// No light came back: there is no surface, or it is too steep.
    NoEcho,
    /// A distance outside of its range, mm.
    OutOfRange(f64),
    /// Too much light.
    Saturated,
}

/// A sensor as it is truly mounted in the spindle, at S = 0, in the directions of the machine frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Beam {
    zero: Vector3<f64>,
    along: Vector3<f64>,
    /// Unit vectors across the nominal direction, for `tilt_urad` and `lean_um`.
    across: [Vector3<f64>; 2],
    range: [f64; 2],
    /// Smallest and largest distance at which the sensor detects a surface, mm.
    reach: [f64; 2],
    curve: Vec<Wave>,
    noise_mm: f64,
    truth: SensorTruth,
}

impl Beam {
    /// `number`: index of the sensor in the machine file; it keys the random draws.
    pub fn new(
        nominal: &Sensor,
        truth: SensorTruth,
        seed: u64,
        number: usize,
    ) -> Result<Self, WorldError> {
        let nonsense = |key| Err(WorldError::Sensor { name: nominal.name.clone(), key });
        let zero = Vector3::from(nominal.zero_mm);
        let [least, greatest] = nominal.range_mm;
        let span = greatest - least;
        // `>` is false for NaN as well.
        let Some(direction) = unit_vector(Vector3::from(nominal.direction)) else {
            return nonsense("direction");
        };
        if !zero.iter().all(|place| place.is_finite()) {
            return nonsense("zero_mm");
        }
        if !(span > 0.0 && span.is_finite()) {
            return nonsense("range_mm");
        }
        let noise_um = nominal.noise_um.unwrap_or_default();
        if !(noise_um >= 0.0 && nominal.linearity_um >= 0.0 && nominal.incidence_um >= 0.0) {
            return nonsense("noise_um, linearity_um or incidence_um");
        }
        truth.check()?;
        let truth = slanting(truth, nominal, seed, number);
        let across = across(direction);
        let [lean_1, lean_2] = truth.tilt_urad.map(|urad| urad * 1e-6);
        let drawn = || drawn::linearity(seed, number, nominal.linearity_um, span);
        Ok(Self {
            zero: zero + Vector3::from(truth.zero_offset_um) * 1e-3,
            along: (direction + across[0] * lean_1 + across[1] * lean_2).normalize(),
            across,
            range: nominal.range_mm,
            reach: [least.min(-nominal.stand_off_mm), greatest + span],
            curve: truth.linearity.clone().unwrap_or_else(drawn),
            noise_mm: truth.noise_um.or(nominal.noise_um).unwrap_or_default() * 1e-3,
            truth,
        })
    }

    /// Output for one sample. `deviate`: noise in standard deviations.
    pub fn says(&self, sight: &SensorView<'_>, deviate: f64) -> Sensed {
        let Some(hit) = self.spot(sight) else { return Sensed::NoEcho };
        let facing = -hit.normal.dot(&self.along);
        if facing < self.truth.echo_limit_deg.to_radians().cos() {
            return Sensed::NoEcho;
        }
        if facing > self.truth.dazzled_deg.to_radians().cos() {
            return Sensed::Saturated;
        }
        let said = self.truth.gain * hit.distance
            + self.curve_at(hit.distance)
            + self.slanted(hit.normal, facing)
            + self.noise_mm * deviate;
        let said = self.truth.clips_mm.map_or(said, |[low, high]| said.clamp(low, high));
        let [least, greatest] = self.range;
        let within = said >= least && said <= greatest;
        if within { Sensed::Distance(said) } else { Sensed::OutOfRange(said) }
    }

    /// Mean distance over the light spot, and the surface normal at the centre of the spot.
    fn spot(&self, sight: &SensorView<'_>) -> Option<Hit> {
        let first = |from: Vector3<f64>| sight.first(self.zero + from, self.along, self.reach);
        let middle = first(Vector3::zeros())?;
        if self.truth.spot_mm == 0.0 {
            return Some(middle);
        }
        // The mean over a disc of radius a is, up to third order, that of four points a/√2 away.
        let aside = self.truth.spot_mm / 8.0_f64.sqrt();
        let mut sum = 0.0;
        for across in self.across {
            // Perpendicular to the true beam: the mean over a slanted disc differs.
            let step = across - self.along * self.along.dot(&across);
            let step = unit_vector(step).unwrap_or_default() * aside;
            sum += first(step)?.distance + first(-step)?.distance;
        }
        Some(Hit { distance: sum / 4.0, ..middle })
    }

    /// Deviation of the characteristic curve from a straight line, mm.
    fn curve_at(&self, distance: f64) -> f64 {
        let wave = |wave: &Wave| {
            let phase = TAU * distance / wave.period_mm + wave.phase_deg.to_radians();
            wave.amplitude_um * 1e-3 * phase.sin()
        };
        self.curve.iter().map(wave).sum()
    }

    /// Error from a surface that is not perpendicular to the beam, mm.
    fn slanted(&self, normal: Vector3<f64>, facing: f64) -> f64 {
        let tangent2 = (1.0 - facing * facing).max(0.0) / (facing * facing);
        // Slope of the distance along each direction across the beam.
        let slopes = self.across.map(|across| normal.dot(&across) / facing);
        let lean: f64 = slopes.iter().zip(self.truth.lean_um).map(|(slope, um)| slope * um).sum();
        (self.truth.incidence_um * tangent2 + lean) * 1e-3
    }
}

/// Draws the declared incidence errors, unless the truth states values.
fn slanting(truth: SensorTruth, nominal: &Sensor, seed: u64, number: usize) -> SensorTruth {
    if truth.incidence_um != 0.0 || truth.lean_um != [0.0; 2] {
        return truth;
    }
    let (incidence_um, lean_um) = drawn::incidence(seed, number, nominal.incidence_um);
    SensorTruth { incidence_um, lean_um, ..truth }
}

/// Unit vectors across `direction`, near the two axes that are not nearest to it.
fn across(direction: Vector3<f64>) -> [Vector3<f64>; 2] {
    let size = direction.abs();
    let [first, second] = if size.z >= size.x && size.z >= size.y {
        [Vector3::x(), Vector3::y()]
    } else if size.y >= size.x {
        [Vector3::x(), Vector3::z()]
    } else {
        [Vector3::y(), Vector3::z()]
    };
    [first, second].map(|axis| (axis - direction * direction.dot(&axis)).normalize())
}
