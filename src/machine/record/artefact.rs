//! The measured artefact, as the machine file and the plan declare it. Positions are in the table frame, which is
//! the machine frame when all axes are at zero.

use serde::{Deserialize, Serialize};

use super::default_value;

/// Temperature at which dimensions are certified (ISO 1), °C.
pub const REFERENCE_TEMPERATURE_C: f64 = 20.0;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Artefact {
    Cylinder(Cylinder),
    Balls(Balls),
    DatumCylinder(DatumCylinder),
    /// Nothing is on the table but the solids of the machine file.
    None,
}

/// A cylinder that displacement sensors measure: radially at its cross sections, axially at its face. The probe does
/// not touch it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatumCylinder {
    /// Foot of the cylinder's axis, table frame.
    #[serde(rename = "centre_mm")]
    pub foot_mm: [f64; 3],
    /// Direction of the axis from the foot, table frame; of any length.
    pub axis: [f64; 3],
    /// Measurable cross sections, in rising order.
    pub sections: Vec<DatumCrossSection>,
    /// Face above all cross sections; absent: no sensor may measure axially.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub face: Option<DatumCrossSection>,
    /// Maximum distance, not standard uncertainty, of the true centre from the stated centre.
    #[serde(default = "default_value::<2>")]
    pub uncertainty_mm: f64,
}

/// A cross section of a datum cylinder, or its face.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatumCrossSection {
    /// Distance from the foot along the axis.
    pub z_mm: f64,
    /// Radius of the cylinder at this cross section; for the face, its outer radius.
    pub radius_mm: f64,
}

/// A round part: foot of its axis, direction, radius, height of the touchable flank.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cylinder {
    /// Foot of the cylinder's axis, table frame.
    #[serde(rename = "centre_mm")]
    pub foot_mm: [f64; 3],
    /// Direction of the axis from the foot, table frame; of any length.
    pub axis: [f64; 3],
    pub radius_mm: f64,
    /// Height of the touchable flank above the foot; absent: 100 mm.
    #[serde(default = "default_value::<100>")]
    pub height_mm: f64,
    /// Maximum distance, not standard uncertainty, of the true centre from the stated centre.
    #[serde(default = "default_value::<2>")]
    pub uncertainty_mm: f64,
}

/// Precision balls on stems. Their positions need not be known accurately; the lengths between some of them may be
/// certified.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Balls {
    #[serde(default)]
    pub balls: Vec<Ball>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lengths: Vec<CertifiedLength>,
    /// Standard uncertainty of a coordinate of a ball's centre relative to the other balls; absent if the positions
    /// are not calibrated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificate_u_mm: Option<f64>,
    /// Coefficient of thermal expansion of the base that carries the balls; absent: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expansion_um_per_m_k: Option<f64>,
    /// Temperature of the artefact during the measurement; absent: 20 °C, at which the centres are certified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Standard uncertainty of `temperature_c`; absent: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub u_temperature_k: Option<f64>,
    /// Maximum distance, not standard uncertainty, of a ball's true centre from its stated centre.
    #[serde(default = "default_value::<2>")]
    pub uncertainty_mm: f64,
}

impl Balls {
    /// Thermal expansion per mm of distance between two certified centres, mm: its value at the stated temperature,
    /// and its standard uncertainty.
    pub fn relative_expansion_and_u(&self) -> [f64; 2] {
        let per_k = self.expansion_um_per_m_k.unwrap_or_default() * 1e-6;
        let above_k = self.temperature_c.map_or(0.0, |celsius| celsius - REFERENCE_TEMPERATURE_C);
        [per_k * above_k, (per_k * self.u_temperature_k.unwrap_or_default()).abs()]
    }
}

/// One ball of the artefact.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ball {
    /// Short name, unique within the artefact; without `/`, which separates the parts of a step label.
    pub id: String,
    /// Centre, table frame. While a machine file is read: in the artefact's own coordinates, until `origin_mm` and
    /// `turned_deg` are applied.
    pub centre_mm: [f64; 3],
    pub radius_mm: f64,
    /// Direction from the ball's centre along the stem to its foot; same frame as the centre.
    #[serde(default = "default_stem")]
    pub stem: [f64; 3],
    /// Radius of the stem; 0 if the stem is not declared, and therefore not in the collision proof.
    #[serde(default)]
    pub stem_radius_mm: f64,
    /// Length of the stem from the ball's centre.
    #[serde(default)]
    pub stem_length_mm: f64,
}

/// A certified distance of two ball centres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertifiedLength {
    /// `id` of the first ball.
    pub from: String,
    /// `id` of the second ball.
    pub to: String,
    /// Certified length at 20 °C, mm.
    pub mm: f64,
    /// Standard uncertainty of the certified length, mm.
    pub u_mm: f64,
    /// Coefficient of thermal expansion of the certified length.
    #[serde(default)]
    pub expansion_um_per_m_k: f64,
    /// Temperature of the certified length during the measurement; absent: 20 °C is assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Standard uncertainty of `temperature_c`.
    #[serde(default)]
    pub u_temperature_k: f64,
}

fn default_stem() -> [f64; 3] {
    [0.0, 0.0, -1.0]
}
