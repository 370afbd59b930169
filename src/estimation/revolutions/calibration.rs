//! Gains and angles of radial sensors from the turns themselves: the eccentricity of the part, another one at each
//! mounting, passes all sensors of a section alike. What is declared of them is an observation of its own, so the mean
//! gain and the mean angle stay as declared.
//!
//! First harmonic of the deviation that sensor i shows at mounting n, the part turning by σq:
//! M = (1 + ε_i)·(P·e^(iσ(γ_i + δ_i)) + E_n·e^(−iσ(γ_i + δ_i))), P the error motion that turns against the part, E_n the
//! eccentricity with all else that turns with it.

use faer::{Mat, c64};

use super::harmonics::HarmonicData;
use crate::linear::{self, LinearProblem, RANK_THRESHOLD};

/// Gauss–Newton: the deviations are small, and the second iteration is exact to their square.
const ITERATIONS: usize = 6;

/// A sensor of one section as declared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadialSensor {
    pub channel: usize,
    /// γ, counter-clockwise, rad.
    pub angle_rad: f64,
    /// Standard uncertainties; that of the gain is relative.
    pub u_gain: f64,
    pub u_angle_rad: f64,
}

/// Deviations from what is declared.
#[derive(Debug, Clone)]
pub struct RadialCalibration {
    /// ε_i of all sensors, then δ_i, rad.
    pub deviations: Vec<f64>,
    pub covariance: Mat<f64>,
}

/// Of the sensors of one section, from the first harmonic of `data`. `turn`: σ, ±1. `None`: the rows do not determine
/// them with P and E_n, or they are declared to be exactly known.
pub fn calibrate_radial(
    data: &HarmonicData,
    sensors: &[RadialSensor],
    turn: f64,
) -> Option<RadialCalibration> {
    let is_own = |row: &usize| sensors.iter().any(|s| s.channel == data.rows[*row].channel);
    let rows: Vec<usize> = (0..data.rows.len()).filter(is_own).collect();
    let mut mountings: Vec<usize> = rows.iter().map(|row| data.rows[*row].index).collect();
    mountings.sort_unstable();
    mountings.dedup();
    Equations { data, sensors, turn, rows, mountings }.solve()
}

/// Unknowns: gains, angles, P, then E_n mounting by mounting; of the complex ones real and imaginary part.
struct Equations<'a> {
    data: &'a HarmonicData,
    sensors: &'a [RadialSensor],
    turn: f64,
    /// Numbers of the rows of `data`, and their mountings.
    rows: Vec<usize>,
    mountings: Vec<usize>,
}

impl Equations<'_> {
    fn unknowns(&self) -> usize {
        2 * (self.sensors.len() + 1 + self.mountings.len())
    }

    fn declared(&self) -> Vec<f64> {
        let gains = self.sensors.iter().map(|sensor| sensor.u_gain);
        gains.chain(self.sensors.iter().map(|sensor| sensor.u_angle_rad)).collect()
    }

    fn solve(&self) -> Option<RadialCalibration> {
        let declared = self.declared();
        let (own, observations) = (declared.len(), 2 * self.rows.len());
        let free = observations.checked_sub(self.unknowns() - own).filter(|free| *free > 0)?;
        if declared.iter().any(|u| *u <= 0.0) {
            return None;
        }
        let sigma_mm = self.data.sigma_mm(1);
        let (mut x, mut covariance) = (vec![0.0; self.unknowns()], None);
        for iteration in 0..ITERATIONS {
            let (mut a, mut y) = self.rows_at(&x);
            let mut sigma: Vec<f64> =
                self.rows.iter().flat_map(|row| [sigma_mm[*row]; 2]).collect();
            if iteration > 1 {
                // The motion is not quite the same at each mounting.
                let squares = y.iter().zip(&sigma).map(|(y, sigma)| (y / sigma).powi(2));
                let scatter = (squares.sum::<f64>() / free as f64).sqrt().max(1.0);
                sigma.iter_mut().for_each(|sigma| *sigma *= scatter);
            }
            a.resize_with(observations + own, self.unknowns(), |i, j| {
                f64::from(u8::from(i == observations + j))
            });
            y.extend(x[..own].iter().map(|deviation| -deviation));
            sigma.extend(&declared);
            let solution = linear::solve(&LinearProblem {
                a: a.as_ref(),
                y: &y,
                sigma: &sigma,
                constraints: None,
                rank_threshold: RANK_THRESHOLD,
            });
            let solution = solution.ok()?;
            x.iter_mut().zip(&solution.x).for_each(|(x, step)| *x += step);
            covariance = Some(solution.covariance);
        }
        let covariance = covariance?.submatrix(0, 0, own, own).to_owned();
        Some(RadialCalibration { deviations: x[..own].to_vec(), covariance })
    }

    /// Derivatives and residuals of the rows, real and imaginary part of each.
    fn rows_at(&self, x: &[f64]) -> (Mat<f64>, Vec<f64>) {
        let count = self.sensors.len();
        let complex = |first: usize| c64::new(x[first], x[first + 1]);
        let mut a = Mat::zeros(2 * self.rows.len(), self.unknowns());
        let mut y = Vec::new();
        for (number, row) in self.rows.iter().enumerate() {
            let key = self.data.rows[*row];
            let sensor = self.sensors.iter().position(|s| s.channel == key.channel).unwrap_or(0);
            let mounting = self.mountings.iter().position(|n| *n == key.index).unwrap_or(0);
            let (against, with) = (2 * count, 2 * (count + 1 + mounting));
            let gain = 1.0 + x[sensor];
            let angle = self.sensors[sensor].angle_rad + x[count + sensor];
            let turned = c64::cis(self.turn * angle);
            let [p, e] = [complex(against) * turned, complex(with) * turned.conj()];
            let by_angle = c64::new(0.0, self.turn * gain) * (p - e);
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
            let residual = self.data.means[0][*row] - (p + e) * gain;
            y.extend([residual.re, residual.im]);
        }
        (a, y)
    }
}
