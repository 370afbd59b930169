//! The latency between sensor and axis positions, and how far the axes lag behind where they turn round,
//! from passes forward and back at two feeds: the latency shifts a pass by the velocity, lost motion by its
//! sign alone. At one feed both are the same.
//!
//! Only passes through the same cell are compared: what the sphere, the sensor's curve and the lean of its
//! beam add there is the same forward and back, and an unknown of the cell.

use faer::Mat;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::bench::Bench;
use super::cells::{Sphere, by_place};
use super::track::{Seen, Track};
use crate::{IdentifyError, Refused};
use estimation::linear::lower_root;
use estimation::null_names::name_null_space;
use estimation::schur::{Factored, Rows, factor};
use machine::Axis;

/// Assumed standard uncertainty of one sample; what comes out is scaled to what is seen, mm.
const SIGMA_MM: f64 = 1e-3;
/// No sample is better, mm.
const LEAST_MM: f64 = 1e-6;
/// Rounds after each of which the positions are looked up anew.
const ROUNDS: usize = 30;
/// Done when a round changes the latency by less, s, or by less than this part of its standard
/// uncertainty.
const SAME_S: f64 = 1e-8;
const SETTLED: f64 = 0.05;
/// In so many rounds it is chosen anew which samples can be trusted; then they stay, or some would come and
/// go with every round.
const CHOICES: usize = 4;
/// An unknown that the others make so many times more uncertain is not told from them. At two feeds in
/// the ratio r, r > 1, it is (r + 1)/(r − 1).
const MOST_INFLATED: f64 = 5.5;

/// What was found.
#[derive(Debug, Clone)]
pub struct Latency {
    /// The value stamped t + τ belongs to the position stamped t.
    pub tau_s: f64,
    /// Axes that moved.
    pub axes: Vec<Axis>,
    /// By how much X, Y and Z lag behind the position shown after a motion forward, more than after one
    /// back: lost motion is positive. 0 where it is not known.
    pub lag: Vector3<f64>,
    /// Lower root of the covariance of τ (s) and of the lags of `axes` (mm).
    pub root: Mat<f64>,
    /// Samples that it comes from.
    pub samples: usize,
}

/// One scan: from X, Y, Z to the machine frame, from the spindle frame, and the samples.
pub struct Timed<'a> {
    pub travel: Matrix3<f64>,
    pub spindle: Rotation3<f64>,
    pub track: &'a Track,
}

impl Latency {
    /// Where the axes truly stood.
    pub fn true_xyz(&self, xyz: Vector3<f64>, toward: Vector3<f64>) -> Vector3<f64> {
        xyz - self.lag.component_mul(&toward) / 2.0
    }

    /// By how much a greater τ, and greater lags, move that; per s and per mm.
    pub fn columns(&self, velocity: Vector3<f64>, toward: Vector3<f64>) -> Vec<Vector3<f64>> {
        let lags = self.axes.iter().map(|axis| half_step(*axis, toward));
        std::iter::once(-velocity).chain(lags.map(|half| -half)).collect()
    }

    pub fn names(&self) -> Vec<String> {
        names(&self.axes)
    }

    /// In the order of the names: s and mm.
    pub fn values(&self) -> Vec<f64> {
        let lags = self.axes.iter().map(|axis| self.lag.dot(&axis.direction()));
        std::iter::once(self.tau_s).chain(lags).collect()
    }
}

fn half_step(axis: Axis, toward: Vector3<f64>) -> Vector3<f64> {
    axis.direction().component_mul(&toward) / 2.0
}

/// # Errors
/// No sample on the sphere; latency and lags that the passes do not tell apart.
pub fn fit(bench: &Bench<'_>, scans: &[Timed<'_>]) -> Result<Latency, IdentifyError> {
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

/// The samples of one scan that can be trusted, by cells.
struct Chosen<'a> {
    scan: &'a Timed<'a>,
    cells: Vec<Vec<Seen>>,
}

impl<'a> Chosen<'a> {
    fn new(bench: &Bench<'_>, scan: &'a Timed<'a>, tau_s: f64) -> Self {
        let seen = scan.track.seen(tau_s);
        let cells = by_place(bench, &seen).into_iter();
        Self { scan, cells: cells.map(|all| all.into_iter().copied().collect()).collect() }
    }

    fn with(&self, tau_s: f64) -> Vec<Vec<Seen>> {
        let again = |one: &Seen| self.scan.track.again(one, tau_s);
        self.cells.iter().map(|all| all.iter().filter_map(again).collect()).collect()
    }
}

/// The samples as one latency places them.
struct Round {
    axes: Vec<Axis>,
    /// Each with the samples of one scan in it.
    cells: Vec<Vec<Row>>,
}

struct Row {
    /// What the sensor says beyond the sphere, mm.
    off: f64,
    /// By how much τ (per s) and the lags (per mm) change that.
    columns: Vec<f64>,
}

impl Round {
    /// # Errors
    /// Too few samples.
    fn new(bench: &Bench<'_>, chosen: &[Chosen<'_>], tau_s: f64) -> Result<Self, IdentifyError> {
        let all = || chosen.iter().flat_map(|of| of.cells.iter().flatten());
        let moved = |k: usize| all().any(|one| one.toward[k] != 0.0);
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
                    let lags = axes.iter().map(|axis| slope.dot(&half_step(*axis, one.toward)));
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
    /// Unknowns that are told from the others not at all, or by no more than the little that ramps say.
    fn solve(&self) -> Result<(Factored, Vec<f64>), IdentifyError> {
        let (factored, _) = factor(self.blocks());
        let survey = factored.survey().map_err(|why| IdentifyError::Numerical(why.to_string()))?;
        let mut names = names(&self.axes);
        names.extend((0..self.cells.len()).map(|cell| format!("cell_{cell}")));
        let rank = format!("rank {} of {}", survey.rank, survey.rank + survey.nullity);
        if survey.nullity > 0 {
            let lost = name_null_space(survey.null_space.as_ref(), &names);
            return Err(untold(&rank, lost));
        }
        let (covariance, alone) = (factored.covariance(), factored.column_norms());
        let inflated = |k: &usize| covariance[(*k, *k)].sqrt() * alone[*k] > MOST_INFLATED;
        let weak: Vec<String> =
            (0..self.unknowns()).filter(inflated).filter_map(|k| names.get(k).cloned()).collect();
        if !weak.is_empty() {
            return Err(untold(&format!("{rank}, but barely"), weak));
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

/// Told in words, but for what cells have to do with it.
fn untold(rank: &str, what: Vec<String>) -> IdentifyError {
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

/// The names of a combination that are not of cells.
fn without_cells(words: &str) -> String {
    let of = words.split(|c: char| c.is_whitespace() || "+-:=()".contains(c));
    let names = of.filter(|word| word.starts_with("latency") || word.starts_with("reversal"));
    names.collect::<Vec<_>>().join(" and ")
}
