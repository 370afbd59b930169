//! Sensors that are read while a prompt waits: their declaration in the plan, and their values.

use serde::{Deserialize, Serialize};

use super::sensor::Sensor;

/// A sensor of a prompt: it is read while the operator works. None of its values is a reading of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WatchedSensor {
    pub sensor: String,
    /// Value after the operator has done what the prompt requires; `None`: no value is required.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_mm: Option<f64>,
    /// For a radial sensor with a target: the cross section whose position its deviation shows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub section: Option<CrossSectionPoint>,
}

/// Point of a round artefact at which a radial sensor measures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CrossSectionPoint {
    /// Number of the cross section, from 1.
    pub number: usize,
    /// Height of the cross section, machine frame.
    pub z_mm: f64,
    /// Direction from the axis to the sensor, counter-clockwise from +X, machine frame.
    pub angle_deg: f64,
}

impl WatchedSensor {
    /// A watched sensor without a target.
    pub fn new(sensor: &str) -> Self {
        Self { sensor: sensor.to_owned(), target_mm: None, section: None }
    }

    /// A watched sensor whose target is the middle of its range.
    pub fn with_mid_range_target(sensor: &Sensor) -> Self {
        let [min, max] = sensor.range_mm;
        Self { target_mm: Some((min + max) / 2.0), ..Self::new(&sensor.name) }
    }
}

/// Values of the watched sensors of a prompt.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveValues {
    pub sensors: Vec<LiveSensorValue>,
    /// Cross sections by their numbers, from 1.
    pub sections: Vec<LiveCrossSectionValue>,
    /// Slope, along X and Y, of the line through the centres of the two cross sections. Null unless exactly two are
    /// watched and both centres are determined.
    pub tilt_urad: Option<[f64; 2]>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LiveSensorValue {
    pub sensor: String,
    pub range_mm: [f64; 2],
    /// As in [`WatchedSensor`].
    pub target_mm: Option<f64>,
    /// Measured value; null if the sensor failed, with the reason in `failure`.
    pub value_mm: Option<f64>,
    pub failure: Option<String>,
}

/// Measured position of one cross section of a round artefact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LiveCrossSectionValue {
    pub number: usize,
    /// Distance from the axis to the centre of the cross section along X and Y. Null: the sensors do not determine it.
    pub eccentricity_um: Option<[f64; 2]>,
}

impl LiveSensorValue {
    /// Target minus value, µm. `None`: no target or no value.
    pub fn change_to_target_um(&self) -> Option<f64> {
        Some((self.target_mm? - self.value_mm?) * 1e3)
    }

    /// Relative position of a distance in the range: 0 at the minimum, 1 at the maximum; limited to 0 to 1.
    pub fn fraction_of_range(&self, mm: f64) -> f64 {
        let [min, max] = self.range_mm;
        ((mm - min) / (max - min)).clamp(0.0, 1.0)
    }
}
