//! `[artefact]`. The record's type is internally tagged by `kind`, and serde reads such a type from a buffer
//! without line numbers. Therefore `kind` is read first, then the fields of that kind.

use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::balls_csv::{self, Columns, Common, column};
use super::document::{Document, value_problem};
use super::error::{MachineFileError, Place, Problem};
use machine::artefact::{self, ArtefactFault, Entry};
use machine::record::artefact::{Artefact, Balls};

/// Maximum certified uncertainty, mm. A larger value is taken for a wrong unit.
const MAX_CERTIFIED_U_MM: f64 = 0.1;

/// Keys of the placement of balls: origin of their coordinates in the table frame, and rotation about its Z
/// axis.
const PLACEMENT: [&str; 2] = ["origin_mm", "turned_deg"];

/// Source of data outside the text of a machine file.
#[derive(Debug, Clone, Copy)]
pub enum ArtefactSource<'a> {
    /// No other data: the text is complete.
    Nothing,
    /// Other files in this folder.
    Folder(&'a Path),
    /// The artefact as it was read when the run began; the folder may have been deleted or changed since.
    Artefact(&'a Artefact),
}

#[derive(Deserialize)]
struct Kind {
    kind: String,
}

/// An artefact of the kind `none` has no key but `kind`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoKeys {}

pub fn read(document: &Document, beside: ArtefactSource<'_>) -> Result<Artefact, MachineFileError> {
    if let ArtefactSource::Artefact(artefact) = beside {
        return Ok(artefact.clone());
    }
    let Kind { kind } = document.required(&["artefact"])?;
    match kind.as_str() {
        "cylinder" => fields(document, &["kind"]).map(Artefact::Cylinder),
        "balls" => balls(document, beside).map(Artefact::Balls),
        "datum_cylinder" => fields(document, &["kind"]).map(Artefact::DatumCylinder),
        "none" => fields(document, &["kind"]).map(|NoKeys {}| Artefact::None),
        _ => {
            let key = ["artefact", "kind"];
            let why = format!("is `{kind}`; known: cylinder, balls, datum_cylinder, none");
            Err(document.error_at(&key, value_problem(&key, why)))
        }
    }
}

/// Reads the table without the keys in `less`, which were read before.
fn fields<T: DeserializeOwned>(document: &Document, less: &[&str]) -> Result<T, MachineFileError> {
    let read = document.section(&["artefact"], |value| {
        T::deserialize(less.iter().fold(value, |value, key| value.without(key)))
    })?;
    let missing = || Problem::MissingSection { section: "artefact".to_owned() };
    read.ok_or_else(|| document.error_at(&["artefact"], missing()))
}

fn balls(document: &Document, beside: ArtefactSource<'_>) -> Result<Balls, MachineFileError> {
    let mut balls: Balls =
        fields(document, &[&["kind", "file"], &PLACEMENT[..], &Common::KEYS[..]].concat())?;
    let wrong = |key: &str, why: &str| {
        let path = ["artefact", key];
        document.error_at(&path, value_problem(&path, why.to_owned()))
    };
    let file: Option<String> = key(document, "file")?;
    let table = match file {
        Some(_) if !balls.balls.is_empty() => {
            return Err(wrong("file", "stands beside [[artefact.balls]]: keep one of the two"));
        }
        None => {
            let names = document.names(&["artefact"])?;
            if let Some(common) =
                Common::KEYS.into_iter().find(|key| names.iter().any(|n| n == key))
            {
                let why = "is what balls in a table have in common (file = \"NAME.csv\"): write it in \
                           each of [[artefact.balls]]";
                return Err(wrong(common, why));
            }
            None
        }
        Some(name) => {
            let ArtefactSource::Folder(folder) = beside else {
                let why =
                    "names a file, but there is no folder to look in: write [[artefact.balls]]";
                return Err(wrong("file", why));
            };
            Some(Table::read(&folder.join(name), &common(document)?)?)
        }
    };
    if let Some(table) = &table {
        balls.balls = table.balls.iter().map(|(ball, _)| ball.clone()).collect();
    }
    if balls.balls.is_empty() {
        let why = "holds no ball: add [[artefact.balls]], or file = \"NAME.csv\"".to_owned();
        let problem = Problem::Section { section: "artefact".to_owned(), why };
        return Err(document.error_at(&["artefact"], problem));
    }
    if balls.certificate_u_mm.is_some_and(|u| !(u > 0.0 && u <= MAX_CERTIFIED_U_MM)) {
        return Err(wrong(
            "certificate_u_mm",
            "must be greater than 0 and at most 0.1: half of the certificate's U (k = 2), in mm",
        ));
    }
    if balls.u_temperature_k.is_some_and(|u| u < 0.0) {
        return Err(wrong("u_temperature_k", "must not be negative"));
    }
    if balls.uncertainty_mm < 0.0 {
        return Err(wrong("uncertainty_mm", "must not be negative"));
    }
    let origin_mm = key(document, PLACEMENT[0])?.unwrap_or_default();
    place(&mut balls, origin_mm, key(document, PLACEMENT[1])?.unwrap_or_default());
    artefact::check(&balls).map_err(|flaw| placed(document, table.as_ref(), flaw))?;
    Ok(balls)
}

/// Transforms the balls from the artefact's own coordinates into the table frame.
fn place(balls: &mut Balls, origin_mm: [f64; 3], turned_deg: f64) {
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

fn key<T: DeserializeOwned>(
    document: &Document,
    name: &str,
) -> Result<Option<T>, MachineFileError> {
    document.section(&["artefact", name], T::deserialize)
}

fn common(document: &Document) -> Result<Common, MachineFileError> {
    Ok(Common {
        radius_mm: key(document, "radius_mm")?,
        stem: key(document, "stem")?,
        stem_radius_mm: key(document, "stem_radius_mm")?,
        stem_length_mm: key(document, "stem_length_mm")?,
    })
}

struct Table {
    file: String,
    columns: Columns,
    balls: Vec<balls_csv::Placed>,
}

impl Table {
    fn read(path: &Path, common: &Common) -> Result<Self, MachineFileError> {
        let file = path.display().to_string();
        match std::fs::read_to_string(path) {
            Ok(text) => {
                let (columns, balls) = balls_csv::read(&file, &text, common)?;
                Ok(Self { file, columns, balls })
            }
            Err(source) => Err(MachineFileError::ReadBalls { file, source }),
        }
    }
}

/// Error at the location of a flaw: in the table file, or at the key of the machine file.
fn placed(document: &Document, table: Option<&Table>, flaw: ArtefactFault) -> MachineFileError {
    let ArtefactFault { of, key, why } = flaw;
    let (name, index) = match (of, table) {
        // The machine file contains the properties that all balls share.
        (Entry::Ball(_), Some(table))
            if Common::KEYS.contains(&key) && !table.columns.hold(key) =>
        {
            return document.error_at(&["artefact", key], value_problem(&["artefact", key], why));
        }
        (Entry::Ball(index), Some(table)) => {
            let line = table.balls.get(index).map(|(_, line)| *line);
            let place = Place { file: table.file.clone(), line };
            let problem = Problem::Column { column: column(key).to_owned(), why };
            return MachineFileError::Content { place, problem };
        }
        (Entry::Ball(index), None) => ("balls", index),
        (Entry::Length(index), _) => ("lengths", index),
    };
    let problem = Problem::Value { section: format!("artefact.{name}"), key: key.to_owned(), why };
    document.error_at_entry(&["artefact", name], index, key, problem)
}
