//! Propagation of the sources through both fits: by covariance and by Monte Carlo (JCGM 100 and JCGM
//! 101), and whether the poses agree with what is declared.

use std::convert::Infallible;

use faer::Mat;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::Rng;

use super::centres::Centres;
use super::model::{Problem, Sight};
use super::sources::{Acts, UncertaintySource};
use estimation::misfit::Misfit;
use estimation::monte_carlo::{MonteCarloError, Summary, Trials, propagate};
use estimation::nonlinear::Minimum;
use estimation::propagated::Propagated;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x6c61_7365;
/// No centre weighs more than one of this standard uncertainty, mm.
const LEAST_MM: f64 = 1e-6;

/// What each source does to the unknowns of the first fit: columns of unit draws.
pub struct Effects {
    pub of: Vec<Mat<f64>>,
}

impl Effects {
    pub fn new(centres: &Centres, fitted: &Minimum, sources: &[UncertaintySource]) -> Self {
        let gain = centres.gain(fitted);
        let of = |source: &UncertaintySource| match &source.acts {
            Acts::Each(sizes) => {
                Mat::from_fn(gain.nrows(), gain.ncols(), |i, j| gain[(i, j)] * sizes[j])
            }
            Acts::Joint(columns) => {
                let acts = Mat::from_fn(gain.ncols(), columns.len(), |i, j| columns[j][i]);
                &gain * acts
            }
        };
        Self { of: sources.iter().map(of).collect() }
    }

    /// Covariance of the centre whose unknowns begin at `first`, from the sources that the residuals
    /// show: its weight.
    pub fn covariance(&self, sources: &[UncertaintySource], first: usize) -> Matrix3<f64> {
        let mut sum = Matrix3::from_diagonal_element(LEAST_MM.powi(2));
        for (effect, _) in self.of.iter().zip(sources).filter(|(_, source)| source.shown) {
            for column in effect.col_iter() {
                let by = Vector3::new(column[first], column[first + 1], column[first + 2]);
                sum += by * by.transpose();
            }
        }
        sum
    }
}

/// Both fits, solved.
pub struct Solved<'a> {
    pub centres: &'a Centres,
    pub fitted: &'a Minimum,
    pub problem: &'a Problem,
    pub minimum: &'a Minimum,
    /// Machine frame to table frame, of each group.
    pub into_table: &'a [Rotation3<f64>],
    /// Unknowns of the sensor's latency.
    pub clocks: usize,
}

impl Solved<'_> {
    /// What centres moved by `by` (machine frame) do to the weighted rows of the second fit.
    fn rows(&self, by: impl Fn(usize) -> Vector3<f64>) -> Vec<f64> {
        let sights = self.problem.sights.iter().zip(self.into_table).enumerate();
        sights
            .flat_map(|(i, (Sight { weight, .. }, into))| -> [f64; 3] {
                (weight * -(into * by(i))).into()
            })
            .collect()
    }

    fn rows_of(&self, effect: &Mat<f64>, column: usize) -> Vec<f64> {
        self.rows(|i| {
            let first = self.centres.first(i);
            Vector3::from([0, 1, 2].map(|k| effect[(first + k, column)]))
        })
    }
}

/// The residuals of the poses against what is declared.
pub fn misfit(
    solved: &Solved<'_>,
    effects: &Effects,
    sources: &[UncertaintySource],
    declared: bool,
) -> Misfit {
    let mut left: Vec<Vec<f64>> = Vec::new();
    for (effect, _) in effects.of.iter().zip(sources) {
        let columns = (0..effect.ncols()).map(|j| solved.rows_of(effect, j));
        left.extend(columns.map(|rows| solved.minimum.factored.remainder(&rows)));
    }
    let Minimum { residuals, x, .. } = solved.minimum;
    Misfit::judge(residuals, &left, residuals.len().saturating_sub(x.len()), declared)
}

/// First-order propagation. Unknowns: those of the second fit, then the beam's, then the latency's.
pub fn by_covariance(
    solved: &Solved<'_>,
    effects: &Effects,
    sources: &[UncertaintySource],
    misfit: &Misfit,
) -> Propagated {
    let beam = solved.centres.common();
    let unknowns = solved.minimum.x.len() + beam + solved.clocks;
    let mut all = Propagated::new(unknowns);
    for (effect, source) in effects.of.iter().zip(sources) {
        let draw = |j: usize| {
            let mut x = solved.minimum.factored.solve(&solved.rows_of(effect, j));
            x.extend((0..beam).map(|k| effect[(k, j)]));
            x.extend(source.clocks.get(j).into_iter().flatten());
            x.resize(unknowns, 0.0);
            x
        };
        let draws: Vec<Vec<f64>> = (0..effect.ncols()).map(draw).collect();
        all.add(source.name, source.shown, &draws, misfit);
    }
    all
}

/// Monte Carlo through the whole identification: the dwell points are drawn anew, the spheres are
/// fitted again, and then the machine. Unknowns as in [`by_covariance`].
///
/// # Errors
/// Fewer than two trials.
pub fn by_trials(
    solved: &Solved<'_>,
    sources: &[UncertaintySource],
    factor: f64,
    trials: Trials,
) -> Result<Summary, MonteCarloError<Infallible>> {
    let Solved { centres, fitted, problem, minimum, into_table, clocks } = *solved;
    let (own, beam) = (minimum.x.len(), centres.common());
    propagate(trials, MONTE_CARLO_SEED, own + beam + clocks, |rng, out| {
        out[own + beam..].fill(0.0);
        let mut by = vec![0.0; centres.rows.len()];
        for source in sources {
            let scale = if source.shown { factor } else { 1.0 };
            draw(source, scale, rng, &mut by, &mut out[own + beam..]);
        }
        let x = centres.solve_near(fitted, &by);
        let moved = into_table.iter().enumerate().map(|(group, into)| {
            into * (centres.centre(&x, group) - centres.centre(&fitted.x, group))
        });
        let moved: Vec<Vector3<f64>> = moved.collect();
        out[..own].copy_from_slice(&problem.solve_near(minimum, &moved));
        out[own..own + beam].copy_from_slice(&x[..beam]);
        Ok(())
    })
}

/// Adds to the distances `by` and to the unknowns of the latency what one draw of a source does.
fn draw(
    source: &UncertaintySource,
    scale: f64,
    rng: &mut impl Rng,
    by: &mut [f64],
    clocks: &mut [f64],
) {
    let mut unit = || source.shape.draw(rng);
    match &source.acts {
        Acts::Each(sizes) => {
            by.iter_mut().zip(sizes).for_each(|(by, size)| *by += scale * size * unit());
        }
        Acts::Joint(columns) => {
            for (j, column) in columns.iter().enumerate() {
                let unit = scale * unit();
                by.iter_mut().zip(column).for_each(|(by, size)| *by += unit * size);
                let of = clocks.iter_mut().zip(source.clocks.get(j).into_iter().flatten());
                of.for_each(|(clock, size)| *clock += unit * size);
            }
        }
    }
}
