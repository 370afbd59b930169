//! Faults of channels and mountings that the data reveal: swapped channels, wrong or mirrored indexes, a channel whose
//! clock is wrong.

use std::f64::consts::TAU;

use estimation::coverage::chi_square_bounds;
use estimation::revolutions::{ChannelAtMounting, ChannelRevolutions, HarmonicData, estimate_clock_rate_error};

use super::fit::SeparationFit;
use super::model::ProbeLayout;
use crate::IdentifyError;

/// A correction is accepted if it reduces χ² to less than this fraction of the uncorrected value.
const MAX_CORRECTED_CHI2_RATIO: f64 = 0.1;
/// Probability that χ² of a correct layout is within its two-sided bounds. Only the upper bound is used.
const CHI2_BOUNDS_PROBABILITY: f64 = 0.998;
/// The index angles count as verifiable if a shift of any index by 360° divided by the number of mountings would
/// increase χ² by more than this value times the expected χ² per degree of freedom (at least 1).
const VERIFIABLE_INDEX_CHI2_INCREASE: f64 = 25.0;
/// Step of the second search for the index offset, near the best offset of the first search. The first search uses
/// steps of a quarter of the period of the highest harmonic.
const FINE_INDEX_OFFSET_STEP_DEG: f64 = 0.1;

/// Fault of the layout or of a channel that explains the data.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LayoutFault {
    /// The two channels of these names are swapped.
    #[error("channels {0} and {1} are swapped: exchange their plugs or their names")]
    SwappedChannels(String, String),
    /// The artefact was mounted at its planned angle plus `offset_deg` (counter-clockwise seen from +Z) at the
    /// mounting `first_index`, from 0; also at all later ones if `affects_later_mountings`.
    #[error(
        "the artefact was mounted {offset_deg:.1}° from its planned angle at mounting {}{}; correct \
         turn_deg, or measure {} again",
        .first_index + 1,
        if *.affects_later_mountings { " and all later mountings" } else { "" },
        if *.affects_later_mountings { "these mountings" } else { "this mounting" }
    )]
    WrongIndexAngle { first_index: usize, affects_later_mountings: bool, offset_deg: f64 },
    /// The artefact was turned in the opposite direction at each mounting.
    #[error(
        "the artefact was turned in the opposite direction at each mounting (clockwise seen from \
         its tip): correct turn_deg, or measure again"
    )]
    MirroredIndexAngles,
    /// The rate of this channel's clock deviates by `relative_error` (0.01 = 1 %), positive if the clock is fast.
    #[error("the clock of channel {channel} is {:.2} % fast: correct this clock, and measure \
             again", .relative_error * 100.0)]
    ClockError { channel: String, relative_error: f64 },
}

/// Result of the check of the layout against the data.
#[derive(Debug, Clone, PartialEq)]
pub enum LayoutCheck {
    /// No fault was found. A single mounting without an explained fault is also confirmed, even if χ² is implausible.
    Confirmed,
    /// χ² is plausible, but the artefact is too round: a wrong index would not be detected.
    NotVerifiable,
    /// χ² is implausible, and this fault explains more than 90 % of it.
    Faulty(LayoutFault),
    /// The mountings differ by more than declared, and no wrong index explains the difference.
    Contradictory,
}

/// Whether χ² is not above its upper bound, or there are no degrees of freedom for a bound. `expected_chi2_ratio`: χ²
/// divided by its degrees of freedom if all sources are as declared, 1 for noise alone.
fn is_chi2_plausible(chi2: f64, dof: usize, expected_chi2_ratio: f64, data: &HarmonicData) -> bool {
    // The scatter in the weights is itself estimated: the mean of 1/s² is larger than 1/σ².
    let of_scatter = data.harmonic_scatters.iter().map(|scatter| scatter.dof).fold(f64::INFINITY, f64::min);
    let expected = expected_chi2_ratio.max(1.0) / (1.0 - (2.0 / of_scatter).min(0.9));
    chi_square_bounds(dof as f64, CHI2_BOUNDS_PROBABILITY).is_none_or(|(_, upper)| chi2 <= upper * expected)
}

/// Checks channels and mounting angles against the form of the artefact. Searches for one change of the layout that
/// explains the residuals: two exchanged channels, all mountings turned in the opposite direction, one wrong index,
/// or the same index error at one mounting and all later ones. Without redundancy (one index, three sensors per
/// section) nothing is found. `expected_chi2_ratio`: χ² divided by its degrees of freedom if all sources are as
/// declared.
///
/// # Errors
/// The errors of [`SeparationFit::new`].
pub fn check_layout(
    layout: &ProbeLayout,
    data: &HarmonicData,
    expected_chi2_ratio: f64,
) -> Result<LayoutCheck, IdentifyError> {
    let fit = SeparationFit::new(layout, data)?;
    let (planned_chi2, dof) = fit.chi2_and_dof();
    let indexes = layout.index_angles_rad.len();
    if is_chi2_plausible(planned_chi2, dof, expected_chi2_ratio, data) {
        let least = VERIFIABLE_INDEX_CHI2_INCREASE * expected_chi2_ratio.max(1.0);
        let is_verifiable = (0..indexes).all(|n| chi2_increase_of_index_shift(layout, data, &fit, n) > least);
        let is_confirmed = indexes < 2 || is_verifiable;
        return Ok(if is_confirmed { LayoutCheck::Confirmed } else { LayoutCheck::NotVerifiable });
    }
    let mut explained = Vec::new();
    for (changed, diagnosis) in candidate_faulty_layouts(layout) {
        explained.push((SeparationFit::new(&changed, data)?.chi2_and_dof().0, diagnosis));
    }
    for (first, affects_later_mountings) in (0..indexes).flat_map(|n| [(n, false), (n, true)]) {
        let is_moved = |row: &ChannelAtMounting| {
            row.mounting_index == first || affects_later_mountings && row.mounting_index > first
        };
        if let Some((sum, offset_rad)) = least_chi2_and_index_offset_rad(layout, data, is_moved)? {
            let offset_deg = offset_rad.to_degrees();
            explained
                .push((sum, LayoutFault::WrongIndexAngle { first_index: first, affects_later_mountings, offset_deg }));
        }
    }
    let best = explained.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    Ok(match best.filter(|(sum, _)| *sum < planned_chi2 * MAX_CORRECTED_CHI2_RATIO) {
        Some((_, diagnosis)) => LayoutCheck::Faulty(diagnosis),
        None if indexes < 2 => LayoutCheck::Confirmed,
        None => LayoutCheck::Contradictory,
    })
}

