//! Propagation of the sources through both fits: by covariance and by Monte Carlo (JCGM 100 and JCGM
//! 101), and whether the poses agree with what is declared.

use std::convert::Infallible;

use faer::Mat;
use glam::{DMat3, DVec3};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::centres::Centres;
use super::model::{Problem, Sight};
use super::sources::{Acts, Shape, UncertaintySource};
use crate::estimation::coverage;
use crate::estimation::misfit::Misfit;
use crate::estimation::monte_carlo::{MonteCarloError, Summary, Trials, propagate};
use crate::estimation::nonlinear::Minimum;

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
    pub fn covariance(&self, sources: &[UncertaintySource], first: usize) -> DMat3 {
        let mut sum = DMat3::from_diagonal(DVec3::splat(LEAST_MM.powi(2)));
        for (effect, _) in self.of.iter().zip(sources).filter(|(_, source)| source.shown) {
            for column in effect.col_iter() {
                let by = DVec3::new(column[first], column[first + 1], column[first + 2]);
                sum += DMat3::from_cols(by * by.x, by * by.y, by * by.z);
            }
        }
        sum
    }
}

/// W with Wᵀ·W = Σ⁻¹: the inverse of the lower root.
pub fn whitening(covariance: DMat3) -> DMat3 {
    let c = |i: usize, j: usize| covariance.col(j)[i];
    let l00 = c(0, 0).sqrt();
    let (l10, l20) = (c(1, 0) / l00, c(2, 0) / l00);
    let l11 = (c(1, 1) - l10 * l10).sqrt();
    let l21 = (c(2, 1) - l20 * l10) / l11;
    let l22 = (c(2, 2) - l20 * l20 - l21 * l21).sqrt();
    let columns = [DVec3::new(l00, l10, l20), DVec3::new(0.0, l11, l21), DVec3::Z * l22];
    DMat3::from_cols(columns[0], columns[1], columns[2]).inverse()
}

/// Both fits, solved.
pub struct Solved<'a> {
    pub centres: &'a Centres,
    pub fitted: &'a Minimum,
    pub problem: &'a Problem,
    pub minimum: &'a Minimum,
    /// Machine frame to table frame, of each group.
    pub into_table: &'a [DMat3],
    /// Unknowns of the sensor's latency.
    pub clocks: usize,
}

impl Solved<'_> {
    /// What centres moved by `by` (machine frame) do to the weighted rows of the second fit.
    fn rows(&self, by: impl Fn(usize) -> DVec3) -> Vec<f64> {
        let sights = self.problem.sights.iter().zip(self.into_table).enumerate();
        sights
            .flat_map(|(i, (Sight { weight, .. }, into))| (*weight * -(*into * by(i))).to_array())
            .collect()
    }

    fn rows_of(&self, effect: &Mat<f64>, column: usize) -> Vec<f64> {
        self.rows(|i| {
            let first = self.centres.first(i);
            DVec3::from_array([0, 1, 2].map(|k| effect[(first + k, column)]))
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
    Misfit::judge(&solved.minimum.residuals, &left, declared)
}

/// First-order propagation. Unknowns: those of the second fit, then the beam's, then the latency's.
pub struct Propagated {
    pub covariance: Mat<f64>,
    pub budget: Vec<(&'static str, Vec<f64>)>,
    shown: Vec<f64>,
}

impl Propagated {
    pub fn new(
        solved: &Solved<'_>,
        effects: &Effects,
        sources: &[UncertaintySource],
        misfit: &Misfit,
    ) -> Self {
        let beam = solved.centres.common();
        let unknowns = solved.minimum.x.len() + beam + solved.clocks;
        let mut all = Self {
            covariance: Mat::zeros(unknowns, unknowns),
            budget: Vec::new(),
            shown: vec![0.0; unknowns],
        };
        for (effect, source) in effects.of.iter().zip(sources) {
            let factor = if source.shown { misfit.factor } else { 1.0 };
            let columns: Vec<Vec<f64>> = (0..effect.ncols())
                .map(|j| {
                    let mut x = solved.minimum.factored.solve(&solved.rows_of(effect, j));
                    x.extend((0..beam).map(|k| effect[(k, j)]));
                    x.extend(source.clocks.get(j).into_iter().flatten());
                    x.resize(unknowns, 0.0);
                    x
                })
                .collect();
            let total = Mat::from_fn(unknowns, columns.len(), |i, j| factor * columns[j][i]);
            all.add(source, &total);
        }
        all
    }

    fn add(&mut self, source: &UncertaintySource, effect: &Mat<f64>) {
        let share = effect * effect.transpose();
        let variance: Vec<f64> = (0..share.nrows()).map(|i| share[(i, i)]).collect();
        if source.shown {
            self.shown.iter_mut().zip(&variance).for_each(|(sum, v)| *sum += v);
        }
        self.budget.push((source.name, variance.into_iter().map(f64::sqrt).collect()));
        self.covariance += share;
    }

    pub fn u(&self, unknown: usize) -> f64 {
        self.covariance[(unknown, unknown)].max(0.0).sqrt()
    }

    /// Effective degrees of freedom; `None`: infinitely many.
    pub fn dof(&self, unknown: usize, misfit: &Misfit) -> Option<f64> {
        let (all, shown) = (self.covariance[(unknown, unknown)], self.shown[unknown]);
        let known = if misfit.factor == 1.0 { f64::INFINITY } else { misfit.dof };
        let parts = [(shown, known), (all - shown, f64::INFINITY)];
        Some(coverage::effective_dof(&parts)).filter(|dof| dof.is_finite())
    }
}

/// Monte Carlo through the whole identification: the dwell points are drawn anew, the spheres are
/// fitted again, and then the machine. Unknowns as in [`Propagated`].
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
            *into * (centres.centre(&x, group) - centres.centre(&fitted.x, group))
        });
        let moved: Vec<DVec3> = moved.collect();
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
    let mut unit = || match source.shape {
        Shape::Normal => StandardNormal.sample(rng),
        Shape::Rectangular => (rng.random::<f64>() - 0.5) * 12f64.sqrt(),
    };
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
