//! Sensors that are read while a prompt waits: as the plan names them, and what they read.

use serde::{Deserialize, Serialize};

use super::sensor::Sensor;

/// A sensor of a prompt: it is read while the person works. None of these values is a reading of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WatchedSensor {
    pub sensor: String,
    /// Its value once the person has done what the prompt asks for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_mm: Option<f64>,
    /// Of a radial sensor with a target: what its deviation from the target says of the artefact's place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub section: Option<SectionSensor>,
}

/// Where a radial sensor measures a round artefact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SectionSensor {
    /// Number of the section, from 1.
    pub number: usize,
    pub z_mm: f64,
    /// From the axis to the sensor, counter-clockwise from +X, machine frame.
    pub angle_deg: f64,
}

impl WatchedSensor {
    /// Without a target.
    pub fn new(sensor: &str) -> Self {
        Self { sensor: sensor.to_owned(), target_mm: None, section: None }
    }

    /// To be set to the middle of its range.
    pub fn at_mid_range(sensor: &Sensor) -> Self {
        let [least, greatest] = sensor.range_mm;
        Self { target_mm: Some((least + greatest) / 2.0), ..Self::new(&sensor.name) }
    }
}

/// What the watched sensors of a prompt read.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveValues {
    pub sensors: Vec<LiveSensor>,
    /// By their numbers, from 1.
    pub sections: Vec<LiveSection>,
    /// Slope of the line through the centres of two sections along X and Y.
    pub tilt_urad: Option<[f64; 2]>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LiveSensor {
    pub sensor: String,
    pub range_mm: [f64; 2],
    pub target_mm: Option<f64>,
    /// Null: `failure` says why.
    pub value_mm: Option<f64>,
    pub failure: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LiveSection {
    pub number: usize,
    /// From the axis to the centre of the section along X and Y. Null: its sensors do not determine it.
    pub eccentricity_um: Option<[f64; 2]>,
}

impl LiveSensor {
    /// Change of its value that is still needed.
    pub fn to_target_um(&self) -> Option<f64> {
        Some((self.target_mm? - self.value_mm?) * 1e3)
    }

    /// Where a distance lies in the range: 0 at its least, 1 at its greatest value.
    pub fn range_share(&self, mm: f64) -> f64 {
        let [least, greatest] = self.range_mm;
        ((mm - least) / (greatest - least)).clamp(0.0, 1.0)
    }
}
