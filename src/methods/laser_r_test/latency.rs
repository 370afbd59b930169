//! The latency between sensor and axis positions, and how far the axes lag behind where they turn round,
//! from passes forward and back at two feeds: the latency shifts a pass by the velocity, lost motion by its
//! sign alone. At one feed both are the same.

use faer::Mat;
use glam::{DMat3, DVec3};

use super::bench::Bench;
use super::track::{Seen, Track};
use crate::base::Axis;
use crate::estimation::linear::{LinearError, Survey};
use crate::estimation::nonlinear::{Minimum, NonlinearError, minimise};
use crate::estimation::null_names::name_null_space;
use crate::estimation::schur::Rows;
use crate::methods::{IdentifyError, Refused};

/// Assumed standard uncertainty of one sample; what comes out is scaled to what is seen, mm.
const SIGMA_MM: f64 = 1e-3;
/// No sample is better, mm.
const LEAST_MM: f64 = 1e-6;
/// Rounds after each of which the positions are looked up anew.
const ROUNDS: usize = 30;
/// Done when a round changes the latency by less, s.
const SAME_S: f64 = 1e-8;
/// Unknowns before those of the reversal: the centre, the latency.
const BEFORE: usize = 4;
const TAU: usize = 3;
/// An unknown that the others make so many times more uncertain is not told from them. At two feeds in
/// the ratio r, r > 1, it is (r + 1)/(r − 1).
const MOST_INFLATED: f64 = 5.0;

/// What was found.
#[derive(Debug, Clone)]
pub struct Latency {
    /// The value stamped t + τ belongs to the position stamped t.
    pub tau_s: f64,
    /// Axes that moved.
    pub axes: Vec<Axis>,
    /// By how much X, Y and Z lag behind the position shown after a motion forward, more than after one
    /// back: lost motion is positive. 0 where it is not known.
    pub lag: DVec3,
    /// Lower root of the covariance of τ (s) and of the lags of `axes` (mm).
    pub root: Mat<f64>,
    /// Samples that it comes from.
    pub samples: usize,
}

/// One scan: from X, Y, Z to the machine frame, from the spindle frame, and the samples.
pub struct Timed<'a> {
    pub travel: DMat3,
    pub spindle: DMat3,
    pub track: &'a Track,
}

impl Latency {
    /// Where the axes truly stood.
    pub fn true_xyz(&self, xyz: DVec3, toward: DVec3) -> DVec3 {
        xyz - self.lag * toward / 2.0
    }

    /// By how much a greater τ, and greater lags, move that; per s and per mm.
    pub fn columns(&self, velocity: DVec3, toward: DVec3) -> Vec<DVec3> {
        let lags = self.axes.iter().map(|axis| half_step(*axis, toward));
        std::iter::once(-velocity).chain(lags.map(|half| -half)).collect()
    }

    pub fn names(&self) -> Vec<String> {
        let lags = self.axes.iter().map(|axis| format!("reversal_{axis}"));
        std::iter::once("latency".to_owned()).chain(lags).collect()
    }

    /// In the order of the names: s and mm.
    pub fn values(&self) -> Vec<f64> {
        let lags = self.axes.iter().map(|axis| self.lag.dot(unit(*axis)));
        std::iter::once(self.tau_s).chain(lags).collect()
    }
}

fn unit(axis: Axis) -> DVec3 {
    DVec3::from_array(Axis::LINEAR.map(|one| if one == axis { 1.0 } else { 0.0 }))
}

fn half_step(axis: Axis, toward: DVec3) -> DVec3 {
    unit(axis) * toward / 2.0
}

