//! `[artefact]`. The record's type is internally tagged by `kind`, and serde reads such a type from a buffer
//! without line numbers. Therefore `kind` is read first, then the fields of that kind.

use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::balls_csv::{self, BallCsvColumns, DefaultBallData, column_of_key};
use super::document::TomlDocument;
use super::error::{FileLocation, MachineFileError, MachineFileProblem};
use machine::artefact::{self, ArtefactEntry, ArtefactFault};
use machine::record::artefact::{Artefact, Balls};

/// Maximum standard uncertainty of a certificate, mm. A larger value is refused, because its unit is probably wrong.
const MAX_CERTIFICATE_STD_U_MM: f64 = 0.1;

/// Keys of the placement of balls: origin of their coordinates in the table frame, and rotation about the Z axis of
/// these coordinates, which is applied first.
const BALL_PLACEMENT_KEYS: [&str; 2] = ["origin_mm", "turned_deg"];

/// Source of the artefact's data outside the text of a machine file.
#[derive(Debug, Clone, Copy)]
pub enum ArtefactSource<'a> {
    /// No file outside the text is read; a text that names such a file is refused.
    TextOnly,
    /// The files that the text names, e.g. a table of balls, are in this folder.
    FolderOfMachineFile(&'a Path),
    /// The artefact as it was read when the run began; the folder may have been deleted or changed since.
    RecordedArtefact(&'a Artefact),
}

#[derive(Deserialize)]
struct ArtefactKindKey {
    kind: String,
}

/// An artefact of the kind `none` has no key but `kind`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoKeys {}

/// Artefact of `[artefact]`, in the table frame; a recorded artefact is returned unchanged.
pub fn read_artefact(document: &TomlDocument, source: ArtefactSource<'_>) -> Result<Artefact, MachineFileError> {
    if let ArtefactSource::RecordedArtefact(artefact) = source {
        return Ok(artefact.clone());
    }
    let ArtefactKindKey { kind } = document.deserialize_required_section(&["artefact"])?;
    match kind.as_str() {
        "cylinder" => read_artefact_fields(document, &["kind"]).map(Artefact::Cylinder),
        "balls" => read_balls(document, source).map(Artefact::Balls),
        "datum_cylinder" => read_artefact_fields(document, &["kind"]).map(Artefact::DatumCylinder),
        "none" => read_artefact_fields(document, &["kind"]).map(|NoKeys {}| Artefact::None),
        _ => {
            let why = format!("is `{kind}`; known: cylinder, balls, datum_cylinder, none");
            Err(document.value_error(&["artefact", "kind"], why))
        }
    }
}

/// Reads `[artefact]` without the keys in `other_keys`, which are read separately.
fn read_artefact_fields<T: DeserializeOwned>(
    document: &TomlDocument,
    other_keys: &[&str],
) -> Result<T, MachineFileError> {
    document.read_required_section(&["artefact"], |value| {
        T::deserialize(other_keys.iter().fold(value, |value, key| value.without_key(key)))
    })
}

/// Balls of `[artefact]` or of its CSV table, checked and transformed into the table frame of the machine.
fn read_balls(document: &TomlDocument, source: ArtefactSource<'_>) -> Result<Balls, MachineFileError> {
    let other_keys = [&["kind", "file"], &BALL_PLACEMENT_KEYS[..], &DefaultBallData::KEYS[..]].concat();
    let mut balls: Balls = read_artefact_fields(document, &other_keys)?;
    let wrong = |key: &str, why: &str| document.value_error(&["artefact", key], why);
    let file: Option<String> = read_artefact_key(document, "file")?;
    let table = match file {
        Some(_) if !balls.balls.is_empty() => {
            return Err(wrong("file", "and [[artefact.balls]] are both present: keep only one of them"));
        }
        None => {
            let names = document.key_names(&["artefact"])?;
            if let Some(common) = DefaultBallData::KEYS.into_iter().find(|key| names.iter().any(|n| n == key)) {
                let why = "is a common value for the balls of a table (file = \"NAME.csv\"): without a \
                    table, write it in each [[artefact.balls]]";
                return Err(wrong(common, why));
            }
            None
        }
        Some(name) => {
            let ArtefactSource::FolderOfMachineFile(folder) = source else {
                let why = "names a file, but the folder of the machine file is not known: write \
                    [[artefact.balls]] instead";
                return Err(wrong("file", why));
            };
            let common: DefaultBallData = document.deserialize_required_section(&["artefact"])?;
            Some(BallCsvTable::read(&folder.join(name), &common)?)
        }
    };
    if let Some(table) = &table {
        balls.balls = table.balls.iter().map(|(ball, _)| ball.clone()).collect();
    }
    if balls.balls.is_empty() {
        let why = "contains no ball: add [[artefact.balls]], or file = \"NAME.csv\"";
        return Err(document.value_error(&["artefact"], why));
    }
    if balls.certificate_u_mm.is_some_and(|u| !(u > 0.0 && u <= MAX_CERTIFICATE_STD_U_MM)) {
        let why = "must be greater than 0 and at most 0.1: half of the certificate's U (k = 2), in mm";
        return Err(wrong("certificate_u_mm", why));
    }
    if balls.u_temperature_k.is_some_and(|u| u < 0.0) {
        return Err(wrong("u_temperature_k", "must not be negative"));
    }
    if balls.uncertainty_mm < 0.0 {
        return Err(wrong("uncertainty_mm", "must not be negative"));
    }
    let [origin_key, turned_key] = BALL_PLACEMENT_KEYS;
    let origin_mm = read_artefact_key(document, origin_key)?.unwrap_or_default();
    let turned_deg = read_artefact_key(document, turned_key)?.unwrap_or_default();
    transform_balls_to_table_frame(&mut balls, origin_mm, turned_deg);
    artefact::check_balls(&balls).map_err(|fault| artefact_fault_error(document, table.as_ref(), fault))?;
    Ok(balls)
}

/// Transforms centres and stems from the artefact's own coordinates into the table frame: turned about Z by
/// `turned_deg` (positive from X to Y), then the centres shifted by `origin_mm`.
fn transform_balls_to_table_frame(balls: &mut Balls, origin_mm: [f64; 3], turned_deg: f64) {
    let (sin, cos) = turned_deg.to_radians().sin_cos();
    let turned = |[x, y, z]: [f64; 3]| match turned_deg == 0.0 {
        true => [x, y, z],
        false => [cos * x - sin * y, sin * x + cos * y, z],
    };
    for ball in &mut balls.balls {
        let centre = turned(ball.centre_mm);
        ball.centre_mm = std::array::from_fn(|k| origin_mm[k] + centre[k]);
        ball.stem = turned(ball.stem);
    }
}

/// Value of one key of `[artefact]`; `None` if the file does not state it.
fn read_artefact_key<T: DeserializeOwned>(document: &TomlDocument, name: &str) -> Result<Option<T>, MachineFileError> {
    document.read_section(&["artefact", name], T::deserialize)
}

/// The table of balls that `file` of `[artefact]` names.
struct BallCsvTable {
    file_path: String,
    columns: BallCsvColumns,
    balls: Vec<balls_csv::BallWithLineNumber>,
}

impl BallCsvTable {
    fn read(path: &Path, common: &DefaultBallData) -> Result<Self, MachineFileError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| MachineFileError::UnreadableBallTable { file: file.clone(), source })?;
        let (columns, balls) = balls_csv::parse_ball_csv(&file, &text, common)?;
        Ok(Self { file_path: file, columns, balls })
    }
}

/// Error at the location of a fault: in the table file, or at the key of the machine file.
fn artefact_fault_error(
    document: &TomlDocument,
    table: Option<&BallCsvTable>,
    fault: ArtefactFault,
) -> MachineFileError {
    let ArtefactFault { entry: of, key, message: why } = fault;
    let (name, index) = match (of, table) {
        // The machine file contains the properties that all balls share.
        (ArtefactEntry::Ball(_), Some(table))
            if DefaultBallData::KEYS.contains(&key) && !table.columns.has_column_of_key(key) =>
        {
            return document.value_error(&["artefact", key], why);
        }
        (ArtefactEntry::Ball(index), Some(table)) => {
            let line = table.balls.get(index).map(|(_, line)| *line);
            let place = FileLocation { file: table.file_path.clone(), line };
            let problem = MachineFileProblem::InvalidColumn { column: column_of_key(key).to_owned(), why };
            return MachineFileError::InvalidContent { place, problem };
        }
        (ArtefactEntry::Ball(index), None) => ("balls", index),
        (ArtefactEntry::Length(index), _) => ("lengths", index),
    };
    document.entry_value_error(&["artefact", name], index, key, why)
}
