//! Gains and angles of sensors from the scanned revolutions: the eccentricity of the part, which differs between
//! mountings, is the same for all radial sensors of a cross section. The declared values of the sensors are additional
//! observations. Therefore the mean gain and the mean angle of a section keep their declared values, and so do all
//! values of a sensor that is not radial.
//!
//! First harmonic of the deviation that sensor i measures at mounting n while the part turns by σq:
//! M = (1 + ε_i)·(P·e^(iσ(γ_i + δ_i)) + E_n·e^(−iσ(γ_i + δ_i))), where P is the error motion that turns against the
//! part, and E_n is the eccentricity with all other motion that turns with the part. Both belong to the section.

use std::collections::BTreeSet;

use faer::{Mat, c64};

use super::harmonics::HarmonicData;
use crate::linear_least_squares::{self, LinearError, LinearProblem, RANK_THRESHOLD};

/// Gauss–Newton iterations. The deviations are small, so the second iteration is exact to their square.
const ITERATION_COUNT: usize = 6;

/// Minimum standard uncertainty of a declared gain or angle in the fit; replaces smaller declared values.
const GAIN_AND_ANGLE_STD_U_FLOOR: f64 = 1e-12;

/// Declared properties of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeclaredSensor {
    /// Cross section that a radial sensor measures, from 0. `None`: the sensor is not radial.
    pub radial_cross_section_index: Option<usize>,
    /// γ, the angle of the sensor, counter-clockwise, rad.
    pub angle_rad: f64,
    /// Standard uncertainty of the gain, relative.
    pub u_gain: f64,
    /// Standard uncertainty of the angle, rad.
    pub u_angle_rad: f64,
}

/// Deviations of the sensors from their declared gains and angles.
#[derive(Debug, Clone)]
pub struct SensorCalibration {
    /// ε_i of all sensors (dividing a reading by 1 + ε_i corrects the reading), then δ_i of all sensors, true less
    /// declared angle, rad; both are 0 for a sensor that is not radial.
    pub gain_then_angle_deviations: Vec<f64>,
    /// Covariance of `gain_then_angle_deviations`, in the same order.
    pub covariance: Mat<f64>,
}

/// Estimates the deviations of all channels of `data` from the first harmonic. `turn_sign`: σ, +1 if the part
/// turns counter-clockwise while the angle of `data` grows, otherwise −1.
///
/// # Errors
/// The rows do not determine the error motion P and the eccentricities E_n of the cross sections, for example because
/// one of them has only one sensor.
pub fn calibrate_sensors(
    data: &HarmonicData,
    sensors: &[DeclaredSensor],
    turn_sign: f64,
) -> Result<SensorCalibration, LinearError> {
    let cross_section = |row: usize| sensors[data.row_keys[row].channel_index].radial_cross_section_index;
    let rows: Vec<usize> = (0..data.row_keys.len()).filter(|row| cross_section(*row).is_some()).collect();
    let mut mountings: Vec<MountingKey> =
        rows.iter().map(|row| (cross_section(*row), data.row_keys[*row].mounting_index)).collect();
    mountings.sort_unstable();
    mountings.dedup();
    let sections: BTreeSet<Option<usize>> = mountings.iter().map(|(section, _)| *section).collect();
    let sections = sections.into_iter().collect();
    CalibrationEquations { data, sensors, turn_sign, data_rows: rows, cross_section_indices: sections, mountings }
        .solve()
}

/// Cross section, and number of the mounting of the artefact, from 0.
type MountingKey = (Option<usize>, usize);

/// Unknowns in order: gains, angles, P of each cross section, then E_n. A complex unknown is its real and
/// imaginary part.
struct CalibrationEquations<'a> {
    data: &'a HarmonicData,
    sensors: &'a [DeclaredSensor],
    turn_sign: f64,
    /// Indices of the rows of `data` from radial sensors.
    data_rows: Vec<usize>,
    /// Cross sections with radial sensors, ascending.
    cross_section_indices: Vec<Option<usize>>,
    /// Pairs of cross section and mounting with rows of radial sensors, ascending.
    mountings: Vec<MountingKey>,
}

