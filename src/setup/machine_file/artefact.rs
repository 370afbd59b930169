//! `[artefact]`. The record's type is tagged by `kind` inside, and serde reads such a type from a
//! buffer that has lost all lines: so `kind` is read first, then the fields of that kind.

use serde::Deserialize;

use super::document::{Document, value_problem};
use super::error::MachineFileError;
use crate::record::machine::{Artefact, default_height, default_uncertainty};

#[derive(Deserialize)]
struct Kind {
    kind: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cylinder {
    #[serde(rename = "kind")]
    _kind: String,
    centre_mm: [f64; 3],
    axis: [f64; 3],
    radius_mm: f64,
    #[serde(default = "default_height")]
    height_mm: f64,
    #[serde(default = "default_uncertainty")]
    uncertainty_mm: f64,
}

pub fn read(document: &Document) -> Result<Artefact, MachineFileError> {
    let Kind { kind } = document.required(&["artefact"])?;
    if kind != "cylinder" {
        let key = ["artefact", "kind"];
        let why = format!("is `{kind}`; known: cylinder");
        return Err(document.error_at(&key, value_problem(&key, why)));
    }
    let raw: Cylinder = document.required(&["artefact"])?;
    Ok(Artefact::Cylinder {
        centre_mm: raw.centre_mm,
        axis: raw.axis,
        radius_mm: raw.radius_mm,
        height_mm: raw.height_mm,
        uncertainty_mm: raw.uncertainty_mm,
    })
}
