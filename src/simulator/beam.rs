//! The beam of a displacement sensor, and the output of its electronics.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::SimulatedWorldError;
use super::random_draws::{self, RandomSource};
use super::sensor_truth::{LinearityWave, SensorTruth};
use super::sensor_view::{SensorView, SurfaceHit};
use machine::frame::unit_vector;
use machine::record::sensor::Sensor;

/// Output of a sensor for one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SensorOutput {
    /// Distance from the zero point to the surface along the beam, with all errors of the sensor, mm.
    Distance(f64),
    /// No light came back: part of the light spot hits no surface, or the surface is too steep.
    NoEcho,
    /// Output outside of the sensor's measuring range, mm.
    OutOfRange(f64),
    /// Too much light: the surface is nearly perpendicular to the beam (`dazzled_deg`).
    TooMuchLight,
}

/// A sensor with its true position, direction and errors, in the frame of its mount (spindle at S = 0, table, bed).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Beam {
    zero_point_mm: Vector3<f64>,
    /// True direction of the beam, a unit vector.
    direction: Vector3<f64>,
    /// Unit vectors across the nominal direction, for `tilt_urad` and `lean_um`.
    transverse_directions: [Vector3<f64>; 2],
    /// Smallest and largest output in the measuring range, mm.
    range_mm: [f64; 2],
    /// Smallest and largest distance along the beam from the zero point at which the sensor detects a surface, mm.
    detection_range_mm: [f64; 2],
    linearity_waves: Vec<LinearityWave>,
    noise_std_dev_mm: f64,
    truth: SensorTruth,
}

impl Beam {
    /// `sensor_index`: index of the sensor in the machine file; it keys the random draws.
    pub fn new(
        nominal: &Sensor,
        truth: SensorTruth,
        seed: u64,
        sensor_index: usize,
    ) -> Result<Self, SimulatedWorldError> {
        let invalid = |key| Err(SimulatedWorldError::InvalidSensor { name: nominal.name.clone(), key });
        let zero = Vector3::from(nominal.zero_mm);
        let [least, greatest] = nominal.range_mm;
        let span = greatest - least;
        // The conditions below also reject NaN, because every comparison with NaN is false.
        let Some(direction) = unit_vector(Vector3::from(nominal.direction)) else {
            return invalid("direction");
        };
        if !zero.iter().all(|coordinate| coordinate.is_finite()) {
            return invalid("zero_mm");
        }
        if !(span > 0.0 && span.is_finite()) {
            return invalid("range_mm");
        }
        let noise_um = nominal.noise_um.unwrap_or_default();
        if !(noise_um >= 0.0 && nominal.linearity_um >= 0.0 && nominal.incidence_um >= 0.0) {
            return invalid("noise_um, linearity_um or incidence_um");
        }
        truth.check_values()?;
        let truth = with_drawn_incidence(truth, nominal, seed, sensor_index);
        let across = transverse_directions(direction);
        let [lean_1, lean_2] = truth.tilt_urad.map(|urad| urad * 1e-6);
        let drawn = || random_draws::draw_linearity_waves(seed, sensor_index, nominal.linearity_um, span);
        Ok(Self {
            zero_point_mm: zero + Vector3::from(truth.zero_offset_um) * 1e-3,
            direction: (direction + across[0] * lean_1 + across[1] * lean_2).normalize(),
            transverse_directions: across,
            range_mm: nominal.range_mm,
            detection_range_mm: [least.min(-nominal.stand_off_mm), greatest + span],
            linearity_waves: truth.linearity.clone().unwrap_or_else(drawn),
            noise_std_dev_mm: truth.noise_um.or(nominal.noise_um).unwrap_or_default() * 1e-3,
            truth,
        })
    }

