//! The line through positions over feed, with drift; each feed with a scatter of its own.

use std::f64::consts::PI;

use faer::Mat;

use super::observe::{Observed, Touch};
use crate::{IdentifyError, Refused};
use estimation::coverage;
use estimation::linear::{self, LinearError, LinearProblem, LinearSolution, RANK_THRESHOLD};

/// Weights from the scatter, scatter from the residuals: after so many rounds they stand.
const ROUNDS: usize = 5;

/// How touches scatter at one feed.
#[derive(Debug, Clone, Copy)]
pub struct Scatter {
    /// Standard deviation of one touch, mm; never less than the display's step lets one see.
    pub s_mm: f64,
    pub dof: f64,
}

pub struct Fitted {
    /// Latch delay, s.
    pub delay_s: f64,
    /// Variance of the delay by source, s², with its degrees of freedom: slow touches, fast ones, the
    /// display's steps.
    pub sources: [(f64, f64); 3],
    pub scatter: [Scatter; 2],
    /// mm/s, positive towards the part.
    pub drift_mm_s: f64,
    /// Each touch less what it would read without delay, mm.
    pub late_mm: Vec<f64>,
    pub solution: LinearSolution,
}

impl Fitted {
    pub fn u_s(&self) -> f64 {
        self.sources.iter().map(|(variance, _)| variance).sum::<f64>().sqrt()
    }

    pub fn dof(&self) -> f64 {
        coverage::effective_dof(&self.sources)
    }

    /// Expanded uncertainty of the delay, s.
    pub fn expanded_s(&self) -> f64 {
        coverage::coverage_factor(self.dof()) * self.u_s()
    }
}

/// # Errors
/// Touches that do not tell delay and drift apart; touches that do not scatter at all where no
/// resolution of the axes is declared.
pub fn fit(observed: &Observed) -> Result<Fitted, IdentifyError> {
    let touches = &observed.touches;
    let Times { middle, half } = Times::of(touches);
    let speeds = observed.speeds();
    let segments = touches.iter().map(|touch| touch.segment).max().unwrap_or(0) + 1;
    let a = Mat::from_fn(touches.len(), segments + 2, |i, j| match j {
        _ if j < segments => f64::from(u8::from(touches[i].segment == j)),
        _ if j == segments => speeds[touches[i].feed],
        _ => (touches[i].t_s - middle) / half,
    });
    let y: Vec<f64> = touches.iter().map(|touch| touch.along_mm - observed.way_mm).collect();
    let least = observed.resolution_mm / 12f64.sqrt();
    let mut scatter = [Scatter { s_mm: 1e-3, dof: 0.0 }; 2];
    let mut solved = None;
    for _ in 0..ROUNDS {
        let sigma: Vec<f64> = touches.iter().map(|touch| scatter[touch.feed].s_mm).collect();
        let problem = LinearProblem {
            a: a.as_ref(),
            y: &y,
            sigma: &sigma,
            constraints: None,
            rank_threshold: RANK_THRESHOLD,
        };
        let solution = linear::solve(&problem).map_err(refused)?;
        scatter = [0, 1].map(|feed| judged(touches, &a, &solution, feed, least));
        if let Some(feed) = (0..2).find(|feed| scatter[*feed].s_mm <= 0.0) {
            return Err(alike(observed.feeds_mm_min[feed]));
        }
        solved = Some(solution);
    }
    let solution = solved.ok_or_else(|| IdentifyError::Numerical("nothing to fit".to_owned()))?;
    let delay_s = solution.x[segments];
    let gain = |i: usize| solution.gain[(segments, i)];
    let of_feed = |feed: usize| {
        let own = (0..touches.len()).filter(|i| touches[*i].feed == feed);
        let variance = own.map(|i| (gain(i) * scatter[feed].s_mm).powi(2)).sum();
        (variance, scatter[feed].dof)
    };
    let [slow, fast] = speeds;
    let steps: f64 = scatter.iter().map(|s| rounding(observed.resolution_mm, s.s_mm).powi(2)).sum();
    Ok(Fitted {
        delay_s,
        sources: [of_feed(0), of_feed(1), (steps / (fast - slow).powi(2), f64::INFINITY)],
        scatter,
        drift_mm_s: solution.x[segments + 1] / half,
        late_mm: (0..touches.len())
            .map(|i| solution.residuals[i] + delay_s * speeds[touches[i].feed])
            .collect(),
        solution,
    })
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

/// The scatter at one feed from its residuals: their squares over what of them the fit has not taken,
/// the sum of 1 − h (h the diagonal of the hat matrix).
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

/// Standard uncertainty of a mean of touches by the steps of the display, mm. Rounding errors are a
/// sawtooth of the true place; scatter of σ behind it takes the factor exp(−2π²σ²/a²) of its first
/// harmonic, and more of the others. What scatter does not average out stays.
fn rounding(step_mm: f64, s_mm: f64) -> f64 {
    if step_mm <= 0.0 {
        return 0.0;
    }
    let own = (s_mm / step_mm).powi(2) - 1.0 / 12.0;
    step_mm / 12f64.sqrt() * (-2.0 * PI * PI * own.max(0.0)).exp()
}

fn refused(error: LinearError) -> IdentifyError {
    match error {
        LinearError::RankDeficient(survey) => IdentifyError::RankDeficient {
            rank: survey.rank,
            unknowns: survey.rank + survey.nullity,
            what: vec!["delay and drift: touch at both feeds in turns".to_owned()],
        },
        other => IdentifyError::Numerical(other.to_string()),
    }
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
