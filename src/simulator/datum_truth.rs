//! A datum cylinder and its indexing stage as they truly are.

use serde::{Deserialize, Serialize};

use super::flank::FormHarmonic;

/// `[simulated.datum_cylinder]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatumTruth {
    /// Standard deviation of the form of each section and of the face, drawn from the seed: harmonics 2 to 20.
    pub form_um: f64,
    /// What is known of single sections, beside what is drawn and the `form` of all.
    pub section_form: Vec<SectionForm>,
    /// Height of the face over the angle about the axis.
    pub face_form: Vec<FormHarmonic>,
    /// Lean of the axis towards X and Y.
    pub tilt_urad: [f64; 2],
}

/// A harmonic of one section, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SectionForm {
    pub section: usize,
    pub n: u32,
    #[serde(default)]
    pub cos_um: f64,
    #[serde(default)]
    pub sin_um: f64,
}

/// `[simulated.stage]`: the indexing stage between table and artefact. Standard deviations of what each new
/// mounting draws from the seed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StageTruth {
    /// Of the angle.
    pub index_error_urad: f64,
    /// Of the artefact's place along X and along Y.
    pub eccentricity_um: f64,
    /// Of its lean towards X and towards Y.
    pub tilt_urad: f64,
    /// Mountings at a wrong angle.
    pub faults: Vec<IndexFault>,
}

/// The mounting of this number, from 1 on, is off by an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IndexFault {
    pub mounting: u32,
    pub off_deg: f64,
}