    /// Output for one sample. `noise_deviate`: noise in standard deviations.
    pub fn output(&self, view: &SensorView<'_>, noise_deviate: f64) -> SensorOutput {
        let Some(hit) = self.mean_over_spot(view) else { return SensorOutput::NoEcho };
        let cosine = -hit.outward_normal.dot(&self.direction);
        if cosine < self.truth.echo_limit_deg.to_radians().cos() {
            return SensorOutput::NoEcho;
        }
        if cosine > self.truth.dazzled_deg.to_radians().cos() {
            return SensorOutput::TooMuchLight;
        }
        let output_mm = self.truth.gain * hit.distance_from_origin_mm
            + self.linearity_error_mm(hit.distance_from_origin_mm)
            + self.incidence_error_mm(hit.outward_normal, cosine)
            + self.noise_std_dev_mm * noise_deviate;
        let output_mm = self.truth.clips_mm.map_or(output_mm, |[low, high]| output_mm.clamp(low, high));
        let [least, greatest] = self.range_mm;
        let is_in_range = output_mm >= least && output_mm <= greatest;
        if is_in_range { SensorOutput::Distance(output_mm) } else { SensorOutput::OutOfRange(output_mm) }
    }

    /// Mean distance over the light spot, and the surface normal at the centre of the spot. `None`: part of the spot
    /// hits no surface.
    fn mean_over_spot(&self, view: &SensorView<'_>) -> Option<SurfaceHit> {
        let first =
            |from: Vector3<f64>| view.first_hit(self.zero_point_mm + from, self.direction, self.detection_range_mm);
        let middle = first(Vector3::zeros())?;
        if self.truth.spot_mm == 0.0 {
            return Some(middle);
        }
        // The mean over a disc of radius a equals, up to third order, the mean of four points at a/√2 from the centre.
        let aside = self.truth.spot_mm / 8.0_f64.sqrt();
        let mut sum = 0.0;
        for across in self.transverse_directions {
            // Perpendicular to the true beam: the mean over a slanted disc differs.
            let step = across - self.direction * self.direction.dot(&across);
            let step = unit_vector(step).unwrap_or_default() * aside;
            sum += first(step)?.distance_from_origin_mm + first(-step)?.distance_from_origin_mm;
        }
        Some(SurfaceHit { distance_from_origin_mm: sum / 4.0, ..middle })
    }

    /// Deviation of the characteristic curve from a straight line, mm.
    fn linearity_error_mm(&self, distance: f64) -> f64 {
        let wave = |wave: &LinearityWave| {
            let phase = TAU * distance / wave.period_mm + wave.phase_deg.to_radians();
            wave.amplitude_um * 1e-3 * phase.sin()
        };
        self.linearity_waves.iter().map(wave).sum()
    }

    /// Error from a surface that is not perpendicular to the beam, mm.
    fn incidence_error_mm(&self, normal: Vector3<f64>, cosine: f64) -> f64 {
        let tangent2 = (1.0 - cosine * cosine).max(0.0) / (cosine * cosine);
        // Slope of the distance along each direction across the beam.
        let slopes = self.transverse_directions.map(|across| normal.dot(&across) / cosine);
        let lean: f64 = slopes.iter().zip(self.truth.lean_um).map(|(slope, um)| slope * um).sum();
        (self.truth.incidence_um * tangent2 + lean) * 1e-3
    }
}

/// Draws the declared incidence errors if the truth states neither `incidence_um` nor `lean_um`.
fn with_drawn_incidence(truth: SensorTruth, nominal: &Sensor, seed: u64, sensor_index: usize) -> SensorTruth {
    if truth.incidence_um != 0.0 || truth.lean_um != [0.0; 2] {
        return truth;
    }
    let key = |part| [sensor_index as u64, part];
    let draw = |part| nominal.incidence_um * random_draws::draw_normal(seed, RandomSource::IncidenceError, &key(part));
    SensorTruth { incidence_um: draw(0), lean_um: [draw(1), draw(2)], ..truth }
}

/// Unit vectors perpendicular to `direction`: projections of the two coordinate axes that are least parallel to it.
fn transverse_directions(direction: Vector3<f64>) -> [Vector3<f64>; 2] {
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