/// Layouts with one fault each: every pair of channels exchanged, and all mountings turned in the opposite direction.
fn candidate_faulty_layouts(layout: &ProbeLayout) -> Vec<(ProbeLayout, LayoutFault)> {
    let channels = layout.channels.len();
    let pairs = (1..channels).flat_map(|second| (0..second).map(move |first| (first, second)));
    let swapped = pairs.map(|(first, second)| {
        let mut changed = layout.clone();
        changed.channels.swap(first, second);
        let [name, other_name] = [first, second].map(|i| layout.channels[i].name.clone());
        (changed, LayoutFault::SwappedChannels(name, other_name))
    });
    let mut mirrored = layout.clone();
    mirrored.index_angles_rad.iter_mut().for_each(|angle| *angle = -*angle);
    swapped.chain([(mirrored, LayoutFault::MirroredIndexAngles)]).collect()
}

/// Increase of χ² if the mounting number `index`, from 0, is turned by 360° divided by the number of mountings.
fn chi2_increase_of_index_shift(layout: &ProbeLayout, data: &HarmonicData, fit: &SeparationFit, index: usize) -> f64 {
    let mut shifted = layout.clone();
    shifted.index_angles_rad[index] += TAU / layout.index_angles_rad.len() as f64;
    fit.difference_chi2(&shifted, data, &fit.predicted_observations(layout, &data.row_keys))
}

/// Smallest χ² of all rows, and the index offset of the moved rows at which χ² is smallest, rad. Motions and form are
/// fitted to the other rows. `None`: there is no moved row, or there are fewer than two other indexes.
fn least_chi2_and_index_offset_rad(
    layout: &ProbeLayout,
    data: &HarmonicData,
    is_moved: impl Fn(&ChannelAtMounting) -> bool,
) -> Result<Option<(f64, f64)>, IdentifyError> {
    let kept = data.filter_rows(|row| !is_moved(row));
    let moved = data.filter_rows(&is_moved);
    let is_single = kept.row_keys.iter().all(|row| row.mounting_index == kept.row_keys[0].mounting_index);
    if kept.row_keys.is_empty() || moved.row_keys.is_empty() || is_single {
        return Ok(None);
    }
    let fit = SeparationFit::new(layout, &kept)?;
    let (kept_chi2, _) = fit.chi2_and_dof();
    let observed: Vec<f64> = (1..=data.max_order()).flat_map(|k| moved.observations(k)).collect();
    let coarse = 4 * data.max_order() as i32;
    let coarse_deg = 360.0 / f64::from(coarse);
    let candidate = |deg: f64| {
        let offset = deg.to_radians();
        let mut turned = layout.clone();
        turned.index_angles_rad.iter_mut().for_each(|angle| *angle += offset);
        (kept_chi2 + fit.difference_chi2(&turned, &moved, &observed), offset)
    };
    let least = |a: &(f64, f64), b: &(f64, f64)| a.0.total_cmp(&b.0);
    let offsets = (-coarse / 2..coarse / 2).map(|i| f64::from(i) * coarse_deg);
    let Some((_, best_coarse)) = offsets.map(candidate).min_by(least) else { return Ok(None) };
    let fine = (coarse_deg / FINE_INDEX_OFFSET_STEP_DEG).ceil() as i32;
    let offsets = (-fine..=fine).map(|i| best_coarse.to_degrees() + f64::from(i) * FINE_INDEX_OFFSET_STEP_DEG);
    Ok(offsets.map(candidate).min_by(least))
}

/// One fault for each channel whose pattern shifts from revolution to revolution. The revolutions of a row are
/// consecutive and in the same direction.
pub fn find_clock_errors(layout: &ProbeLayout, measured: &[ChannelRevolutions]) -> Vec<LayoutFault> {
    let channels = layout.channels.iter().enumerate();
    let diagnosis = |(i, channel): (usize, &super::model::SensorChannel)| {
        let relative_error = estimate_clock_rate_error(measured.iter().filter(|row| row.key.channel_index == i))?;
        Some(LayoutFault::ClockError { channel: channel.name.clone(), relative_error })
    };
    channels.filter_map(diagnosis).collect()
}
