//! A sensor that measures a distance without contact: its mounting and its declared properties. The drivers of sensors
//! are in `devices/sensors/`.

use serde::{Deserialize, Serialize};

/// Quantity that a sensor measures.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MeasuredQuantity {
    /// One distance along a straight line.
    #[default]
    Displacement,
}

/// Carrier of a sensor, which also defines the frame of its zero point and direction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorMount {
    /// Spindle: relative to the spindle datum, with the spindle at S = 0.
    #[default]
    Spindle,
    /// Table frame: the machine frame when all axes are at zero.
    Table,
    /// Machine frame.
    Bed,
}

impl SensorMount {
    pub fn is_spindle(&self) -> bool {
        *self == Self::Spindle
    }
}

/// One mounted sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    pub name: String,
    #[serde(default, rename = "kind")]
    pub measured_quantity: MeasuredQuantity,
    #[serde(default, skip_serializing_if = "SensorMount::is_spindle")]
    pub mount: SensorMount,
    /// Zero point in the frame of the mount; nominal, because a measurement determines it.
    pub zero_mm: [f64; 3],
    /// Unit vector along which the reading increases, away from the sensor; nominal as well. The reading is the
    /// distance from the zero point to the surface along this vector.
    pub direction: [f64; 3],
    /// Valid range of the readings, minimum and maximum.
    pub range_mm: [f64; 2],
    /// Distance from the zero point back to the front face of the sensor.
    #[serde(default)]
    pub stand_off_mm: f64,
    /// Radius of the sensor's body, a cylinder from the front face back along the direction. 0: not declared, and
    /// therefore not checked.
    #[serde(default)]
    pub body_radius_mm: f64,
    #[serde(default)]
    pub body_length_mm: f64,
    /// Standard deviation of one sample, um. Absent: evaluated from the residuals alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_um: Option<f64>,
    /// Standard deviation of the linearity error over the range, um.
    #[serde(default)]
    pub linearity_um: f64,
    /// Error at a surface inclined by 45°, um: standard deviation of a part that grows with the squared tangent of the
    /// inclination, and of a part along each of two transverse directions that grows with the tangent.
    #[serde(default)]
    pub incidence_um: f64,
    /// Maximum angle between beam and surface normal; samples at a greater angle are not used.
    #[serde(default = "default_incidence_limit_deg")]
    pub incidence_limit_deg: f64,
}

pub fn default_incidence_limit_deg() -> f64 {
    30.0
}
