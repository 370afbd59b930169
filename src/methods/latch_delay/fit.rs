//! Fit of the line of position over feed, with drift. Each feed has its own scatter.

use faer::Mat;

use super::observe::{Observed, Touch};
use super::outputs;
use crate::identification::declared::rounding_mm;
use crate::identification::{
    Effect, EvaluationType, FitFigures, Identification, InResiduals, LinearFit, Solution,
    Uncertainty, UncertaintySource, identify, unit_slope,
};
use crate::{IdentifyError, Refused};
use estimation::linear::{self, LinearProblem, LinearSolution, RANK_THRESHOLD};

/// Number of iterations: weights from the scatter, scatter from the residuals. They converge within this number.
const ROUNDS: usize = 5;

/// Part of the error message for unsolvable equations.
const LOST: &str = "delay and drift: touch at both feeds in turns";

/// Scatter of the touches at one feed.
#[derive(Debug, Clone, Copy)]
pub struct Scatter {
    /// Standard deviation of one touch, mm, at least that of the display resolution.
    pub s_mm: f64,
    pub dof: f64,
}

pub struct Fitted {
    pub identified: Identification,
    /// Latch delay, s.
    pub delay_s: f64,
    /// Uncertainty of the delay, s.
    pub delay_uncertainty: Uncertainty,
    pub scatter: [Scatter; 2],
    /// Drift, mm/s, positive towards the part.
    pub drift_mm_s: f64,
    /// Position of each touch less its position without delay, mm.
    pub late_mm: Vec<f64>,
}

/// # Errors
/// The touches do not separate delay and drift, or they do not scatter at all and no resolution of the axes is
/// declared.
pub fn fit(observed: &Observed) -> Result<Fitted, IdentifyError> {
    let touches = &observed.touches;
    let Times { middle, half } = Times::of(touches);
    let speeds = observed.speeds();
    // Unknowns: the position in each segment, mm; the delay, s; half of the total drift, mm.
    let delay = touches.iter().map(|touch| touch.segment).max().unwrap_or(0) + 1;
    let a = Mat::from_fn(touches.len(), delay + 2, |i, j| match j {
        _ if j < delay => f64::from(u8::from(touches[i].segment == j)),
        _ if j == delay => speeds[touches[i].feed],
        _ => (touches[i].t_s - middle) / half,
    });
    let (solution, scatter) = reweighted(observed, &a)?;
    let LinearSolution { x, gain, residuals, .. } = &solution;
    let sigma = sigma(touches, scatter);
    let weighted: Vec<f64> = residuals.iter().zip(&sigma).map(|(r, sigma)| r / sigma).collect();
    let solved = Solution {
        model: &LinearFit { x, a: &a, sigma: &sigma, gain },
        residuals: &weighted,
        is_declared: true,
        figures: FitFigures::of_linear(&solution),
        measurements: &[],
    };
    let slope = unit_slope(delay, x.len());
    let outputs = outputs::outputs(observed, x, &slope);
    let identified = identify(&solved, &sources(observed, scatter, &slope), outputs, None)?;
    let late = residuals.iter().zip(touches).map(|(r, touch)| r + x[delay] * speeds[touch.feed]);
    Ok(Fitted {
        delay_s: x[delay],
        delay_uncertainty: identified.propagation.uncertainty(&slope),
        identified,
        scatter,
        drift_mm_s: x[delay + 1] / half,
        late_mm: late.collect(),
    })
}

