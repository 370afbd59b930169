//! True errors of a datum cylinder and of its indexing stage.

use serde::{Deserialize, Serialize};

use super::true_round_part::FormHarmonic;

/// `[simulated.datum_cylinder]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatumCylinderTruth {
    /// Standard deviation, at every angle, of the form of each cross section and of the face, drawn from the seed:
    /// harmonics 2 to 20.
    pub form_um: f64,
    /// Stated form of single cross sections (radius), in addition to the drawn form and to `form` in `[simulated]`.
    pub section_form: Vec<SectionFormHarmonic>,
    /// Stated height of the face over the angle about the axis, in addition to the drawn form.
    pub face_form: Vec<FormHarmonic>,
    /// Tilt of the axis towards X and towards Y, table frame, in every mounting.
    pub tilt_urad: [f64; 2],
}

/// `cos·cos(nψ) + sin·sin(nψ)`, µm, added to the radius of one cross section; ψ counter-clockwise about the axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SectionFormHarmonic {
    /// Number of the cross section, from 1, in the order of the artefact.
    pub section: usize,
    /// Order: undulations per revolution.
    pub n: u32,
    #[serde(default)]
    pub cos_um: f64,
    #[serde(default)]
    pub sin_um: f64,
}

/// `[simulated.stage]`: the indexing stage between table and artefact. Standard deviations of the errors that
/// each new mounting draws from the seed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IndexingStageTruth {
    /// Standard deviation of the indexed angle.
    pub index_error_urad: f64,
    /// Standard deviation of the artefact's position along X and along Y.
    pub eccentricity_um: f64,
    /// Standard deviation of the artefact's tilt towards X and towards Y.
    pub tilt_urad: f64,
    /// Mountings at a wrong angle.
    pub faults: Vec<MountingAngleFault>,
}

/// Angle error of one mounting. `mounting` is 1 for the second mounting of the cylinder, which is the first remounting.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MountingAngleFault {
    pub mounting: u32,
    /// Added to the indexed angle, counter-clockwise seen from the tip.
    pub off_deg: f64,
}
