//! Identification: from plan and readings to the estimate.

use super::calibration;
use super::diagnosis::{Diagnosis, LayoutCheck, check_layout, clock_errors};
use super::layout::{Separation, noise_gains};
use super::model::Channel;
use super::observe::{Observed, observed};
use super::outputs::ReportedMotions;
use super::revolutions::revolution_values;
use super::settings::{Settings, TurnSampling};
use super::setup::Setup;
use super::sources::SourceSizes;
use super::{Separated, identify};
use crate::identification::declared::{drift_mm_per_s, linearity_of_revolutions};
use crate::identification::{MisfitAdvice, TrialPlan, numbered_values, order_values};
use crate::{IdentifyError, Refused};
use estimation::monte_carlo::Trials;
use estimation::revolutions::{HarmonicData, ResampleFilter, RevolutionsError, RowRevolutions};

use machine::record::estimate::{Estimate, Function, Unit};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x6d75_6c74;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
const MAX_TRIALS: usize = 20_000;

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "wrong angles, gains or heights of the sensors, a wrong index, a loose sensor, harmonics above the \
             highest",
    declared_by: "u_gain, u_sensor_angle_deg or u_index_angle_deg",
};

/// # Errors
/// The readings do not belong to the plan or do not separate motion and artefact; channels are swapped or have a
/// separate clock; all indexes from one on are wrong.
pub fn estimate(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let mut setup = Setup::new(plan, settings)?;
    let mut observed = observed(&setup, readings)?;
    if settings.sampling == TurnSampling::Continuous
        && let Some(fault) = clock_errors(&setup.layout, &observed.forward).into_iter().next()
    {
        return Err(refused(&fault));
    }
    // Turns in both directions cancel a constant drift rate. Other drift is part of their scatter.
    let net = if settings.both_directions { 0.0 } else { observed.revolution_s };
    let drift_mm_per_revolution = drift_mm_per_s(plan) * net;
    let linearity = Vec::new();
    let mut sizes = SourceSizes { settings, sensors: None, drift_mm_per_revolution, linearity };
    let index_warning = check_rows(&setup, &sizes, &mut observed)?;
    let data = harmonic_data(settings, &observed.rows)?;
    let calibration = calibration::calibrate(&setup.layout, settings, &data)?;
    calibration::correct_rows(&calibration, &mut observed.rows);
    calibration::correct_rows(&calibration, &mut observed.forward);
    calibration::correct_angles(&calibration, &mut setup.layout);
    sizes.sensors = Some(calibration.covariance.clone());
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let trials = TrialPlan { seed: MONTE_CARLO_SEED, trials };
    let (_, separated) = separate(&setup, &observed.rows, &sizes, Some(trials))?;
    let mut estimate = separated.identification.estimate(super::NAME);
    // The ranges come first, as tolerances are stated for them.
    let nonlinear = separated.identification.outputs.nonlinear.as_ref();
    estimate.parameters.rotate_right(nonlinear.map_or(0, |nonlinear| nonlinear.outputs.len()));
    let motions = ReportedMotions::new(&setup.layout, &separated.fit);
    let with_harmonics = motions.motions().filter(|(_, motion)| !motion.harmonics.is_empty());
    estimate.functions.extend(
        with_harmonics
            .map(|(_, motion)| separated.identification.spectrum(&motion, motions.solution())),
    );
    if settings.sampling == TurnSampling::Continuous {
        estimate.parameters.extend(revolution_values(&setup.layout, &motions, &observed.forward));
    }
    estimate.parameters.extend(calibration::parameters(&calibration, &setup.layout, settings));
    estimate.functions.extend(gain_functions(&setup));
    estimate.functions.push(separated.fit.residuals());
    estimate.functions.extend(stability(&setup, &observed.rows));
    let mut gauge = vec![motions.gauge.clone()];
    let is_resampled = settings.sampling == TurnSampling::Continuous;
    gauge.extend(is_resampled.then(|| ResampleFilter::new(settings.positions).to_string()));
    let mut not_identifiable = motions.not_identifiable();
    let positions = settings.positions;
    not_identifiable.extend((!is_resampled).then(|| {
        let half = positions / 2;
        format!("harmonics above {half}: an order k is not told from {positions} - k (the stops of a revolution)")
    }));
    Ok(Estimate {
        warnings: warnings(&observed, index_warning, &separated),
        gauge,
        not_identifiable,
        ..estimate.displaced_at(setup.reference_mm)
    })
}

