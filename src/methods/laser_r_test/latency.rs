//! The latency between sensor and axis positions, and the lost motion of the axes at reversals, from forward and
//! backward passes at two feeds. The latency shifts a pass in proportion to the velocity, lost motion only by its
//! sign. At one feed they are not separable.
//!
//! Only passes through the same cell are compared. The contributions of the sphere, the sensor's linearity and the
//! tilt of its beam are the same there in both directions, and are an unknown of the cell.

use faer::Mat;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::bench::LaserSetup;
use super::cells::{Sphere, group_by_cell};
use super::track::{PositionHistory, TimedSample};
use crate::{IdentifyError, Refused};
use estimation::linear::lower_root;
use estimation::null_names::name_null_space;
use estimation::schur::{Factored, Rows, factor};
use machine::Axis;

/// Assumed standard uncertainty of one sample, mm. The result is scaled to the observed scatter.
const SIGMA_MM: f64 = 1e-3;
/// Smallest standard uncertainty of a sample, mm.
const LEAST_MM: f64 = 1e-6;
/// Maximum number of iterations. Each one interpolates the positions again.
const ROUNDS: usize = 30;
/// The iteration ends when the latency changes by less than this, s, or by less than the fraction [`SETTLED`] of
/// its standard uncertainty.
const SAME_S: f64 = 1e-8;
const SETTLED: f64 = 0.05;
/// Iterations in which the reliable samples are selected again. Later the selection is fixed, otherwise some
/// samples would alternate between iterations.
const CHOICES: usize = 4;
/// Largest ratio by which the other unknowns may increase an unknown's uncertainty. Beyond it the unknown counts as
/// not separable. For two feeds in the ratio r, r > 1, it is (r + 1)/(r − 1).
const MAX_UNCERTAINTY_INFLATION: f64 = 5.5;

/// Estimated latency and lost motion.
#[derive(Debug, Clone)]
pub struct Latency {
    /// Latency τ, s: the value stamped t + τ belongs to the position stamped t.
    pub tau_s: f64,
    /// Linear axes that moved.
    pub axes: Vec<Axis>,
    /// Lag of X, Y and Z behind the indicated position after a forward motion less that after a backward motion,
    /// mm. Lost motion is positive. 0 where it is unknown.
    pub lag: Vector3<f64>,
    /// Lower root of the covariance of τ (s) and of the lags of `axes` (mm).
    pub root: Mat<f64>,
    /// Number of samples of the estimate.
    pub samples: usize,
}

/// One scan: transformation from X, Y, Z to the machine frame, rotation from the spindle frame, samples.
pub struct Timed<'a> {
    pub travel: Matrix3<f64>,
    pub spindle: Rotation3<f64>,
    pub track: &'a PositionHistory,
}

impl Latency {
    /// True positions of the axes, corrected for lost motion.
    pub fn true_xyz(&self, xyz: Vector3<f64>, last_motion_sign: Vector3<f64>) -> Vector3<f64> {
        xyz - self.lag.component_mul(&last_motion_sign) / 2.0
    }

    /// Derivatives of the true position by τ (per s) and by the lags (per mm).
    pub fn columns(
        &self,
        velocity: Vector3<f64>,
        last_motion_sign: Vector3<f64>,
    ) -> Vec<Vector3<f64>> {
        let lags = self.axes.iter().map(|axis| half_step(*axis, last_motion_sign));
        std::iter::once(-velocity).chain(lags.map(|half| -half)).collect()
    }

    pub fn names(&self) -> Vec<String> {
        names(&self.axes)
    }

    /// Values in the order of the names, s and mm.
    pub fn values(&self) -> Vec<f64> {
        let lags = self.axes.iter().map(|axis| self.lag.dot(&axis.direction()));
        std::iter::once(self.tau_s).chain(lags).collect()
    }
}

fn half_step(axis: Axis, last_motion_sign: Vector3<f64>) -> Vector3<f64> {
    axis.direction().component_mul(&last_motion_sign) / 2.0
}

