//! What a layout of radial sensors and indexes separates, before anything is measured: noise gain, the best
//! third angle.

use std::ops::RangeInclusive;

use faer::c64;

use super::fit::SeparationFit;
use super::harmonics::HarmonicData;
use super::model::{Channel, Component, ProbeLayout, Row, Surface, TableSense};
use super::outputs::ReportedMotions;
use super::sources::StageEccentricity;
use crate::Refused;

/// Harmonics that decide between layouts.
pub const RANKED_ORDERS: RangeInclusive<usize> = 2..=20;
/// Sensors nearer than this to each other, or to the opposite side, do not separate X from Y.
pub const MIN_SENSOR_ANGLE_DEG: f64 = 5.0;
/// Which measurements of a layout take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separation {
    /// All sensors, artefact not indexed.
    Multiprobe,
    /// The first two sensors at every index.
    Multistep,
    /// All sensors at every index.
    Combined,
}

/// Radial sensors of one section and the indexes of the artefact.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialLayout {
    pub angles_deg: Vec<f64>,
    /// Cumulative against the first mounting.
    pub index_angles_deg: Vec<f64>,
}

/// Noise of EXC over the noise of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseGain {
    pub orders: Vec<usize>,
    /// One entry an order; infinite where the order is lost.
    pub gains: Vec<f64>,
    /// Root mean square over the orders.
    pub rms: f64,
}

impl RadialLayout {
    /// Sensors at `angles_deg` with `indexes` equal steps of the artefact.
    pub fn equal_steps(angles_deg: &[f64], indexes: usize) -> Self {
        let step = 360.0 / indexes.max(1) as f64;
        Self {
            angles_deg: angles_deg.to_vec(),
            index_angles_deg: (0..indexes.max(1)).map(|n| n as f64 * step).collect(),
        }
    }

    pub fn probe_layout(&self) -> ProbeLayout {
        let channels = self.angles_deg.iter().map(|angle_deg| Channel {
            name: format!("{angle_deg}°"),
            surface: Surface::Section(0),
            angle_rad: angle_deg.to_radians(),
        });
        ProbeLayout {
            channels: channels.collect(),
            section_z_mm: vec![0.0],
            reference_z_mm: 0.0,
            index_angles_rad: self.index_angles_deg.iter().map(|deg| deg.to_radians()).collect(),
            sense: TableSense::CounterClockwise,
        }
    }

    fn rows(&self, separation: Separation) -> Vec<Row> {
        let is_used = |row: &Row| match separation {
            Separation::Multiprobe => row.index == 0,
            Separation::Multistep => row.channel < 2,
            Separation::Combined => true,
        };
        self.probe_layout().all_rows().into_iter().filter(is_used).collect()
    }

    /// Over the harmonics `orders`.
    ///
    /// # Errors
    /// Angles that are not finite.
    pub fn noise_gain(
        &self,
        separation: Separation,
        orders: RangeInclusive<usize>,
    ) -> Result<NoiseGain, Refused> {
        let layout = self.probe_layout();
        let rows = self.rows(separation);
        let fit = unit_noise_fit(&layout, rows, *orders.end())?;
        let motions = ReportedMotions::new(&layout, &fit, PERFECT_STAGE);
        let gain = |order: usize| match motions.parts(Component::X, order) {
            Some(_) => fit.harmonics[order - 1].solution.covariance[(0, 0)].sqrt(),
            None => f64::INFINITY,
        };
        let gains: Vec<f64> = orders.clone().map(gain).collect();
        let rms = crate::identification::rms(&gains);
        Ok(NoiseGain { orders: orders.collect(), gains, rms })
    }
}

const PERFECT_STAGE: StageEccentricity = StageEccentricity::Declared { u_mm: 0.0, u_tilt_rad: 0.0 };

/// The fit of harmonics 1..=`orders` of zeros, each observation with a standard uncertainty of 1 mm.
pub fn unit_noise_fit(
    layout: &ProbeLayout,
    rows: Vec<Row>,
    orders: usize,
) -> Result<SeparationFit, Refused> {
    let means = vec![vec![c64::ZERO; rows.len()]; orders];
    let data = HarmonicData::declared(rows, means, 1.0, 2);
    SeparationFit::new(layout, &data).map_err(|error| Refused {
        why: error.to_string(),
        instead: "correct angles and heights of the sensors".to_owned(),
    })
}

/// A range of angles, counter-clockwise from `from_deg` to `to_deg`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AngleRange {
    pub from_deg: f64,
    pub to_deg: f64,
}

impl AngleRange {
    pub fn contains(self, deg: f64) -> bool {
        (deg - self.from_deg).rem_euclid(360.0) <= (self.to_deg - self.from_deg).rem_euclid(360.0)
    }
}

/// Positions of the third sensor in steps of `step_deg` outside the `exclusions`, those of least noise
/// gain of the multiprobe separation (root mean square over [`RANKED_ORDERS`]) first. None that loses one
/// of these harmonics.
pub fn third_angles(
    pair_deg: [f64; 2],
    step_deg: f64,
    exclusions: &[AngleRange],
) -> Vec<(f64, NoiseGain)> {
    let count = (360.0 / step_deg).round().max(1.0) as usize;
    let is_free = |deg: &f64| {
        !exclusions.iter().any(|range| range.contains(*deg))
            && pair_deg.iter().all(|other| sensor_angle_deg(*deg, *other) >= MIN_SENSOR_ANGLE_DEG)
    };
    let gain = |deg: f64| {
        let layout = RadialLayout::equal_steps(&[pair_deg[0], pair_deg[1], deg], 1);
        Some((deg, layout.noise_gain(Separation::Multiprobe, RANKED_ORDERS).ok()?))
    };
    let free = (0..count).map(|i| i as f64 * step_deg).filter(is_free);
    let mut found: Vec<(f64, NoiseGain)> =
        free.filter_map(gain).filter(|(_, gain)| gain.rms.is_finite()).collect();
    found.sort_by(|a, b| a.1.rms.total_cmp(&b.1.rms));
    found
}

/// Angle between the lines of two sensors, 0 to 90°.
pub fn sensor_angle_deg(a_deg: f64, b_deg: f64) -> f64 {
    let between = (a_deg - b_deg).rem_euclid(180.0);
    between.min(180.0 - between)
}