impl CalibrationEquations<'_> {
    fn unknown_count(&self) -> usize {
        2 * (self.sensors.len() + self.cross_section_indices.len() + self.mountings.len())
    }

    fn solve(&self) -> Result<SensorCalibration, LinearError> {
        let gains = self.sensors.iter().map(|sensor| sensor.u_gain);
        let angles = self.sensors.iter().map(|sensor| sensor.u_angle_rad);
        let declared: Vec<f64> = gains.chain(angles).map(|u| u.max(GAIN_AND_ANGLE_STD_U_FLOOR)).collect();
        let (own, observations) = (declared.len(), 2 * self.data_rows.len());
        let free = (observations + own).saturating_sub(self.unknown_count()).max(1);
        let sigma_mm = self.data.observation_std_u_mm(1);
        let (mut x, mut covariance) = (vec![0.0; self.unknown_count()], Mat::zeros(own, own));
        for iteration in 0..ITERATION_COUNT {
            let (mut a, mut y) = self.derivatives_and_residuals_at(&x);
            let mut sigma: Vec<f64> = self.data_rows.iter().flat_map(|row| [sigma_mm[*row]; 2]).collect();
            if iteration > 1 {
                // The motion differs slightly between mountings.
                let squares = y.iter().zip(&sigma).map(|(y, sigma)| (y / sigma).powi(2));
                let scatter = (squares.sum::<f64>() / free as f64).sqrt().max(1.0);
                sigma.iter_mut().for_each(|sigma| *sigma *= scatter);
            }
            a.resize_with(observations + own, self.unknown_count(), |i, j| f64::from(u8::from(i == observations + j)));
            y.extend(x[..own].iter().map(|deviation| -deviation));
            sigma.extend(&declared);
            let (a, constraints, rank_threshold) = (a.as_ref(), None, RANK_THRESHOLD);
            let problem = LinearProblem { a, y: &y, sigma: &sigma, constraints, rank_threshold };
            let solution = linear_least_squares::solve_least_squares(&problem)?;
            x.iter_mut().zip(&solution.x).for_each(|(x, step)| *x += step);
            covariance = solution.covariance.submatrix(0, 0, own, own).to_owned();
        }
        x.truncate(own);
        Ok(SensorCalibration { gain_then_angle_deviations: x, covariance })
    }

    /// Derivatives and residuals of the data rows at the unknowns `x`; each data row gives a real and an imaginary row.
    fn derivatives_and_residuals_at(&self, x: &[f64]) -> (Mat<f64>, Vec<f64>) {
        let count = self.sensors.len();
        let complex = |first: usize| c64::new(x[first], x[first + 1]);
        let mut a = Mat::zeros(2 * self.data_rows.len(), self.unknown_count());
        let mut y = Vec::new();
        for (number, row) in self.data_rows.iter().enumerate() {
            let key = self.data.row_keys[*row];
            let (sensor, section) = (key.channel_index, self.sensors[key.channel_index].radial_cross_section_index);
            let motion = self.cross_section_indices.iter().position(|s| *s == section).unwrap_or(0);
            let mounting = self.mountings.iter().position(|m| *m == (section, key.mounting_index));
            let against = 2 * (count + motion);
            let with = 2 * (count + self.cross_section_indices.len() + mounting.unwrap_or(0));
            let gain = 1.0 + x[sensor];
            let angle = self.sensors[sensor].angle_rad + x[count + sensor];
            let turned = c64::cis(self.turn_sign * angle);
            let [p, e] = [complex(against) * turned, complex(with) * turned.conj()];
            let by_angle = c64::new(0.0, self.turn_sign * gain) * (p - e);
            let (by_p, by_e) = (turned * gain, turned.conj() * gain);
            let i = c64::new(0.0, 1.0);
            let derivatives = [
                (sensor, p + e),
                (count + sensor, by_angle),
                (against, by_p),
                (against + 1, i * by_p),
                (with, by_e),
                (with + 1, i * by_e),
            ];
            for (unknown, derivative) in derivatives {
                a[(2 * number, unknown)] = derivative.re;
                a[(2 * number + 1, unknown)] = derivative.im;
            }
            let residual = self.data.harmonic_means[0][*row] - (p + e) * gain;
            y.extend([residual.re, residual.im]);
        }
        (a, y)
    }
}
