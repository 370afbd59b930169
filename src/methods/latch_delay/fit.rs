//! Fit of the line of position over feed, with drift. Each feed has its own scatter.

use faer::Mat;

use super::observe::{ObservedTouch, ObservedTouches};
use super::outputs;
use crate::identification::declared_sources::rounding_u_of_mean_mm;
use crate::identification::{
    EvaluationType, FitQuality, Identification, ObservationEffect, ResidualTreatment, SolvedLinearFit, SolvedModel,
    Uncertainty, UncertaintySource, identify, slope_of_unknown,
};
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::{self, LinearProblem, LinearSolution, RANK_THRESHOLD};

/// Number of iterations: weights from the scatter, scatter from the residuals. Scatter and weights converge within this
/// number.
const FIT_ITERATIONS: usize = 5;

/// Part of the error message for unsolvable equations.
const INSEPARABLE_UNKNOWNS_TEXT: &str = "delay and drift (alternate the two feeds from touch to touch)";

/// Scatter of the touches at one feed.
#[derive(Debug, Clone, Copy)]
pub struct FeedScatter {
    /// Experimental standard deviation of one touch about the fit, mm; at least resolution/√12.
    pub std_dev_mm: f64,
    /// Sum of 1 − h over the touches at this feed, with h the diagonal of the hat matrix; not an integer.
    pub dof: f64,
}

/// Fit of the contact distance: position of the segment + delay · speed + drift · time. A segment is the time between
/// two interruptions.
pub struct FittedDelay {
    pub identification: Identification,
    /// Latch delay, s, positive if the latch is late.
    pub delay_s: f64,
    /// Uncertainty of the delay, s.
    pub delay_uncertainty: Uncertainty,
    /// Scatter at the slow and at the fast feed.
    pub scatter_by_feed: [FeedScatter; 2],
    /// Drift of the contact distance, mm/s, positive farther along the touch. Per touch instead of per second if the
    /// readings have no times.
    pub drift_mm_s: f64,
    /// Contact distance of each touch minus fitted position and drift, mm: delay · speed + residual.
    pub overtravel_of_touches_mm: Vec<f64>,
}

/// Fits the delay and the drift.
///
/// # Errors
/// The touches do not separate delay and drift, or they do not scatter at all and no resolution of the axes is
/// declared.
pub fn fit_delay(observed: &ObservedTouches) -> Result<FittedDelay, IdentifyError> {
    let touches = &observed.touches;
    let [middle_s, half_span_s] = time_middle_and_half_span_s(touches);
    let speeds = observed.speeds_mm_s();
    // Unknowns: the position in each segment, mm; the delay, s; half of the total drift, mm.
    let delay = touches.iter().map(|touch| touch.earlier_interruption_count).max().unwrap_or(0) + 1;
    let a = Mat::from_fn(touches.len(), delay + 2, |i, j| match j {
        _ if j < delay => f64::from(u8::from(touches[i].earlier_interruption_count == j)),
        _ if j == delay => speeds[touches[i].feed_index],
        _ => (touches[i].time_in_run_s_or_order - middle_s) / half_span_s,
    });
    let (solution, scatter) = iterate_weights(observed, &a)?;
    let LinearSolution { x, gain, residuals, .. } = &solution;
    let sigma = touch_std_devs_mm(touches, scatter);
    let weighted: Vec<f64> = residuals.iter().zip(&sigma).map(|(r, sigma)| r / sigma).collect();
    let solved = SolvedModel {
        model: &SolvedLinearFit { x, design_matrix: &a, sigma: &sigma, gain },
        weighted_residuals: &weighted,
        has_declared_source_sizes: true,
        fit_quality: FitQuality::from_linear(&solution),
        measurements: &[],
    };
    let slope = slope_of_unknown(delay, x.len());
    let outputs = outputs::build_outputs(observed, x, &slope);
    let identification = identify(&solved, &uncertainty_sources(observed, scatter, &slope), outputs, None)?;
    let overtravel_mm = residuals.iter().zip(touches).map(|(r, touch)| r + x[delay] * speeds[touch.feed_index]);
    Ok(FittedDelay {
        delay_s: x[delay],
        delay_uncertainty: identification.propagation.output_uncertainty(&slope),
        identification,
        scatter_by_feed: scatter,
        drift_mm_s: x[delay + 1] / half_span_s,
        overtravel_of_touches_mm: overtravel_mm.collect(),
    })
}