/// # Errors
/// No sample is on the sphere, or the passes do not separate latency and lags.
pub fn fit(bench: &LaserSetup<'_>, scans: &[Timed<'_>]) -> Result<Latency, IdentifyError> {
    let (mut tau_s, mut chosen) = (0.0, Vec::new());
    for number in 0..ROUNDS {
        if number < CHOICES {
            chosen = scans.iter().map(|scan| Chosen::new(bench, scan, tau_s)).collect();
        }
        let round = Round::new(bench, &chosen, tau_s)?;
        let (factored, x) = round.solve()?;
        let by = x.first().copied().unwrap_or(f64::NAN);
        tau_s += by;
        if !tau_s.is_finite() {
            break;
        }
        let found = round.finish(tau_s, &factored, &x);
        let u_s = found.root[(0, 0)];
        if number + 1 >= CHOICES && by.abs() < SAME_S.max(SETTLED * u_s) {
            return Ok(found);
        }
    }
    Err(IdentifyError::Refused(Refused {
        why: "the latency between sensor and axis positions does not settle".to_owned(),
        instead: "look whether the time stamps of both go on evenly (`trued watch` lists the sensor's), and \
                  measure again, or with dwell points: sampling = \"dwell\""
            .to_owned(),
    }))
}

/// The reliable samples of one scan, by cells.
struct Chosen<'a> {
    scan: &'a Timed<'a>,
    cells: Vec<Vec<TimedSample>>,
}

impl<'a> Chosen<'a> {
    fn new(bench: &LaserSetup<'_>, scan: &'a Timed<'a>, tau_s: f64) -> Self {
        let seen = scan.track.seen(tau_s);
        let cells = group_by_cell(bench, &seen).into_iter();
        Self { scan, cells: cells.map(|all| all.into_iter().copied().collect()).collect() }
    }

    fn with(&self, tau_s: f64) -> Vec<Vec<TimedSample>> {
        let again = |one: &TimedSample| self.scan.track.again(one, tau_s);
        self.cells.iter().map(|all| all.iter().filter_map(again).collect()).collect()
    }
}

/// The samples at the positions that one value of the latency gives.
struct Round {
    axes: Vec<Axis>,
    /// Rows of each cell, from the samples of one scan.
    cells: Vec<Vec<Row>>,
}

struct Row {
    /// Reading less that of the fitted sphere, mm.
    off: f64,
    /// Derivatives of `off` by τ (per s) and by the lags (per mm).
    columns: Vec<f64>,
}

