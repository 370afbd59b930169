//! Sources of uncertainty. The effect of a layout error is the difference between the observations that the
//! solution predicts with the layout changed by +u and by −u.

use std::f64::consts::PI;

use estimation::linear::cholesky_lower;
use estimation::revolutions::{HarmonicData, RowKey};
use faer::Mat;

use super::fit::SeparationFit;
use super::model::{Component, ProbeLayout, Surface};
use super::settings::MultiprobeSettings;
use crate::identification::{EvaluationType, UncertaintySource};

/// Step of the numerical derivative by an angle.
const ANGLE_STEP_RAD: f64 = 1e-3;

/// Standard uncertainties. Zero: exactly known.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceSizes<'a> {
    /// Settings with the uncertainties of the declared layout.
    pub settings: &'a MultiprobeSettings,
    /// Covariance of the gains, then of the angles, after the calibration.
    pub sensor_covariance: Option<Mat<f64>>,
    /// Drift of the artefact relative to the sensors along X, Y and Z during one revolution, reduced by the
    /// revolutions in the other direction.
    pub drift_mm_per_revolution: f64,
    /// Effects of the sensors' linearity errors on all observations, one column per independent draw, mm.
    pub linearity: Vec<Vec<f64>>,
}

/// Changes an uncertain quantity of the layout, by mm or rad.
type LayoutChange = Box<dyn Fn(&mut ProbeLayout, f64)>;

fn change_channel_angle(channel: usize) -> LayoutChange {
    Box::new(move |layout, by| layout.channels[channel].angle_rad += by)
}

fn change_index_angle(index: usize) -> LayoutChange {
    Box::new(move |layout, by| layout.index_angles_rad[index] += by)
}

fn change_section_distance() -> LayoutChange {
    Box::new(|layout, by| layout.section_z_mm.iter_mut().skip(1).for_each(|z_mm| *z_mm += by))
}

fn change_face_radius() -> LayoutChange {
    Box::new(|layout, by| {
        for channel in &mut layout.channels {
            if let Surface::Face { radius_mm } = &mut channel.surface {
                *radius_mm += by;
            }
        }
    })
}

/// Effect of the standard uncertainty `u` on all observations, mm.
fn layout_error_effect(
    change: &LayoutChange,
    u: f64,
    layout: &ProbeLayout,
    rows: &[RowKey],
    fit: &SeparationFit,
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
    // The first mounting defines the angle of the artefact.
    let indexes = 1..layout.index_angles_rad.len();
    let errors: [(&str, f64, Vec<LayoutChange>); 3] = [
        ("index angle", declared.u_index_angle_deg.to_radians(), indexes.map(change_index_angle).collect()),
        ("section distance", declared.u_section_distance_mm, vec![change_section_distance()]),
        ("face radius", declared.u_face_radius_mm, vec![change_face_radius()]),
    ];
    let of_sensors = sensor_error_effects(layout, data, fit, sizes);
    let mut all = vec![noise_source(data, fit), fit.declared_source("gain and angle of the sensors", of_sensors)];
    for (name, u, errors) in errors {
        let columns = errors.iter().map(|change| layout_error_effect(change, u, layout, &data.rows, fit));
        all.push(fit.declared_source(name, columns.collect()));
    }
    all.push(fit.declared_source("linearity of the sensors", sizes.linearity.clone()));
    all.push(fit.declared_source("drift", drift_effects(layout, data, sizes.drift_mm_per_revolution)));
    all.retain(|source| !source.is_zero());
    all
}

/// Noise source: scatter of the mean over the revolutions, independent between harmonics.
fn noise_source(data: &HarmonicData, fit: &SeparationFit) -> UncertaintySource {
    let effect = fit.block_covariance_effect(|block| data.covariance(block + 1));
    let dof = data.scatters.iter().map(|scatter| scatter.dof).fold(f64::INFINITY, f64::min);
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
    let channels = 0..count;
    let gains = channels.clone().map(|channel| gain_effect(data, channel));
    let angle = |channel| {
        let changes = layout_error_effect(&change_channel_angle(channel), ANGLE_STEP_RAD, layout, &data.rows, fit);
        changes.into_iter().map(|effect| effect / ANGLE_STEP_RAD).collect()
    };
    let effects: Vec<Vec<f64>> = gains.chain(channels.map(angle)).collect();
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
    let observed = (1..=data.orders()).flat_map(|order| data.observations(order));
    let rows = data.rows.iter().cycle();
    observed.zip(rows).map(|(m, row)| if row.channel == channel { m } else { 0.0 }).collect()
}

/// Displacement proportional to the angle, along X, Y and Z. Over one revolution it is v·(q/2π − ½) = −Σ v/(πk)·sin
/// kq.
fn drift_effects(layout: &ProbeLayout, data: &HarmonicData, size_mm: f64) -> Vec<Vec<f64>> {
    let components = layout.components();
    let column = |j: usize| {
        let block_effect = |order: usize| {
            let sine = -size_mm / (PI * order as f64);
            let design = layout.design_matrix(&data.rows, order);
            design.col_as_slice(2 * j + 1).iter().map(|d| d * sine).collect::<Vec<f64>>()
        };
        (1..=data.orders()).flat_map(block_effect).collect()
    };
    let is_shifted = |c: &Component| matches!(c, Component::X | Component::Y | Component::Z);
    (0..components.len()).filter(|j| is_shifted(&components[*j])).map(column).collect()
}