/// Iterates weights from the scatter and scatter from the residuals, from equal weights on.
///
/// # Errors
/// The equations are rank deficient, or all touches at one feed are identical and no resolution is declared.
fn iterate_weights(
    observed: &ObservedTouches,
    a: &Mat<f64>,
) -> Result<(LinearSolution, [FeedScatter; 2]), IdentifyError> {
    let touches = &observed.touches;
    let y: Vec<f64> =
        touches.iter().map(|touch| touch.contact_distance_mm - observed.mean_contact_distance_mm).collect();
    let min_mm = observed.resolution_mm / 12f64.sqrt();
    let mut scatter = [FeedScatter { std_dev_mm: 1e-3, dof: 0.0 }; 2];
    let mut solved = None;
    for _ in 0..FIT_ITERATIONS {
        let problem = LinearProblem {
            a: a.as_ref(),
            y: &y,
            sigma: &touch_std_devs_mm(touches, scatter),
            constraints: None,
            rank_threshold: RANK_THRESHOLD,
        };
        let solution = linear_least_squares::solve_least_squares(&problem)
            .map_err(|error| IdentifyError::from_solver_error(error, |_| vec![INSEPARABLE_UNKNOWNS_TEXT.to_owned()]))?;
        scatter = [0, 1].map(|feed| scatter_at_feed(touches, a, &solution, feed, min_mm));
        if let Some(feed) = (0..2).find(|feed| scatter[*feed].std_dev_mm <= 0.0) {
            return Err(identical_touches_error(observed.feeds_mm_min[feed]));
        }
        solved = Some(solution);
    }
    let solution = solved.ok_or_else(|| IdentifyError::IdentificationFailed("nothing to fit".to_owned()))?;
    Ok((solution, scatter))
}

fn touch_std_devs_mm(touches: &[ObservedTouch], scatter: [FeedScatter; 2]) -> Vec<f64> {
    touches.iter().map(|touch| scatter[touch.feed_index].std_dev_mm).collect()
}

/// Sources: the scatter at each feed, and the part of the display resolution that does not average out, as an effect on
/// the delay itself. `delay_slope`: derivative of the delay by the unknowns. χ² tests none of the sources, as the sizes
/// already follow from the residuals.
fn uncertainty_sources(
    observed: &ObservedTouches,
    scatter: [FeedScatter; 2],
    delay_slope: &[f64],
) -> [UncertaintySource; 3] {
    let feed_source = |feed: usize| {
        let FeedScatter { std_dev_mm, dof } = scatter[feed];
        let size = |touch: &ObservedTouch| if touch.feed_index == feed { std_dev_mm } else { 0.0 };
        let each = ObservationEffect::Independent(observed.touches.iter().map(size).collect());
        let name = format!("scatter at {} mm/min", observed.feeds_mm_min[feed]);
        let evaluation = EvaluationType::A;
        UncertaintySource { evaluation, dof, ..UncertaintySource::new(name, each) }
    };
    let [slow, fast] = observed.speeds_mm_s();
    let steps: f64 = scatter.iter().map(|s| rounding_u_of_mean_mm(observed.resolution_mm, s.std_dev_mm).powi(2)).sum();
    let u_s = steps.sqrt() / (fast - slow);
    let resolution = UncertaintySource {
        direct_unknown_changes: vec![delay_slope.iter().map(|slope| slope * u_s).collect()],
        ..UncertaintySource::new("resolution", ObservationEffect::Joint(vec![Vec::new()]))
    };
    [feed_source(0), feed_source(1), resolution]
        .map(|source| UncertaintySource { residual_treatment: ResidualTreatment::ExcludedFromChi2, ..source })
}

/// Middle and half of the time span of the touches, s; in touch numbers if the readings have no times. The half span is
/// 1 if all times are equal.
fn time_middle_and_half_span_s(touches: &[ObservedTouch]) -> [f64; 2] {
    let times = || touches.iter().map(|touch| touch.time_in_run_s_or_order);
    let first = times().fold(f64::INFINITY, f64::min);
    let last = times().fold(f64::NEG_INFINITY, f64::max);
    [(first + last) / 2.0, if last > first { (last - first) / 2.0 } else { 1.0 }]
}

/// Standard deviation (at least `min_std_dev_mm`) and degrees of freedom at one feed. Degrees of freedom: sum of 1 −
/// h, with h the diagonal of the hat matrix. Variance: sum of the squared residuals over the degrees of freedom.
fn scatter_at_feed(
    touches: &[ObservedTouch],
    a: &Mat<f64>,
    solution: &LinearSolution,
    feed_index: usize,
    min_std_dev_mm: f64,
) -> FeedScatter {
    let (mut squares, mut dof) = (0.0, 0.0);
    for i in (0..touches.len()).filter(|i| touches[*i].feed_index == feed_index) {
        let hat: f64 = (0..a.ncols()).map(|k| a[(i, k)] * solution.gain[(k, i)]).sum();
        squares += solution.residuals[i].powi(2);
        dof += 1.0 - hat;
    }
    let std_dev_mm = if dof > 0.0 { (squares / dof).sqrt() } else { f64::NAN };
    FeedScatter { std_dev_mm: std_dev_mm.max(min_std_dev_mm), dof }
}

fn identical_touches_error(feed_mm_min: f64) -> IdentifyError {
    MethodRefusal::new(
        format!(
            "all touches at {feed_mm_min} mm/min have identical positions, and no display \
             resolution is declared"
        ),
        "state resolution_um of the axes; if the positions are still identical, check the \
                  latch of the control: it does not record the position of the machine",
    )
    .into()
}
