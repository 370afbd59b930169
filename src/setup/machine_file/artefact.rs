//! `[artefact]`. The record's type is tagged by `kind` inside, and serde reads such a type from a
//! buffer that has lost all lines: so `kind` is read first, then the fields of that kind.

use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::document::{Document, value_problem};
use super::error::{MachineFileError, Problem};
use crate::record::artefact::Artefact;

#[derive(Deserialize)]
struct Kind {
    kind: String,
}

pub fn read(document: &Document) -> Result<Artefact, MachineFileError> {
    let Kind { kind } = document.required(&["artefact"])?;
    match kind.as_str() {
        "cylinder" => fields(document).map(Artefact::Cylinder),
        "balls" => fields(document).map(Artefact::Balls),
        _ => {
            let key = ["artefact", "kind"];
            let why = format!("is `{kind}`; known: cylinder, balls");
            Err(document.error_at(&key, value_problem(&key, why)))
        }
    }
}

fn fields<T: DeserializeOwned>(document: &Document) -> Result<T, MachineFileError> {
    let read = document.section(&["artefact"], |value| T::deserialize(value.without("kind")))?;
    let missing = || Problem::MissingSection { section: "artefact".to_owned() };
    read.ok_or_else(|| document.error_at(&["artefact"], missing()))
}
