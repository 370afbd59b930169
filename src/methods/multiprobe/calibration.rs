//! Gains and angles of the sensors: as the machine file declares them, of radial sensors as their turns show them.

use estimation::revolutions::{HarmonicData, RadialSensor, RowRevolutions, calibrate_radial};
use faer::Mat;
use machine::record::estimate::{Parameter, Unit};

use super::model::{ProbeLayout, Surface};
use crate::identification::reported_parameter;

/// A deviation is reported where its standard uncertainty falls below this part of the declared one.
const MIN_IMPROVEMENT: f64 = 0.9;

/// Of all channels: deviations of the gains from 1, then of the angles, rad, from those declared.
#[derive(Debug, Clone)]
pub struct Calibration {
    pub deviations: Vec<f64>,
    pub covariance: Mat<f64>,
}

impl Calibration {
    /// Nothing but the standard uncertainties that are declared.
    pub fn declared(channels: usize, u_gain: f64, u_angle_rad: f64) -> Self {
        let variance = |i: usize| if i < channels { u_gain.powi(2) } else { u_angle_rad.powi(2) };
        let covariance =
            Mat::from_fn(2 * channels, 2 * channels, |i, j| if i == j { variance(i) } else { 0.0 });
        Self { deviations: vec![0.0; 2 * channels], covariance }
    }

    /// Of the radial sensors by the first harmonic of `data`; others stay as `declared`.
    pub fn of(layout: &ProbeLayout, data: &HarmonicData, declared: &Self) -> Self {
        let mut all = declared.clone();
        let u = |i: usize| declared.covariance[(i, i)].sqrt();
        let count = all.channels();
        for section in (0..layout.section_z_mm.len()).map(Surface::Section) {
            let own = (0..count).filter(|i| layout.channels[*i].surface == section);
            let sensor = |channel: usize| RadialSensor {
                channel,
                angle_rad: layout.channels[channel].angle_rad,
                u_gain: u(channel),
                u_angle_rad: u(count + channel),
            };
            let sensors: Vec<RadialSensor> = own.map(sensor).collect();
            let Some(found) = calibrate_radial(data, &sensors, layout.turn) else { continue };
            let gains = sensors.iter().map(|sensor| sensor.channel);
            let places: Vec<usize> =
                gains.clone().chain(gains.map(|channel| count + channel)).collect();
            for (i, at) in places.iter().enumerate() {
                all.deviations[*at] = found.deviations[i];
                for (j, other) in places.iter().enumerate() {
                    all.covariance[(*at, *other)] = found.covariance[(i, j)];
                }
            }
        }
        all
    }

    fn channels(&self) -> usize {
        self.deviations.len() / 2
    }

    pub fn corrected_layout(&self, layout: &ProbeLayout) -> ProbeLayout {
        let mut layout = layout.clone();
        let angles = &self.deviations[self.channels()..];
        layout.channels.iter_mut().zip(angles).for_each(|(channel, by)| channel.angle_rad += by);
        layout
    }

    pub fn correct(&self, rows: &mut [RowRevolutions]) {
        for row in rows {
            let gain = 1.0 + self.deviations[row.row.channel];
            row.revolutions.iter_mut().flatten().for_each(|value| *value /= gain);
        }
    }

    /// Of each sensor, as far as the turns show it better than it is declared.
    pub fn parameters(&self, layout: &ProbeLayout, declared: &Self) -> Vec<Parameter> {
        let count = self.channels();
        let of = |i: usize| {
            let [u, before] = [self, declared].map(|own| own.covariance[(i, i)].sqrt());
            let name = &layout.channels[i % count].name;
            let (symbol, unit) = match i < count {
                true => (format!("gain_{name}"), Unit::UmPerM),
                false => (format!("angle_{name}"), Unit::Urad),
            };
            let is_better = u < MIN_IMPROVEMENT * before;
            is_better.then(|| reported_parameter(&symbol, unit, self.deviations[i], u, None))
        };
        (0..2 * count).filter_map(of).collect()
    }
}
