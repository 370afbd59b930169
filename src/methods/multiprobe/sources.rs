//! Sources of uncertainty. The effect of a layout error is the difference between the observations that the
//! solution predicts with the layout changed by +u and by −u.

use std::f64::consts::PI;

use estimation::linear_least_squares::cholesky_lower;
use estimation::revolutions::{ChannelAtMounting, HarmonicData};
use faer::Mat;

use super::fit::SeparationFit;
use super::model::{MeasuredSurface, MotionOrForm, ProbeLayout};
use super::settings::MultiprobeSettings;
use crate::identification::{EvaluationType, UncertaintySource};

/// Step of the numerical derivative by an angle.
const DERIVATIVE_ANGLE_STEP_RAD: f64 = 1e-3;

/// Standard uncertainties of the sources. 0: the quantity is exactly known.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceSizes<'a> {
    /// Settings with the uncertainties of the declared layout.
    pub settings: &'a MultiprobeSettings,
    /// Covariance of the gains, then of the angles, after the calibration. `None`: `u_gain` and the sensor angle
    /// uncertainty of the settings, uncorrelated.
    pub sensor_covariance: Option<Mat<f64>>,
    /// Standard uncertainty of the drift of the artefact relative to the sensors along X, Y and Z during one
    /// revolution. 0 if the table turns in both directions.
    pub u_drift_mm_per_revolution: f64,
    /// Effects of the sensors' linearity errors on all observations, one column per independent draw, mm.
    pub linearity_effects: Vec<Vec<f64>>,
}

/// Raises the second section by `by_mm`.
fn change_section_distance(layout: &mut ProbeLayout, by_mm: f64) {
    layout.section_z_mm.iter_mut().skip(1).for_each(|z_mm| *z_mm += by_mm);
}

fn change_face_radius(layout: &mut ProbeLayout, by_mm: f64) {
    for channel in &mut layout.channels {
        if let MeasuredSurface::Face { radius_mm } = &mut channel.surface {
            *radius_mm += by_mm;
        }
    }
}

/// Effect on all observations, mm, of the standard uncertainty `u` of the quantity that `change` changes by mm or rad.
fn observation_changes_by_layout_error(
    layout: &ProbeLayout,
    rows: &[ChannelAtMounting],
    fit: &SeparationFit,
    u: f64,
    change: impl Fn(&mut ProbeLayout, f64),
) -> Vec<f64> {
    let predicted = |by: f64| {
        let mut changed = layout.clone();
        change(&mut changed, by);
        fit.predicted_observations(&changed, rows)
    };
    predicted(u).iter().zip(predicted(-u)).map(|(up, down)| (up - down) / 2.0).collect()
}

/// All sources in the order of the budget, without those that have no effect.
pub fn uncertainty_sources(
    layout: &ProbeLayout,
    data: &HarmonicData,
    fit: &SeparationFit,
    sizes: &SourceSizes<'_>,
) -> Vec<UncertaintySource> {
    let declared = sizes.settings;
    let (rows, u_index) = (&data.row_keys, declared.u_index_angle_deg.to_radians());
    let index_error = |index| {
        observation_changes_by_layout_error(layout, rows, fit, u_index, |layout, by| {
            layout.index_angles_rad[index] += by
        })
    };
    // The first mounting defines the angle of the artefact.
    let index_errors = (1..layout.index_angles_rad.len()).map(index_error).collect();
    let distance_error =
        observation_changes_by_layout_error(layout, rows, fit, declared.u_section_distance_mm, change_section_distance);
    let radius_error =
        observation_changes_by_layout_error(layout, rows, fit, declared.u_face_radius_mm, change_face_radius);
    let mut all = vec![
        noise_source(data, fit),
        fit.unweighted_source("gain and angle of the sensors", sensor_error_effects(layout, data, fit, sizes)),
        fit.unweighted_source("index angle", index_errors),
        fit.unweighted_source("section distance", vec![distance_error]),
        fit.unweighted_source("face radius", vec![radius_error]),
        fit.unweighted_source("linearity of the sensors", sizes.linearity_effects.clone()),
        fit.unweighted_source("drift", drift_effects(layout, data, sizes.u_drift_mm_per_revolution)),
    ];
    all.retain(|source| !source.is_zero());
    all
}

