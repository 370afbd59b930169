//! Balls as a table of their own beside the machine file: one line a ball, a head of column names, in
//! any order; `#` begins a comment.

use super::error::{MachineFileError, Place, Problem};
use super::hint;
use crate::record::artefact::Ball;

const NEEDED: [&str; 5] = ["ball", "x_mm", "y_mm", "z_mm", "radius_mm"];
const STEM: [&str; 5] = ["stem_x", "stem_y", "stem_z", "stem_radius_mm", "stem_length_mm"];

/// A ball and the line (from 1) that it stands on.
pub type Placed = (Ball, usize);

/// # Errors
/// A column that is not known, or lacks; a value that is no finite number; with file and line.
pub fn read(file: &str, text: &str) -> Result<Vec<Placed>, MachineFileError> {
    let error = |line: usize, problem| {
        let place = Place { file: file.to_owned(), line: Some(line) };
        MachineFileError::Content { place, problem }
    };
    // The last line ends as all others do, so that lines can be counted by their ends.
    let text = format!("{text}\n");
    let mut rows = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .has_headers(false)
        .from_reader(text.as_bytes());
    let mut columns: Option<Columns> = None;
    let mut balls = Vec::new();
    let mut record = csv::StringRecord::new();
    loop {
        let more = rows.read_record(&mut record);
        // A record's own position is that of the comments before it.
        let behind = rows.position().line() as usize;
        let line = behind.saturating_sub(1).max(1);
        match more {
            Ok(true) => {}
            Ok(false) => return Ok(balls),
            Err(broken) => return Err(error(line, Problem::Table(broken.to_string()))),
        }
        match &columns {
            None => columns = Some(Columns::new(&record).map_err(|problem| error(line, problem))?),
            Some(columns) => {
                let ball = columns.ball(&record).map_err(|problem| error(line, problem))?;
                balls.push((ball, line));
            }
        }
    }
}

/// What a key of a ball is called in the table.
pub fn column(key: &str) -> &str {
    match key {
        "id" => "ball",
        "centre_mm" => "x_mm",
        "stem" => "stem_x",
        same => same,
    }
}

struct Columns {
    names: Vec<String>,
}

impl Columns {
    fn new(head: &csv::StringRecord) -> Result<Self, Problem> {
        let names: Vec<&str> = head.iter().collect();
        let known = [NEEDED, STEM].concat();
        if let Some(name) = names.iter().find(|name| !known.contains(name)) {
            let why = format!("is unknown; {}", hint::for_unknown(name, &known));
            return Err(Problem::Column { column: (*name).to_owned(), why });
        }
        if let Some(lacking) = NEEDED.iter().find(|name| !names.contains(name)) {
            let why = "is missing; the first line names the columns".to_owned();
            return Err(Problem::Column { column: (*lacking).to_owned(), why });
        }
        let twice = |name: &&&str| names.iter().filter(|other| other == name).count() > 1;
        if let Some(name) = names.iter().find(twice) {
            let why = "stands twice".to_owned();
            return Err(Problem::Column { column: (*name).to_owned(), why });
        }
        Ok(Self { names: names.into_iter().map(str::to_owned).collect() })
    }

    fn ball(&self, record: &csv::StringRecord) -> Result<Ball, Problem> {
        let text = |name: &str| {
            let index = self.names.iter().position(|column| column == name)?;
            record.get(index).filter(|text| !text.is_empty())
        };
        let number = |name: &'static str, otherwise: Option<f64>| {
            let wrong = |why: String| Problem::Column { column: name.to_owned(), why };
            match (text(name), otherwise) {
                (None, Some(value)) => Ok(value),
                (None, None) => Err(wrong("is empty".to_owned())),
                (Some(text), _) => match text.parse::<f64>() {
                    Ok(value) if value.is_finite() => Ok(value),
                    _ => Err(wrong(format!("is `{text}`; it must be a finite number"))),
                },
            }
        };
        let stands = text("stem_x").or(text("stem_y")).or(text("stem_z")).is_some();
        let stem = |name, down: f64| number(name, Some(if stands { 0.0 } else { down }));
        Ok(Ball {
            id: text("ball").unwrap_or_default().to_owned(),
            centre_mm: [number("x_mm", None)?, number("y_mm", None)?, number("z_mm", None)?],
            radius_mm: number("radius_mm", None)?,
            stem: [stem("stem_x", 0.0)?, stem("stem_y", 0.0)?, stem("stem_z", -1.0)?],
            stem_radius_mm: number("stem_radius_mm", Some(0.0))?,
            stem_length_mm: number("stem_length_mm", Some(0.0))?,
        })
    }
}