/// Iterates weights from the scatter and scatter from the residuals.
fn reweighted(
    observed: &Observed,
    a: &Mat<f64>,
) -> Result<(LinearSolution, [Scatter; 2]), IdentifyError> {
    let touches = &observed.touches;
    let y: Vec<f64> = touches.iter().map(|touch| touch.along_mm - observed.way_mm).collect();
    let least = observed.resolution_mm / 12f64.sqrt();
    let mut scatter = [Scatter { s_mm: 1e-3, dof: 0.0 }; 2];
    let mut solved = None;
    for _ in 0..ROUNDS {
        let problem = LinearProblem {
            a: a.as_ref(),
            y: &y,
            sigma: &sigma(touches, scatter),
            constraints: None,
            rank_threshold: RANK_THRESHOLD,
        };
        let solution = linear::solve(&problem)
            .map_err(|error| IdentifyError::unsolved(error, |_| vec![LOST.to_owned()]))?;
        scatter = [0, 1].map(|feed| judged(touches, a, &solution, feed, least));
        if let Some(feed) = (0..2).find(|feed| scatter[*feed].s_mm <= 0.0) {
            return Err(alike(observed.feeds_mm_min[feed]));
        }
        solved = Some(solution);
    }
    let solution = solved.ok_or_else(|| IdentifyError::Numerical("nothing to fit".to_owned()))?;
    Ok((solution, scatter))
}

fn sigma(touches: &[Touch], scatter: [Scatter; 2]) -> Vec<f64> {
    touches.iter().map(|touch| scatter[touch.feed].s_mm).collect()
}

/// Sources: the scatter at each feed, and the part of the display resolution that does not average out, as an
/// effect on the delay itself. `delay`: derivative of the delay by the unknowns. χ² tests none of them, as the
/// sizes already follow from the residuals.
fn sources(observed: &Observed, scatter: [Scatter; 2], delay: &[f64]) -> [UncertaintySource; 3] {
    let of_feed = |feed: usize| {
        let Scatter { s_mm, dof } = scatter[feed];
        let size = |touch: &Touch| if touch.feed == feed { s_mm } else { 0.0 };
        let each = Effect::Each(observed.touches.iter().map(size).collect());
        let name = format!("scatter at {} mm/min", observed.feeds_mm_min[feed]);
        let evaluation = EvaluationType::A;
        UncertaintySource { evaluation, dof, ..UncertaintySource::new(name, each) }
    };
    let [slow, fast] = observed.speeds();
    let steps: f64 =
        scatter.iter().map(|s| rounding_mm(observed.resolution_mm, s.s_mm).powi(2)).sum();
    let u_s = steps.sqrt() / (fast - slow);
    let resolution = UncertaintySource {
        direct_changes: vec![delay.iter().map(|slope| slope * u_s).collect()],
        ..UncertaintySource::new("resolution", Effect::Joint(vec![Vec::new()]))
    };
    [of_feed(0), of_feed(1), resolution]
        .map(|source| UncertaintySource { in_residuals: InResiduals::Absent, ..source })
}

struct Times {
    middle: f64,
    half: f64,
}

impl Times {
    fn of(touches: &[Touch]) -> Self {
        let times = || touches.iter().map(|touch| touch.t_s);
        let first = times().fold(f64::INFINITY, f64::min);
        let last = times().fold(f64::NEG_INFINITY, f64::max);
        let half = if last > first { (last - first) / 2.0 } else { 1.0 };
        Self { middle: (first + last) / 2.0, half }
    }
}

/// Scatter at one feed: sum of its squared residuals over the sum of 1 − h, with h the diagonal of the hat matrix.
fn judged(
    touches: &[Touch],
    a: &Mat<f64>,
    solution: &LinearSolution,
    feed: usize,
    least_mm: f64,
) -> Scatter {
    let (mut squares, mut dof) = (0.0, 0.0);
    for i in (0..touches.len()).filter(|i| touches[*i].feed == feed) {
        let hat: f64 = (0..a.ncols()).map(|k| a[(i, k)] * solution.gain[(k, i)]).sum();
        squares += solution.residuals[i].powi(2);
        dof += 1.0 - hat;
    }
    let s_mm = if dof > 0.0 { (squares / dof).sqrt() } else { f64::NAN };
    Scatter { s_mm: s_mm.max(least_mm), dof }
}

fn alike(feed_mm_min: f64) -> IdentifyError {
    Refused {
        why: format!(
            "all touches at {feed_mm_min} mm/min read alike to the last digit, and nothing says how fine \
             the display is"
        ),
        instead: "state resolution_um of the axes; if touches still read alike, the latch does not follow \
                  the machine"
            .to_owned(),
    }
    .into()
}