/// Noise source: scatter of the mean over the revolutions, independent between harmonics.
fn noise_source(data: &HarmonicData, fit: &SeparationFit) -> UncertaintySource {
    let effect = fit.block_covariance_effect(|block| data.observation_covariance(block + 1));
    let dof = data.harmonic_scatters.iter().map(|scatter| scatter.dof).fold(f64::INFINITY, f64::min);
    let evaluation = EvaluationType::A;
    UncertaintySource { evaluation, dof, ..UncertaintySource::new("noise", effect) }
}

/// Effects of independent draws of the gains and angles of all channels, mm.
fn sensor_error_effects(
    layout: &ProbeLayout,
    data: &HarmonicData,
    fit: &SeparationFit,
    sizes: &SourceSizes<'_>,
) -> Vec<Vec<f64>> {
    let count = layout.channels.len();
    let gains = (0..count).map(|channel| gain_effect(data, channel));
    let angle = |channel: usize| {
        let change = |layout: &mut ProbeLayout, by| layout.channels[channel].angle_rad += by;
        let changes =
            observation_changes_by_layout_error(layout, &data.row_keys, fit, DERIVATIVE_ANGLE_STEP_RAD, change);
        changes.into_iter().map(|effect| effect / DERIVATIVE_ANGLE_STEP_RAD).collect()
    };
    let effects: Vec<Vec<f64>> = gains.chain((0..count).map(angle)).collect();
    let (u_gain, u_angle) = (sizes.settings.u_gain, sizes.settings.u_sensor_angle_rad());
    let declared = |i: usize| if i < count { u_gain } else { u_angle };
    let independent = || Mat::from_fn(2 * count, 2 * count, |i, j| if i == j { declared(i) } else { 0.0 });
    let root = sizes.sensor_covariance.as_ref().map_or_else(independent, cholesky_lower);
    let draw = |column: usize| {
        let mut sum = vec![0.0; effects[0].len()];
        for (effect, size) in effects.iter().zip(root.col_as_slice(column)) {
            sum.iter_mut().zip(effect).for_each(|(sum, effect)| *sum += size * effect);
        }
        sum
    };
    (0..root.ncols()).map(draw).collect()
}

/// Change of all observations by an increase of one channel's relative gain by 1.
fn gain_effect(data: &HarmonicData, channel: usize) -> Vec<f64> {
    let observed = (1..=data.max_order()).flat_map(|order| data.observations(order));
    let rows = data.row_keys.iter().cycle();
    observed.zip(rows).map(|(m, row)| if row.channel_index == channel { m } else { 0.0 }).collect()
}

/// Effects on all observations, mm, of a displacement proportional to the angle, one column for each of X, Y and Z that
/// the layout measures. Over one revolution the displacement is v·(q/2π − ½) = −Σ v/(πk)·sin kq.
fn drift_effects(layout: &ProbeLayout, data: &HarmonicData, u_mm_per_revolution: f64) -> Vec<Vec<f64>> {
    let components = layout.components();
    let column = |j: usize| {
        let block_effect = |order: usize| {
            let sine = -u_mm_per_revolution / (PI * order as f64);
            let design = layout.design_matrix(&data.row_keys, order);
            design.col_as_slice(2 * j + 1).iter().map(|d| d * sine).collect::<Vec<f64>>()
        };
        (1..=data.max_order()).flat_map(block_effect).collect()
    };
    let is_shifted = |c: &MotionOrForm| matches!(c, MotionOrForm::X | MotionOrForm::Y | MotionOrForm::Z);
    (0..components.len()).filter(|j| is_shifted(&components[*j])).map(column).collect()
}
