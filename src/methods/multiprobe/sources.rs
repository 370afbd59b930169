//! Sources of uncertainty. The effect of a wrong layout is the difference of the observations that the
//! solution gives with the layout changed by ±u.

use std::f64::consts::PI;

use estimation::linear::lower_root;
use estimation::revolutions::{HarmonicData, Row};
use faer::Mat;

use super::fit::SeparationFit;
use super::model::{Component, ProbeLayout, Surface};
use crate::identification::{Effect, EvaluationType, UncertaintySource};

/// Difference of an angle for its derivative.
const SMALL_ANGLE_RAD: f64 = 1e-3;

/// Whether the co-rotating first harmonic of the motions is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StageEccentricity {
    /// The stage may be eccentric by any amount: the co-rotating part is reported as eccentricity.
    NotDeclared,
    /// Standard uncertainty, along X and Y, of the stage's axis against the table's axis.
    Declared { u_mm: f64, u_tilt_rad: f64 },
}

/// Standard uncertainties of what the layout declares. Zero: exactly known.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceSizes {
    /// Covariance of the sensors' relative gains, then of their angles, rad: [`Calibration`](super::calibration).
    pub sensors: Mat<f64>,
    /// Of the distance d of the sections.
    pub section_distance_mm: f64,
    /// Of the radius ρ of the axial sensors.
    pub face_radius_mm: f64,
    pub index_angle_rad: f64,
    pub stage: StageEccentricity,
    /// Drift of the artefact against the sensors along X, Y and Z during one revolution, net of
    /// revolutions in the other direction.
    pub drift_mm_per_revolution: f64,
    /// Effects of the sensors' linearity errors on all observations, mm: of independent draws.
    pub linearity: Vec<Vec<f64>>,
}

/// A quantity of the layout that is not exactly known.
#[derive(Debug, Clone, Copy)]
enum LayoutError {
    ChannelAngle(usize),
    IndexAngle(usize),
    SectionDistance,
    FaceRadius,
}

impl LayoutError {
    /// Changes the quantity by `change`, mm or rad.
    fn apply(self, layout: &mut ProbeLayout, change: f64) {
        match self {
            Self::ChannelAngle(channel) => layout.channels[channel].angle_rad += change,
            Self::IndexAngle(index) => layout.index_angles_rad[index] += change,
            Self::SectionDistance => {
                layout.section_z_mm.get_mut(1).into_iter().for_each(|z_mm| *z_mm += change);
            }
            Self::FaceRadius => {
                for channel in &mut layout.channels {
                    if let Surface::Face { radius_mm } = &mut channel.surface {
                        *radius_mm += change;
                    }
                }
            }
        }
    }

    /// Effect of the standard uncertainty `u` on all observations, mm.
    fn column(self, u: f64, layout: &ProbeLayout, rows: &[Row], fit: &SeparationFit) -> Vec<f64> {
        let predicted = |change: f64| {
            let mut changed = layout.clone();
            self.apply(&mut changed, change);
            fit.predicted(&changed, rows)
        };
        predicted(u).iter().zip(predicted(-u)).map(|(up, down)| (up - down) / 2.0).collect()
    }
}

/// In the order of the budget, without those that change nothing.
pub fn sources(
    layout: &ProbeLayout,
    data: &HarmonicData,
    fit: &SeparationFit,
    sizes: &SourceSizes,
) -> Vec<UncertaintySource> {
    // The first mounting defines the angle of the artefact.
    let indexes = 1..layout.index_angles_rad.len();
    let errors: [(&str, f64, Vec<LayoutError>); 3] = [
        ("index angle", sizes.index_angle_rad, indexes.map(LayoutError::IndexAngle).collect()),
        ("section distance", sizes.section_distance_mm, vec![LayoutError::SectionDistance]),
        ("face radius", sizes.face_radius_mm, vec![LayoutError::FaceRadius]),
    ];
    let of_sensors = sensor_errors(layout, data, fit, &sizes.sensors);
    let mut all =
        vec![noise(data, fit), fit.declared_source("gain and angle of the sensors", of_sensors)];
    for (name, u, errors) in errors {
        let columns = errors.iter().map(|error| error.column(u, layout, &data.rows, fit));
        all.push(fit.declared_source(name, columns.collect()));
    }
    all.push(fit.declared_source("linearity of the sensors", sizes.linearity.clone()));
    all.push(fit.declared_source("drift", drift(layout, data, sizes.drift_mm_per_revolution)));
    all.push(stage_eccentricity(layout, fit, sizes.stage));
    all.retain(|source| !source.is_zero());
    all
}

/// Scatter of the mean over the revolutions: independent harmonics.
fn noise(data: &HarmonicData, fit: &SeparationFit) -> UncertaintySource {
    let effect = fit.independent_blocks(|block| data.covariance(block + 1));
    let dof = data.scatters.iter().map(|scatter| scatter.dof).fold(f64::INFINITY, f64::min);
    let evaluation = EvaluationType::A;
    UncertaintySource { evaluation, dof, ..UncertaintySource::new("noise", effect) }
}

