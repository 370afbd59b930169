//! Check before a long measurement that the machine is at rest: one ball is measured repeatedly.

use estimation::coverage::coverage_factor;
use nalgebra::Vector3;

use super::found_balls::group_readings_by_measurement;
use super::setup::MeasurementSetup;
use super::stage_review::continuation_advice;
use super::touch_label::{MeasurementPurpose, touch_steps_with_labels};
use crate::MethodRefusal;
use crate::identification::declared_sources::drift_rate_sd_mm_per_s;
use machine::record::reading::Reading;

/// Minimum number of rounds for the creep rate and its scatter.
const MIN_REST_CHECK_ROUNDS: usize = 5;
/// Maximum duration of the rest check, as a multiple of `min_rest_check_s`; if the machine is still not confirmed at
/// rest then, the run is held.
const MAX_REST_CHECK_DURATION_RATIO: f64 = 6.0;

/// Creep rate of the ball along one axis of the table frame.
#[derive(Debug, Clone, Copy)]
struct Creep {
    axis: char,
    rate_mm_per_s: f64,
    /// Expanded uncertainty of the creep rate, mm/s, from the scatter of the rounds about the line.
    rate_expanded_uncertainty_mm_per_s: f64,
}

/// Whether another round is needed: the requested duration or [`MIN_REST_CHECK_ROUNDS`] is not reached, or neither
/// the rounds of the last `min_rest_check_s` nor all rounds show rates and their U of at most twice the declared
/// drift rate. `false` without a rest check and after the first slow touches are planned.
///
/// # Errors
/// The machine still creeps after [`MAX_REST_CHECK_DURATION_RATIO`] times the requested duration. In a resumed run
/// the check begins again: rounds before the interruption do not count.
pub fn needs_rest_check_round(setup: &MeasurementSetup<'_>, readings: &[Reading]) -> Result<bool, MethodRefusal> {
    let min_rest_check_s = setup.touch_settings.min_rest_check_s;
    // The rest check ends when the measurement begins, also for a resumed run.
    if min_rest_check_s <= 0.0 || has_measurement_begun(setup) {
        return Ok(false);
    }
    let resumed_s = setup.plan.interruption_times_s.last().copied().unwrap_or(f64::NEG_INFINITY);
    let rounds = rest_check_round_times_and_centres(setup, readings, resumed_s);
    let (Some((first_s, _)), Some((last_s, _))) = (rounds.first(), rounds.last()) else {
        return Ok(true);
    };
    let rest_check_s = last_s - first_s;
    if rest_check_s < min_rest_check_s || rounds.len() < MIN_REST_CHECK_ROUNDS {
        return Ok(true);
    }
    let older = rounds.partition_point(|(t_s, _)| last_s - t_s > min_rest_check_s);
    let newest = &rounds[older.min(rounds.len() - MIN_REST_CHECK_ROUNDS)..];
    // The declared rate is a standard deviation; k = 2.
    let allowed = 2.0 * drift_rate_sd_mm_per_s(setup.plan);
    // If the uncertainty of the rate exceeds the limit, the machine is not confirmed at rest. All rounds together give
    // a smaller uncertainty than the newest rounds.
    let may_creep =
        |creep: &Creep| creep.rate_mm_per_s.abs() > allowed || creep.rate_expanded_uncertainty_mm_per_s > allowed;
    let creeping = |rounds: &[(f64, Vector3<f64>)]| fit_creep(rounds).into_iter().find(may_creep);
    let (Some(creep), Some(_)) = (creeping(newest), creeping(&rounds)) else { return Ok(false) };
    let um_per_h = |mm_per_s: f64| mm_per_s * 1e3 * 3600.0;
    MethodRefusal::require(
        rest_check_s < MAX_REST_CHECK_DURATION_RATIO * min_rest_check_s,
        format!(
            "the machine is not confirmed at rest: after {:.0} min the ball creeps by ({:.1} ± {:.1}) µm/h \
            along {}, and the limit from drift_um_per_h is {:.1} µm/h",
            rest_check_s / 60.0,
            um_per_h(creep.rate_mm_per_s),
            um_per_h(creep.rate_expanded_uncertainty_mm_per_s),
            creep.axis,
            um_per_h(allowed)
        ),
        format!(
            "let the machine warm up or cool down, {}. If ± exceeds the limit, raise watch_min; if the \
            creep cannot be avoided, raise drift_um_per_h of [machine]",
            continuation_advice(setup)
        ),
    )?;
    Ok(true)
}

/// Whether the plan already has slow touches of the measurement (not of references or the rest check).
fn has_measurement_begun(setup: &MeasurementSetup<'_>) -> bool {
    touch_steps_with_labels(setup.plan).any(|(_, label)| label.purpose == MeasurementPurpose::Slow)
}

/// Mean time of the touches, s, and centre, table frame, mm, of each round since the run was resumed; rounds without
/// a fitted sphere are left out.
fn rest_check_round_times_and_centres(
    setup: &MeasurementSetup<'_>,
    readings: &[Reading],
    resumed_s: f64,
) -> Vec<(f64, Vector3<f64>)> {
    let all = group_readings_by_measurement(setup, readings);
    let rest_check_measurements =
        all.iter().filter(|measurement| measurement.label.purpose == MeasurementPurpose::RestCheck);
    let round = rest_check_measurements.filter_map(|measurement| {
        let measured = measurement.fit_ball(setup)?.ok()?;
        let times = measurement.readings.iter().map(|reading| reading.t_s);
        Some((times.sum::<f64>() / measurement.readings.len() as f64, measured.centre_in_table_mm))
    });
    round.filter(|(t_s, _)| *t_s > resumed_s).collect()
}

/// Fits a straight line through the rounds of each axis; its slope is the creep rate.
fn fit_creep(rounds: &[(f64, Vector3<f64>)]) -> [Creep; 3] {
    let count = rounds.len() as f64;
    let middle_s = rounds.iter().map(|(t_s, _)| t_s).sum::<f64>() / count;
    let mean = rounds.iter().map(|(_, at)| at).sum::<Vector3<f64>>() / count;
    let square: f64 = rounds.iter().map(|(t_s, _)| (t_s - middle_s).powi(2)).sum();
    let rate = rounds.iter().map(|(t_s, at)| (at - mean) * (t_s - middle_s)).sum::<Vector3<f64>>() / square;
    let left = |(t_s, at): &(f64, Vector3<f64>)| (at - mean - rate * (t_s - middle_s)).map(|d| d * d);
    let variance = rounds.iter().map(left).sum::<Vector3<f64>>() / (count - 2.0);
    [(0, 'X'), (1, 'Y'), (2, 'Z')].map(|(k, axis)| Creep {
        axis,
        rate_mm_per_s: rate[k],
        rate_expanded_uncertainty_mm_per_s: coverage_factor(count - 2.0) * (variance[k] / square).sqrt(),
    })
}
