//! Propagation of the sources through the identification: by covariance and by Monte Carlo (JCGM 100
//! and JCGM 101), and whether the residuals agree with what is declared.

use std::convert::Infallible;

use nalgebra::{Matrix3, Vector3};

use super::fit::{Measured, Problem};
use super::sources::{Draw, UncertaintySource};
use estimation::misfit::Misfit;
use estimation::monte_carlo::{MonteCarloError, Summary, Trials, propagate};
use estimation::nonlinear::Minimum;
use estimation::propagated::Propagated;
use estimation::schur::Factored;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7361_6d62;

/// How what is measured stands in the rows of the problem.
#[derive(Clone, Copy)]
pub struct Weights<'a> {
    pub problem: &'a Problem,
    /// Of each measurement.
    pub whitening: &'a [Matrix3<f64>],
    /// Of each length, mm.
    pub u_bars: &'a [f64],
}

/// The residuals against what is declared.
pub fn misfit(
    weights: &Weights<'_>,
    minimum: &Minimum,
    sources: &[UncertaintySource],
    declared: bool,
) -> Misfit {
    let draws = sources.iter().flat_map(|source| &source.draws);
    let left = draws.map(|draw| minimum.factored.remainder(&weights.rows(draw)));
    let dof = minimum.residuals.len().saturating_sub(minimum.x.len());
    Misfit::judge(&minimum.residuals, &left.collect::<Vec<_>>(), dof, declared)
}

/// First-order propagation. Unknowns: mm, rad, mm/mm.
pub fn by_covariance(
    weights: &Weights<'_>,
    factored: &Factored,
    sources: &[UncertaintySource],
    misfit: &Misfit,
) -> Propagated {
    let mut all = Propagated::new(weights.problem.unknowns());
    for source in sources {
        let draws = source.draws.iter().map(|draw| factored.solve(&weights.rows(draw)));
        all.add(source.name, source.shown, &draws.collect::<Vec<_>>(), misfit);
    }
    all
}

impl Weights<'_> {
    /// A draw as it stands in the weighted rows. Its sign has no meaning.
    fn rows(&self, draw: &Draw) -> Vec<f64> {
        let Self { problem, whitening, u_bars } = *self;
        let mut rows = vec![0.0; problem.rows_count()];
        if let Some(bar) = draw.first.checked_sub(3 * whitening.len()) {
            rows[problem.row_of_bar(bar)] = draw.values[0] / u_bars[bar];
            return rows;
        }
        for (i, moved) in draw.values.chunks_exact(3).enumerate() {
            let sight = draw.first / 3 + i;
            let moved = whitening[sight] * Vector3::from_column_slice(moved);
            rows[problem.row_of(sight)..][..3].copy_from_slice(moved.as_slice());
        }
        rows
    }
}

/// Monte Carlo through the whole identification: every measured centre and length is drawn anew and the
/// curved model is solved again. All unknowns. A centre follows its touches linearly here: a sphere fit
/// is so nearly linear that touches drawn and fitted one by one, even with ten times the scatter of a
/// probe, give the same u to two digits (`regress_touches_drawn_one_by_one_scatter_as_drawn_centres_do`).
///
/// # Errors
/// Fewer than two trials.
pub fn by_trials(
    problem: &Problem,
    minimum: &Minimum,
    measured: &Measured,
    sources: &[UncertaintySource],
    factor: f64,
    trials: Trials,
) -> Result<Summary, MonteCarloError<Infallible>> {
    propagate(trials, MONTE_CARLO_SEED, problem.unknowns(), |rng, out| {
        let mut drawn = measured.clone();
        for source in sources {
            let scale = if source.shown { factor } else { 1.0 };
            for draw in &source.draws {
                disturb(&mut drawn, draw, scale * source.shape.draw(rng));
            }
        }
        out.copy_from_slice(&problem.solve_near(minimum, &drawn));
        Ok(())
    })
}

fn disturb(measured: &mut Measured, draw: &Draw, by: f64) {
    if let Some(bar) = draw.first.checked_sub(3 * measured.xyz.len()) {
        measured.lengths[bar] += by * draw.values[0];
        return;
    }
    for (xyz, moved) in measured.xyz[draw.first / 3..].iter_mut().zip(draw.values.chunks_exact(3)) {
        *xyz += by * Vector3::from_column_slice(moved);
    }
}