/// # Errors
/// No sample on the sphere; latency and lags that the passes do not tell apart.
pub fn fit(bench: &Bench<'_>, scans: &[Timed<'_>]) -> Result<Latency, IdentifyError> {
    let mut tau_s = 0.0;
    for _ in 0..ROUNDS {
        let round = Round::new(bench, scans, tau_s);
        if round.rows.len() < 2 * round.unknowns() {
            return Err(IdentifyError::Refused(Refused {
                why: format!(
                    "{} samples of the stage `latency` can be used: too few to find the sensor's latency, \
                     without which no continuous scan means anything",
                    round.rows.len()
                ),
                instead: REMEDY.to_owned(),
            }));
        }
        let minimum = round.solve()?;
        let by = minimum.x[TAU];
        tau_s += by;
        if !tau_s.is_finite() {
            break;
        }
        if by.abs() < SAME_S {
            return round.finish(tau_s, &minimum);
        }
    }
    Err(IdentifyError::Refused(Refused {
        why: "the latency between sensor and axis positions does not settle".to_owned(),
        instead: "look whether the time stamps of both go on evenly (`trued watch` lists the sensor's), and \
                  measure again, or with dwell points: sampling = \"dwell\""
            .to_owned(),
    }))
}

/// The samples as one latency places them.
struct Round {
    radius: f64,
    rows: Vec<Row>,
    axes: Vec<Axis>,
    start: DVec3,
}

struct Row {
    scan: usize,
    /// The light spot, machine frame.
    spot: DVec3,
    /// By how much τ (per s) and the lags (per mm) move it.
    moves: Vec<DVec3>,
}

