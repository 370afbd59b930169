//! Identification: from plan and readings to the estimate.

use super::calibration;
use super::fault_diagnosis::{LayoutCheck, LayoutFault, check_layout, find_clock_errors};
use super::layout_prediction::{SeparationMethod, noise_gain_by_order};
use super::model::SensorChannel;
use super::observe::{ObservedRevolutions, observe_revolutions};
use super::outputs::ReportedMotions;
use super::settings::{MultiprobeSettings, TurnSampling};
use super::setup::MultiprobeSetup;
use super::sources::SourceSizes;
use super::total_and_asynchronous::total_and_asynchronous_values;
use super::{SeparatedMotions, identify_motions};
use crate::identification::declared_sources::{drift_rate_sd_mm_per_s, linearity_effects_on_harmonics};
use crate::identification::{MisfitAdvice, TrialSettings, function_of_numbered_values, function_over_harmonic_orders};
use crate::{IdentifyError, MethodRefusal};
use estimation::revolutions::{ChannelRevolutions, HarmonicData, ResampleFilter, RevolutionsError};

use machine::record::estimate::{Estimate, EstimatedFunction, Unit};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x6d75_6c74;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_U_DIGITS: u32 = 1;
/// Maximum number of trials of the adaptive rule (`monte_carlo_trials` = 0).
const MAX_MONTE_CARLO_TRIALS: usize = 20_000;

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "wrong angles, gains or heights of the sensors, a wrong index, a loose sensor, \
             harmonics above the highest fitted one",
    declaring_settings: "u_gain, u_sensor_angle_deg or u_index_angle_deg",
};

/// Identifies the error motions.
///
/// # Errors
/// The readings do not belong to the plan or do not separate motion and artefact; channels are swapped or have a
/// separate clock; the artefact was turned in the opposite direction; the index angles of one mounting and all later
/// ones are wrong. A single wrong mounting is no error: it is left out with a warning.
pub fn build_estimate(
    plan: &Plan,
    settings: &MultiprobeSettings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let mut setup = MultiprobeSetup::new(plan, settings)?;
    let mut observed = observe_revolutions(&setup, readings)?;
    if settings.sampling == TurnSampling::Continuous
        && let Some(fault) = find_clock_errors(&setup.layout, &observed.forward_rows).into_iter().next()
    {
        return Err(refuse_fault(&fault));
    }
    // Turns in both directions cancel a constant drift rate. A drift rate that changes is part of the scatter of the
    // turns.
    let drift_duration_s = if settings.both_directions { 0.0 } else { observed.forward_revolution_duration_s };
    let drift_mm_per_revolution = drift_rate_sd_mm_per_s(plan) * drift_duration_s;
    let linearity_effects = Vec::new();
    let mut sizes = SourceSizes {
        settings,
        sensor_covariance: None,
        u_drift_mm_per_revolution: drift_mm_per_revolution,
        linearity_effects,
    };
    let index_warning = check_and_remove_wrong_mounting(&setup, &sizes, &mut observed)?;
    let data = harmonic_data(settings, &observed.all_rows)?;
    let calibration = calibration::calibrate_layout_sensors(&setup.layout, settings, &data)?;
    calibration::correct_row_gains(&calibration, &mut observed.all_rows);
    calibration::correct_row_gains(&calibration, &mut observed.forward_rows);
    calibration::correct_channel_angles(&calibration, &mut setup.layout);
    sizes.sensor_covariance = Some(calibration.covariance.clone());
    let trials =
        TrialSettings::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_U_DIGITS, MAX_MONTE_CARLO_TRIALS);
    let (_, separated) = separate_motions(&setup, &observed.all_rows, &sizes, Some(trials))?;
    let mut estimate = separated.identification.estimate(super::METHOD_NAME);
    // The ranges come first, as tolerances are stated for them.
    let nonlinear = separated.identification.outputs.nonlinear.as_ref();
    estimate.parameters.rotate_right(nonlinear.map_or(0, |nonlinear| nonlinear.outputs.len()));
    let motions = ReportedMotions::new(&setup.layout, &separated.fit);
    let with_harmonics = motions.error_motions().filter(|(_, motion)| !motion.harmonics.is_empty());
    let spectra = with_harmonics.map(|(_, motion)| separated.identification.spectrum(&motion, motions.solution()));
    estimate.functions.extend(spectra);
    if settings.sampling == TurnSampling::Continuous {
        estimate.parameters.extend(total_and_asynchronous_values(&setup.layout, &motions, &observed.forward_rows));
    }
    estimate.parameters.extend(calibration::calibration_parameters(&calibration, &setup.layout, settings));
    estimate.functions.extend(noise_gain_functions(&setup));
    estimate.functions.push(separated.fit.residual_rms_by_order());
    estimate.functions.extend(sensor_stability_functions(&setup, &observed.all_rows));
    let mut gauge = vec![motions.gauge_text.clone()];
    let is_resampled = settings.sampling == TurnSampling::Continuous;
    gauge.extend(is_resampled.then(|| ResampleFilter::new(settings.positions).to_string()));
    let mut not_identifiable = motions.describe_not_identifiable();
    not_identifiable.extend((!is_resampled).then(|| describe_aliased_harmonics(settings.positions)));
    Ok(Estimate {
        warnings: estimate_warnings(&observed, index_warning, &separated),
        gauge,
        not_identifiable,
        ..estimate.with_displacement_point(setup.reference_point_mm)
    })
}

/// The harmonics that the stops of a revolution do not separate.
fn describe_aliased_harmonics(positions: usize) -> String {
    let half = positions / 2;
    format!(
        "harmonics above {half}: an order k is inseparable from {positions} - k ({positions} stops per \
         revolution)"
    )
}

