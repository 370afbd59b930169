//! Balls in a CSV table beside the machine file: a header of column names in any order, then one line per ball;
//! `#` begins a comment. Properties that all balls share may be in `[artefact]` instead.

use serde::Deserialize;

use super::error::{FileLocation, MachineFileError, MachineFileProblem};
use super::key_hint;
use machine::record::artefact::Ball;

/// Required columns; `radius_mm` only if `[artefact]` does not state it.
const REQUIRED_COLUMNS: [&str; 5] = ["ball", "x_mm", "y_mm", "z_mm", "radius_mm"];
/// Optional columns.
const STEM_COLUMNS: [&str; 5] = ["stem_x", "stem_y", "stem_z", "stem_radius_mm", "stem_length_mm"];

/// A ball and its line number (from 1).
pub type BallWithLineNumber = (Ball, usize);

/// Values of `[artefact]` that replace missing columns and empty cells of the table.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
pub struct DefaultBallData {
    pub radius_mm: Option<f64>,
    /// Direction from the ball's centre along the stem to its foot, in the coordinates of the CSV table: before the
    /// rotation into the table frame.
    pub stem: Option<[f64; 3]>,
    pub stem_radius_mm: Option<f64>,
    /// Length of the stem from the ball's centre.
    pub stem_length_mm: Option<f64>,
}

impl DefaultBallData {
    pub const KEYS: [&'static str; 4] = ["radius_mm", "stem", "stem_radius_mm", "stem_length_mm"];
}

/// Parses a table of balls. `file`: its name in error messages.
///
/// # Errors
/// An unknown or missing column, or a value that is no finite number; with file and line.
pub fn parse_ball_csv(
    file: &str,
    text: &str,
    common: &DefaultBallData,
) -> Result<(BallCsvColumns, Vec<BallWithLineNumber>), MachineFileError> {
    let error = |line: usize, problem| {
        let place = FileLocation { file: file.to_owned(), line: Some(line) };
        MachineFileError::InvalidContent { place, problem }
    };
    // A final line end, so that lines can be counted by their ends.
    let text = format!("{text}\n");
    let mut rows = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .has_headers(false)
        .from_reader(text.as_bytes());
    let mut columns: Option<BallCsvColumns> = None;
    let mut balls = Vec::new();
    let mut record = csv::StringRecord::new();
    loop {
        let more = rows.read_record(&mut record);
        // The csv reader gives the start of the comments before a record as the position of the record.
        let lines_read = rows.position().line() as usize;
        let line = lines_read.saturating_sub(1).max(1);
        match more {
            Ok(true) => {}
            Ok(false) => break,
            Err(broken) => return Err(error(line, MachineFileProblem::InvalidCsv(broken.to_string()))),
        }
        match &columns {
            None => {
                let header = BallCsvColumns::new(&record, common);
                columns = Some(header.map_err(|problem| error(line, problem))?);
            }
            Some(columns) => {
                let ball = columns.parse_ball(&record, common).map_err(|problem| error(line, problem))?;
                balls.push((ball, line));
            }
        }
    }
    Ok((columns.unwrap_or_default(), balls))
}

/// Name of the table column for a ball's key; of the three columns of a vector the first.
pub fn column_of_key(key: &str) -> &str {
    match key {
        "id" => "ball",
        "centre_mm" => "x_mm",
        "stem" => "stem_x",
        same => same,
    }
}

/// Column names of a table.
#[derive(Debug, Clone, Default)]
pub struct BallCsvColumns {
    names: Vec<String>,
}

impl BallCsvColumns {
    /// Whether the table has a column for a ball's key.
    pub fn has_column_of_key(&self, key: &str) -> bool {
        self.names.iter().any(|name| name == column_of_key(key))
    }

    fn new(header: &csv::StringRecord, common: &DefaultBallData) -> Result<Self, MachineFileProblem> {
        let names: Vec<&str> = header.iter().collect();
        let known = [REQUIRED_COLUMNS, STEM_COLUMNS].concat();
        if let Some(name) = names.iter().find(|name| !known.contains(name)) {
            let why = format!("is unknown; {}", key_hint::unknown_key_hint(name, &known));
            return Err(MachineFileProblem::InvalidColumn { column: (*name).to_owned(), why });
        }
        let stated = |name: &str| name == "radius_mm" && common.radius_mm.is_some();
        let is_missing = |name: &&&str| !names.contains(name) && !stated(name);
        if let Some(missing) = REQUIRED_COLUMNS.iter().find(is_missing) {
            let why = match *missing {
                "radius_mm" => "is missing; state radius_mm in [artefact] if all balls have the same",
                _ => "is missing; the first line names the columns",
            };
            return Err(MachineFileProblem::InvalidColumn { column: (*missing).to_owned(), why: why.to_owned() });
        }
        let is_duplicate = |name: &&&str| names.iter().filter(|other| other == name).count() > 1;
        if let Some(name) = names.iter().find(is_duplicate) {
            let why = "occurs twice".to_owned();
            return Err(MachineFileProblem::InvalidColumn { column: (*name).to_owned(), why });
        }
        Ok(Self { names: names.into_iter().map(str::to_owned).collect() })
    }

    /// The ball of one row, in the coordinates of the CSV table. Without a stem direction in row and `common`, the stem
    /// points along −Z; a missing radius or length of the stem is 0.
    fn parse_ball(&self, record: &csv::StringRecord, common: &DefaultBallData) -> Result<Ball, MachineFileProblem> {
        let text = |name: &str| {
            let index = self.names.iter().position(|column| column == name)?;
            record.get(index).filter(|text| !text.is_empty())
        };
        let number = |name: &'static str, common_value: Option<f64>| {
            let wrong = |why: String| MachineFileProblem::InvalidColumn { column: name.to_owned(), why };
            match (text(name), common_value) {
                (None, Some(value)) => Ok(value),
                (None, None) => Err(wrong("is empty".to_owned())),
                (Some(text), _) => match text.parse::<f64>() {
                    Ok(value) if value.is_finite() => Ok(value),
                    _ => Err(wrong(format!("is `{text}`; it must be a finite number"))),
                },
            }
        };
        let has_stem = text("stem_x").or(text("stem_y")).or(text("stem_z")).is_some();
        let [x, y, z] = if has_stem { [0.0; 3] } else { common.stem.unwrap_or([0.0, 0.0, -1.0]) };
        let or_none = |value: Option<f64>| Some(value.unwrap_or(0.0));
        Ok(Ball {
            id: text("ball").unwrap_or_default().to_owned(),
            centre_mm: [number("x_mm", None)?, number("y_mm", None)?, number("z_mm", None)?],
            radius_mm: number("radius_mm", common.radius_mm)?,
            stem: [number("stem_x", Some(x))?, number("stem_y", Some(y))?, number("stem_z", Some(z))?],
            stem_radius_mm: number("stem_radius_mm", or_none(common.stem_radius_mm))?,
            stem_length_mm: number("stem_length_mm", or_none(common.stem_length_mm))?,
        })
    }
}