fn harmonic_data(
    settings: &Settings,
    rows: &[RowRevolutions],
) -> Result<HarmonicData, RevolutionsError> {
    let directions = if settings.both_directions { 2 } else { 1 };
    let steady = |row: &RowRevolutions| row.without_drift(row.revolutions.len() / directions);
    HarmonicData::from_revolutions(&rows.iter().map(steady).collect::<Vec<_>>(), settings.harmonics)
}

/// Separates motion and artefact. `sizes`: without the linearity of the sensors, which depends on the rows.
fn separate(
    setup: &Setup<'_>,
    rows: &[RowRevolutions],
    sizes: &SourceSizes<'_>,
    trials: Option<TrialPlan>,
) -> Result<(HarmonicData, Separated), IdentifyError> {
    let data = harmonic_data(setup.settings, rows)?;
    let linearity = linearity_of_revolutions(&setup.plan.sensors, rows, &data);
    let sizes = SourceSizes { linearity, ..sizes.clone() };
    let separated = identify(&setup.layout, &data, &sizes, trials)?;
    Ok((data, separated))
}

/// Noise gains of the sensors of the first section, for each separation: standard uncertainty of a coefficient of
/// EXC if those of one sensor have 1 µm. Undetermined orders are omitted.
fn gain_functions(setup: &Setup<'_>) -> Vec<Function> {
    let layout = setup.layout.first_section();
    let separations = [
        ("gain_multiprobe", Separation::Multiprobe),
        ("gain_multistep", Separation::Multistep),
        ("gain_combined", Separation::Combined),
    ];
    let function = |(symbol, separation): (&str, Separation)| {
        let gains = noise_gains(&layout, separation, 2..=setup.settings.harmonics).ok()?;
        let kept = gains.into_iter().filter(|(_, gain)| gain.is_finite());
        let points: Vec<(f64, f64)> = kept.map(|(order, gain)| (order as f64, gain)).collect();
        (!points.is_empty()).then(|| order_values(symbol, Unit::Um, points.into_iter()))
    };
    separations.into_iter().filter_map(function).collect()
}

/// Mean of each revolution of each sensor, less that of its mounting, in the order of time.
fn stability(setup: &Setup<'_>, rows: &[RowRevolutions]) -> Vec<Function> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let of_row = |row: &RowRevolutions| {
        let each: Vec<f64> = row.revolutions.iter().map(|revolution| mean(revolution)).collect();
        each.iter().map(|own| own - mean(&each)).collect::<Vec<f64>>()
    };
    let of = |(number, channel): (usize, &Channel)| {
        let own = rows.iter().filter(|row| row.row.channel == number);
        numbered_values(&format!("stability_{}", channel.name), "revolution", own.flat_map(of_row))
    };
    setup.layout.channels.iter().enumerate().map(of).collect()
}

fn warnings(observed: &Observed, of_index: Option<String>, separated: &Separated) -> Vec<String> {
    let identification = &separated.identification;
    let mut lines = observed.left_out.clone();
    let missing = observed.missing_stops;
    lines.extend((missing > 0).then(|| {
        format!(
            "{missing} stops of a sensor have no distance: single ones are taken from the harmonics of their \
             revolution, revolutions with longer gaps are left out"
        )
    }));
    lines.extend(of_index);
    lines.extend(identification.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identification.trials_warning());
    lines
}

/// Corrects a single wrong index in the rows. Returns a warning on the indexes from the form of the artefact.
fn check_rows(
    setup: &Setup<'_>,
    sizes: &SourceSizes<'_>,
    observed: &mut Observed,
) -> Result<Option<String>, IdentifyError> {
    let (data, first) = separate(setup, &observed.rows, sizes, None)?;
    let dof = first.identification.figures.dof.max(1) as f64;
    let expected = first.identification.propagation.misfit.expected / dof;
    Ok(match check_layout(&setup.layout, &data, expected)? {
        LayoutCheck::Confirmed => None,
        LayoutCheck::NotConfirmed => Some(
            "the mountings are not confirmed: the artefact is too round for a wrong index to show"
                .to_owned(),
        ),
        LayoutCheck::Contradictory => Some(
            "the mountings contradict each other by more than is declared, and no single wrong index explains it: the \
             form of the artefact (RONt) may be wrong"
                .to_owned(),
        ),
        LayoutCheck::Wrong(
            fault @ Diagnosis::WrongIndex { first, is_from_here_on: false, .. },
        ) => {
            observed.rows.retain(|row| row.row.index != first);
            observed.forward.retain(|row| row.row.index != first);
            Some(format!("left out: {fault}"))
        }
        LayoutCheck::Wrong(fault) => return Err(refused(&fault)),
    })
}

fn refused(fault: &Diagnosis) -> IdentifyError {
    let instead = "correct the plan as named (trued identify --plan), or measure again";
    Refused::new(fault.to_string(), instead).into()
}