/// Harmonics of the rows after removal of a drift that is linear in time, up to the setting `harmonics`.
fn harmonic_data(settings: &MultiprobeSettings, rows: &[ChannelRevolutions]) -> Result<HarmonicData, RevolutionsError> {
    let directions = if settings.both_directions { 2 } else { 1 };
    let without_drift = |row: &ChannelRevolutions| row.without_linear_drift(row.revolutions.len() / directions);
    HarmonicData::from_revolutions(&rows.iter().map(without_drift).collect::<Vec<_>>(), settings.harmonics)
}

/// Separates motion and artefact. `sizes.linearity_effects` is ignored and computed from `rows`.
fn separate_motions(
    setup: &MultiprobeSetup<'_>,
    rows: &[ChannelRevolutions],
    sizes: &SourceSizes<'_>,
    trials: Option<TrialSettings>,
) -> Result<(HarmonicData, SeparatedMotions), IdentifyError> {
    let data = harmonic_data(setup.settings, rows)?;
    let linearity_effects = linearity_effects_on_harmonics(&setup.plan.sensors, rows, &data);
    let sizes = SourceSizes { linearity_effects, ..sizes.clone() };
    let separated = identify_motions(&setup.layout, &data, &sizes, trials)?;
    Ok((data, separated))
}

/// Noise gains of the sensors of the first section, for each separation method: standard uncertainty of a coefficient
/// of EXC if the coefficients of one sensor have a standard uncertainty of 1 µm. Undetermined orders are omitted.
fn noise_gain_functions(setup: &MultiprobeSetup<'_>) -> Vec<EstimatedFunction> {
    let layout = setup.layout.reduced_to_first_section();
    let separations = [
        ("gain_multiprobe", SeparationMethod::Multiprobe),
        ("gain_multistep", SeparationMethod::Multistep),
        ("gain_combined", SeparationMethod::Combined),
    ];
    let function = |(symbol, separation): (&str, SeparationMethod)| {
        let gains = noise_gain_by_order(&layout, separation, 2..=setup.settings.harmonics).ok()?;
        let kept = gains.into_iter().filter(|(_, gain)| gain.is_finite());
        let points: Vec<(f64, f64)> = kept.map(|(order, gain)| (order as f64, gain)).collect();
        (!points.is_empty()).then(|| function_over_harmonic_orders(symbol, Unit::Um, points.into_iter()))
    };
    separations.into_iter().filter_map(function).collect()
}

/// One function per sensor: mean of each revolution minus the mean of the sensor over that mounting, in the order of
/// time.
fn sensor_stability_functions(setup: &MultiprobeSetup<'_>, rows: &[ChannelRevolutions]) -> Vec<EstimatedFunction> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let of_row = |row: &ChannelRevolutions| {
        let each: Vec<f64> = row.revolutions.iter().map(|revolution| mean(revolution)).collect();
        each.iter().map(|own| own - mean(&each)).collect::<Vec<f64>>()
    };
    let function = |(number, channel): (usize, &SensorChannel)| {
        let own = rows.iter().filter(|row| row.key.channel_index == number);
        function_of_numbered_values(&format!("stability_{}", channel.name), "revolution", own.flat_map(of_row))
    };
    setup.layout.channels.iter().enumerate().map(function).collect()
}

fn estimate_warnings(
    observed: &ObservedRevolutions,
    index_warning: Option<String>,
    separated: &SeparatedMotions,
) -> Vec<String> {
    let identification = &separated.identification;
    let mut lines = observed.omission_descriptions.clone();
    let missing = observed.channel_stops_without_distance_count;
    lines.extend((missing > 0).then(|| {
        format!(
            "{missing} stops of a sensor have no distance: single stops are interpolated from the \
             harmonics of their revolution, revolutions with longer gaps are not used"
        )
    }));
    lines.extend(index_warning);
    lines.extend(identification.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identification.trial_contradiction_warning());
    lines
}

/// Checks the mountings by the form of the artefact, and removes the rows of a single wrong mounting. Returns a
/// warning: mounting removed, not verifiable or contradictory. Any other fault is an error.
fn check_and_remove_wrong_mounting(
    setup: &MultiprobeSetup<'_>,
    sizes: &SourceSizes<'_>,
    observed: &mut ObservedRevolutions,
) -> Result<Option<String>, IdentifyError> {
    let (data, first) = separate_motions(setup, &observed.all_rows, sizes, None)?;
    let dof = first.identification.fit_quality.dof.max(1) as f64;
    let expected = first.identification.propagation.misfit.expected_chi2 / dof;
    Ok(match check_layout(&setup.layout, &data, expected)? {
        LayoutCheck::Confirmed => None,
        LayoutCheck::NotVerifiable => {
            Some("the index angles are not verifiable: the artefact is too round to detect a wrong index".to_owned())
        }
        LayoutCheck::Contradictory => Some(
            "the mountings contradict each other by more than the declared uncertainties, and no \
             single wrong index explains the difference: the form of the artefact (RONt) may be \
             wrong"
                .to_owned(),
        ),
        LayoutCheck::Faulty(
            fault @ LayoutFault::WrongIndexAngle { first_index, affects_later_mountings: false, .. },
        ) => {
            observed.all_rows.retain(|row| row.key.mounting_index != first_index);
            observed.forward_rows.retain(|row| row.key.mounting_index != first_index);
            Some(format!("not used: {fault}"))
        }
        LayoutCheck::Faulty(fault) => return Err(refuse_fault(&fault)),
    })
}

fn refuse_fault(fault: &LayoutFault) -> IdentifyError {
    let instead = "correct the plan as stated (trued identify --plan), or measure again";
    MethodRefusal::new(fault.to_string(), instead).into()
}