impl Round {
    fn new(bench: &Bench<'_>, scans: &[Timed<'_>], tau_s: f64) -> Self {
        let seen: Vec<Vec<Seen>> = scans.iter().map(|scan| scan.track.seen(tau_s)).collect();
        let moved = |k: usize| seen.iter().flatten().any(|one| one.toward[k] != 0.0);
        let axes = Axis::LINEAR.into_iter().enumerate().filter(|(k, _)| moved(*k));
        let axes: Vec<Axis> = axes.map(|(_, axis)| axis).collect();
        let (mut rows, mut start) = (Vec::new(), DVec3::ZERO);
        for (number, (scan, seen)) in scans.iter().zip(&seen).enumerate() {
            let beam = scan.spindle * bench.beam();
            for one in seen {
                let spot = scan.travel * one.xyz + beam * one.value;
                let lags = axes.iter().map(|axis| half_step(*axis, one.toward));
                let moves = std::iter::once(one.velocity).chain(lags);
                let moves = moves.map(|by| scan.travel * -by).collect();
                rows.push(Row { scan: number, spot, moves });
                start += spot + beam * bench.ball.radius_mm;
            }
        }
        start /= rows.len().max(1) as f64;
        Self { radius: bench.ball.radius_mm, rows, axes, start }
    }

    fn unknowns(&self) -> usize {
        BEFORE + self.axes.len()
    }

    fn names(&self) -> Vec<String> {
        let lags = self.axes.iter().map(|axis| format!("reversal_{axis}"));
        let first = ["centre_x", "centre_y", "centre_z", "latency"].map(str::to_owned);
        first.into_iter().chain(lags).collect()
    }

    fn arm(&self, row: &Row, x: &[f64]) -> DVec3 {
        let moves = row.moves.iter().zip(&x[TAU..]);
        row.spot + moves.map(|(by, x)| *by * *x).sum::<DVec3>() - DVec3::from_slice(x)
    }

    fn residuals(&self, x: &[f64]) -> Vec<f64> {
        let off = |row: &Row| (self.radius - self.arm(row, x).length()) / SIGMA_MM;
        self.rows.iter().map(off).collect()
    }

    fn block(&self, x: &[f64]) -> Vec<Rows> {
        let mut block = Rows::zeros(self.rows.len(), 0, self.unknowns());
        for (i, row) in self.rows.iter().enumerate() {
            let arm = self.arm(row, x);
            let normal = arm.normalize_or_zero() / SIGMA_MM;
            block.set_value(i, (self.radius - arm.length()) / SIGMA_MM);
            (0..3).for_each(|k| block.set_common(i, k, -normal[k]));
            let moves = row.moves.iter().enumerate();
            moves.for_each(|(j, by)| block.set_common(i, TAU + j, normal.dot(*by)));
        }
        vec![block]
    }

    fn solve(&self) -> Result<Minimum, IdentifyError> {
        let mut start = self.start.to_array().to_vec();
        start.resize(self.unknowns(), 0.0);
        minimise(start, |x| self.block(x), |x| self.residuals(x)).map_err(|why| match why {
            NonlinearError::Linear(LinearError::RankDeficient(survey)) => self.deficient(&survey),
            other => IdentifyError::Numerical(format!("the latency: {other}")),
        })
    }

    fn deficient(&self, survey: &Survey) -> IdentifyError {
        let names = name_null_space(survey.null_space.as_ref(), &self.names());
        let rank = format!("rank {} of {}", survey.rank, survey.rank + survey.nullity);
        IdentifyError::Refused(lost(names, &rank))
    }

    /// # Errors
    /// Unknowns that are told from the others no better than by the little that the ramps say.
    fn finish(self, tau_s: f64, minimum: &Minimum) -> Result<Latency, IdentifyError> {
        let covariance = minimum.factored.covariance();
        let alone = minimum.factored.column_norms();
        let inflated = |k: &usize| covariance[(*k, *k)].sqrt() * alone[*k] > MOST_INFLATED;
        let names = self.names();
        let weak: Vec<usize> = (TAU..self.unknowns()).filter(inflated).collect();
        if !weak.is_empty() {
            let rank = format!("rank {} of {}", self.unknowns() - 1, self.unknowns());
            let weak = weak.iter().map(|k| names[*k].clone()).collect();
            return Err(IdentifyError::Refused(lost(weak, &rank)));
        }
        let scale = (self.scatter_mm(&minimum.residuals) / SIGMA_MM).powi(2);
        let count = self.unknowns() - TAU;
        let own = Mat::from_fn(count, count, |i, j| scale * covariance[(TAU + i, TAU + j)]);
        let lags = self.axes.iter().zip(&minimum.x[BEFORE..]);
        Ok(Latency {
            tau_s,
            lag: lags.map(|(axis, by)| unit(*axis) * *by).sum(),
            root: lower_root(&own),
            samples: self.rows.len(),
            axes: self.axes,
        })
    }

    /// Of one sample, from the difference of neighbours: what the sphere and the sensor's curve deviate
    /// changes slowly, and is the same forward and back.
    fn scatter_mm(&self, residuals: &[f64]) -> f64 {
        let rows = self.rows.windows(2).zip(residuals.windows(2));
        let within = rows.filter(|(rows, _)| rows[0].scan == rows[1].scan);
        let (sum, count) = within.fold((0.0, 0usize), |(sum, count), (_, pair)| {
            (sum + (pair[1] - pair[0]).powi(2) / 2.0, count + 1)
        });
        ((sum / count.max(1) as f64).sqrt() * SIGMA_MM).max(LEAST_MM)
    }
}

const REMEDY: &str = "measure the stage `latency` whole: both lines forward and back, at feed_mm_min and at a \
                      fast_feed_mm_min that is half more at least; or measure anew with sampling = \"dwell\"";

fn lost(what: Vec<String>, rank: &str) -> Refused {
    Refused {
        why: format!(
            "{rank}: these passes do not tell apart the sensor's latency and what the axes lose where they \
             turn round ({})",
            what.join(", ")
        ),
        instead: REMEDY.to_owned(),
    }
}

/// L with L·Lᵀ = a, of a positive matrix (Cholesky).
fn lower_root(a: &Mat<f64>) -> Mat<f64> {
    let mut root = Mat::zeros(a.nrows(), a.nrows());
    for i in 0..a.nrows() {
        for j in 0..=i {
            let before: f64 = (0..j).map(|k| root[(i, k)] * root[(j, k)]).sum();
            let rest: f64 = a[(i, j)] - before;
            root[(i, j)] = if i == j {
                rest.max(0.0).sqrt()
            } else if root[(j, j)] > 0.0 {
                rest / root[(j, j)]
            } else {
                0.0
            };
        }
    }
    root
}