impl Round {
    /// # Errors
    /// There are too few samples.
    fn new(
        bench: &LaserSetup<'_>,
        chosen: &[Chosen<'_>],
        tau_s: f64,
    ) -> Result<Self, IdentifyError> {
        let all = || chosen.iter().flat_map(|of| of.cells.iter().flatten());
        let moved = |k: usize| all().any(|one| one.last_motion_sign[k] != 0.0);
        let axes = Axis::LINEAR.into_iter().enumerate().filter(|(k, _)| moved(*k));
        let axes: Vec<Axis> = axes.map(|(_, axis)| axis).collect();
        let mut cells: Vec<Vec<Row>> = Vec::new();
        for of in chosen {
            let (scan, placed) = (of.scan, of.with(tau_s));
            let seen = placed.concat();
            let Some(sphere) = Sphere::of(bench, (scan.travel, scan.spindle), &seen) else {
                continue;
            };
            for all in &placed {
                let rows = all.iter().filter_map(|one| {
                    let at = scan.travel * one.xyz;
                    let off = one.value - sphere.reading(at)?;
                    let slope = scan.travel.transpose() * sphere.slope(at)?;
                    let lags =
                        axes.iter().map(|axis| slope.dot(&half_step(*axis, one.last_motion_sign)));
                    let columns = std::iter::once(slope.dot(&one.velocity)).chain(lags);
                    Some(Row { off, columns: columns.map(|by| -by).collect() })
                });
                cells.push(rows.collect());
            }
        }
        cells.retain(|rows| !rows.is_empty());
        let samples: usize = cells.iter().map(Vec::len).sum();
        if samples > 2 * cells.len() + 2 * axes.len() {
            return Ok(Self { axes, cells });
        }
        Err(IdentifyError::Refused(Refused {
            why: format!(
                "{samples} samples of the stage `latency` can be used: too few to find the sensor's latency, \
                 without which no continuous scan means anything"
            ),
            instead: REMEDY.to_owned(),
        }))
    }

    fn unknowns(&self) -> usize {
        1 + self.axes.len()
    }

    fn blocks(&self) -> Vec<Rows> {
        let block = |rows: &Vec<Row>| {
            let mut block = Rows::zeros(rows.len(), 1, self.unknowns());
            for (i, row) in rows.iter().enumerate() {
                block.set_own(i, 0, 1.0 / SIGMA_MM);
                block.set_value(i, row.off / SIGMA_MM);
                let columns = row.columns.iter().enumerate();
                columns.for_each(|(j, by)| block.set_common(i, j, by / SIGMA_MM));
            }
            block
        };
        self.cells.iter().map(block).collect()
    }

    fn values(&self) -> Vec<f64> {
        self.cells.iter().flatten().map(|row| row.off / SIGMA_MM).collect()
    }

    /// # Errors
    /// Unknowns are not separable, or are separated only by the acceleration ramps.
    fn solve(&self) -> Result<(Factored, Vec<f64>), IdentifyError> {
        let (factored, _) = factor(self.blocks());
        let survey = factored.survey().map_err(|why| IdentifyError::Numerical(why.to_string()))?;
        let mut names = names(&self.axes);
        names.extend((0..self.cells.len()).map(|cell| format!("cell_{cell}")));
        let rank = format!("rank {} of {}", survey.rank, survey.rank + survey.nullity);
        if survey.nullity > 0 {
            let lost = name_null_space(survey.null_space.as_ref(), &names);
            return Err(not_separable_error(&rank, lost));
        }
        let (covariance, alone) = (factored.covariance(), factored.column_norms());
        let inflated =
            |k: &usize| covariance[(*k, *k)].sqrt() * alone[*k] > MAX_UNCERTAINTY_INFLATION;
        let weak: Vec<String> =
            (0..self.unknowns()).filter(inflated).filter_map(|k| names.get(k).cloned()).collect();
        if !weak.is_empty() {
            return Err(not_separable_error(&format!("{rank}, but barely"), weak));
        }
        let x = factored.solve(&self.values());
        Ok((factored, x))
    }

    fn finish(self, tau_s: f64, factored: &Factored, x: &[f64]) -> Latency {
        let samples: usize = self.cells.iter().map(Vec::len).sum();
        let left: f64 = factored.remainder(&self.values()).iter().map(|rest| rest * rest).sum();
        let free = samples.saturating_sub(factored.unknowns()).max(1) as f64;
        let scale = (left / free).max((LEAST_MM / SIGMA_MM).powi(2));
        let (covariance, count) = (factored.covariance(), self.unknowns());
        let own = Mat::from_fn(count, count, |i, j| scale * covariance[(i, j)]);
        let lags = self.axes.iter().zip(x.iter().skip(1));
        Latency {
            tau_s,
            lag: lags.map(|(axis, by)| axis.direction() * *by).sum(),
            root: lower_root(&own),
            samples,
            axes: self.axes,
        }
    }
}

fn names(axes: &[Axis]) -> Vec<String> {
    let lags = axes.iter().map(|axis| format!("reversal_{axis}"));
    std::iter::once("latency".to_owned()).chain(lags).collect()
}

const REMEDY: &str = "measure the stage `latency` whole: both lines forward and back, at feed_mm_min and at a \
                      fast_feed_mm_min that is half more at least; or measure anew with sampling = \"dwell\"";

/// Refusal that names the unknowns that are not separable, without the unknowns of cells.
fn not_separable_error(rank: &str, what: Vec<String>) -> IdentifyError {
    let named = |words: &String| words.contains("latency") || words.contains("reversal");
    let what: Vec<String> =
        what.into_iter().filter(named).map(|words| without_cells(&words)).collect();
    IdentifyError::Refused(Refused {
        why: format!(
            "{rank}: these passes do not tell apart the sensor's latency and what the axes lose where they \
             turn round ({})",
            what.join(", ")
        ),
        instead: REMEDY.to_owned(),
    })
}

/// The names in a combination, without those of cells.
fn without_cells(words: &str) -> String {
    let of = words.split(|c: char| c.is_whitespace() || "+-:=()".contains(c));
    let names = of.filter(|word| word.starts_with("latency") || word.starts_with("reversal"));
    names.collect::<Vec<_>>().join(" and ")
}
