//! Gains and angles of the sensors, from the scanned revolutions together with the values declared in the machine
//! file.

use estimation::revolutions::{ChannelRevolutions, DeclaredSensor, HarmonicData, SensorCalibration, calibrate_sensors};
use machine::record::estimate::{Parameter, Unit};

use super::model::{MeasuredSurface, ProbeLayout};
use super::settings::MultiprobeSettings;
use crate::IdentifyError;
use crate::identification::parameter_without_budget;

/// A gain or angle deviation of a sensor is reported if its standard uncertainty is below this fraction of the declared
/// standard uncertainty.
const MAX_REPORTED_TO_DECLARED_U_RATIO: f64 = 0.9;

/// Determines the deviations of gains and angles from the declared values: gains of all channels, then angles.
///
/// # Errors
/// The rows do not separate eccentricity and motion.
pub fn calibrate_layout_sensors(
    layout: &ProbeLayout,
    settings: &MultiprobeSettings,
    data: &HarmonicData,
) -> Result<SensorCalibration, IdentifyError> {
    let sensors = layout.channels.iter().map(|channel| DeclaredSensor {
        radial_cross_section_index: match channel.surface {
            MeasuredSurface::Section(section) => Some(section),
            MeasuredSurface::Face { .. } => None,
        },
        angle_rad: channel.angle_rad,
        u_gain: settings.u_gain,
        u_angle_rad: settings.u_sensor_angle_rad(),
    });
    let calibration = calibrate_sensors(data, &sensors.collect::<Vec<_>>(), layout.turn_sign);
    calibration.map_err(|error| IdentifyError::IdentificationFailed(error.to_string()))
}

/// Divides the values of each row by 1 + gain deviation of its channel.
pub fn correct_row_gains(calibration: &SensorCalibration, rows: &mut [ChannelRevolutions]) {
    for row in rows {
        let gain = 1.0 + calibration.gain_then_angle_deviations[row.key.channel_index];
        row.revolutions.iter_mut().flatten().for_each(|value| *value /= gain);
    }
}

/// Adds the angle deviation of each sensor to its declared angle.
pub fn correct_channel_angles(calibration: &SensorCalibration, layout: &mut ProbeLayout) {
    let angles = &calibration.gain_then_angle_deviations[layout.channels.len()..];
    layout.channels.iter_mut().zip(angles).for_each(|(channel, by)| channel.angle_rad += by);
}

/// Deviations of gain and angle from the declared values, for the sensors whose standard uncertainty from the
/// measurement is clearly below the declared one (`u_gain`, `u_sensor_angle_deg`).
pub fn calibration_parameters(
    calibration: &SensorCalibration,
    layout: &ProbeLayout,
    settings: &MultiprobeSettings,
) -> Vec<Parameter> {
    let count = layout.channels.len();
    let parameter = |i: usize| {
        let name = &layout.channels[i % count].name;
        let (symbol, unit, declared) = match i < count {
            true => (format!("gain_{name}"), Unit::UmPerM, settings.u_gain),
            false => (format!("angle_{name}"), Unit::Urad, settings.u_sensor_angle_rad()),
        };
        let u = calibration.covariance[(i, i)].sqrt();
        let is_better = u < MAX_REPORTED_TO_DECLARED_U_RATIO * declared;
        is_better.then(|| parameter_without_budget(&symbol, unit, calibration.gain_then_angle_deviations[i], u, None))
    };
    (0..2 * count).filter_map(parameter).collect()
}
