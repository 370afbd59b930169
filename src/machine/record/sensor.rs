//! A sensor that measures a distance without touching: where it is mounted, and what is declared about
//! it. How it is reached is `sensors/`'s matter.

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorKind {
    /// One distance along a straight line.
    #[default]
    Displacement,
}

/// What carries a sensor, and with it the frame of its zero point and direction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mount {
    /// From the spindle datum, spindle at S = 0.
    #[default]
    Spindle,
    /// Table frame: the machine frame when all axes stand at zero.
    Table,
    /// Machine frame.
    Bed,
}

impl Mount {
    pub fn is_spindle(&self) -> bool {
        *self == Self::Spindle
    }
}

/// One sensor as mounted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    pub name: String,
    #[serde(default)]
    pub kind: SensorKind,
    #[serde(default, skip_serializing_if = "Mount::is_spindle")]
    pub mount: Mount,
    /// Its zero point in the frame of its mount: nominal, it is found by measurement.
    pub zero_mm: [f64; 3],
    /// Unit vector along which its reading grows, away from it: nominal as well. The reading is the
    /// distance from the zero point to the surface along it.
    pub direction: [f64; 3],
    /// Readings that mean something, least and greatest.
    pub range_mm: [f64; 2],
    /// From its zero point back to its front face.
    #[serde(default)]
    pub stand_off_mm: f64,
    /// Its body from the front face back along the direction, a cylinder. 0: not declared, and not
    /// looked at.
    #[serde(default)]
    pub body_radius_mm: f64,
    #[serde(default)]
    pub body_length_mm: f64,
    /// Standard deviation of one sample, um. Absent: judged from the residuals alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_um: Option<f64>,
    /// Standard deviation of what its curve deviates from a straight line over its range, um.
    #[serde(default)]
    pub linearity_um: f64,
    /// What a surface adds that leans by 45°, um: standard deviation of a part that goes as the squared
    /// tangent of its lean, and of one along each of two directions across, as the tangent.
    #[serde(default)]
    pub incidence_um: f64,
    /// Samples at a greater angle between beam and surface normal are not used.
    #[serde(default = "default_incidence")]
    pub incidence_limit_deg: f64,
}

pub fn default_incidence() -> f64 {
    30.0
}