/// Effects of independent draws of the gains and angles of all channels, mm.
fn sensor_errors(
    layout: &ProbeLayout,
    data: &HarmonicData,
    fit: &SeparationFit,
    covariance: &Mat<f64>,
) -> Vec<Vec<f64>> {
    let channels = 0..layout.channels.len();
    let gains = channels.clone().map(|channel| gain_effect(data, channel));
    let angle = |channel| {
        let column =
            LayoutError::ChannelAngle(channel).column(SMALL_ANGLE_RAD, layout, &data.rows, fit);
        column.into_iter().map(|effect| effect / SMALL_ANGLE_RAD).collect()
    };
    let effects: Vec<Vec<f64>> = gains.chain(channels.map(angle)).collect();
    let root = lower_root(covariance);
    let draw = |column: usize| {
        let mut sum = vec![0.0; effects[0].len()];
        for (effect, size) in effects.iter().zip(root.col_as_slice(column)) {
            sum.iter_mut().zip(effect).for_each(|(sum, effect)| *sum += size * effect);
        }
        sum
    };
    (0..root.ncols()).map(draw).collect()
}

/// Change of all observations by a relative gain of 1 more of one channel.
fn gain_effect(data: &HarmonicData, channel: usize) -> Vec<f64> {
    let of = |order: usize| {
        let observed = data.observations(order).into_iter().enumerate();
        let is_own = |i: usize| data.rows[i % data.rows.len()].channel == channel;
        observed.map(move |(i, m)| if is_own(i) { m } else { 0.0 }).collect::<Vec<f64>>()
    };
    (1..=data.orders()).flat_map(of).collect()
}

/// A displacement that grows in proportion to the angle, along X, Y and Z: over one revolution
/// v·(q/2π − ½) = −Σ v/(πk)·sin kq.
fn drift(layout: &ProbeLayout, data: &HarmonicData, size_mm: f64) -> Vec<Vec<f64>> {
    let components = layout.components();
    let column = |j: usize| {
        let of = |order: usize| {
            let sine = -size_mm / (PI * order as f64);
            let design = layout.design(&data.rows, order);
            design.col_as_slice(2 * j + 1).iter().map(|d| d * sine).collect::<Vec<f64>>()
        };
        (1..=data.orders()).flat_map(of).collect()
    };
    let moved = |c: &Component| matches!(c, Component::X | Component::Y | Component::Z);
    (0..components.len()).filter(|j| moved(&components[*j])).map(column).collect()
}

/// The stage's axis turns with the table: its offset adds a co-rotating first harmonic to X and Y, its
/// tilt one to A and B. Both pass into the unknowns.
fn stage_eccentricity(
    layout: &ProbeLayout,
    fit: &SeparationFit,
    stage: StageEccentricity,
) -> UncertaintySource {
    let mut direct_changes = Vec::new();
    if let StageEccentricity::Declared { u_mm, u_tilt_rad } = stage {
        let pairs = [(Component::X, Component::Y, u_mm), (Component::A, Component::B, u_tilt_rad)];
        for (first, second, u) in pairs {
            let directions = co_rotating_directions(layout, first, second);
            let draw = |direction: Vec<f64>| {
                let mut change = vec![0.0; fit.x.len()];
                change.iter_mut().zip(direction).for_each(|(c, d)| *c = u * d);
                change
            };
            direct_changes.extend(directions.into_iter().map(draw));
        }
    }
    let effect = Effect::Joint(vec![Vec::new(); direct_changes.len()]);
    UncertaintySource {
        effect,
        direct_changes,
        ..fit.declared_source("stage eccentricity", Vec::new())
    }
}

/// The motions (cos σq, sin σq) and (−sin σq, cos σq) of a pair of components, as unknowns of the first
/// harmonic. None where the layout shows no such pair.
pub fn co_rotating_directions(
    layout: &ProbeLayout,
    first: Component,
    second: Component,
) -> Vec<Vec<f64>> {
    let components = layout.components();
    let position = |component| components.iter().position(|c| *c == component);
    let (Some(i), Some(j)) = (position(first), position(second)) else { return Vec::new() };
    let sign = layout.turn;
    // (cosine part, sine part) of the first and of the second component.
    let direction = |parts: [[f64; 2]; 2]| {
        let mut direction = vec![0.0; 2 * components.len()];
        direction[2 * i..2 * i + 2].copy_from_slice(&parts[0]);
        direction[2 * j..2 * j + 2].copy_from_slice(&parts[1]);
        direction
    };
    vec![direction([[1.0, 0.0], [0.0, sign]]), direction([[0.0, -sign], [1.0, 0.0]])]
}
