//! The readings file: CSV in UTF-8 with the first line `# trued-readings 1`, further comments after `#`, and
//! one row per touch or scan sample. Linear axes in mm, rotary axes and spindle in degrees, machine
//! coordinates; columns in any order, optional ones may be missing. The last line has a line end as well, so
//! that a truncated file is detected.

use std::collections::BTreeSet;
use std::io::{self, Write};

use machine::Axis;
use machine::record::reading::Reading;

mod error;
#[cfg(test)]
mod fuzz;
mod read;
#[cfg(test)]
mod tests;

pub use error::{ReadingsError, ReadingsProblem};
pub use read::read_readings;

/// Required first line of a readings file.
const FIRST_LINE: &str = "# trued-readings 1";

/// Content of a column.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Column {
    Step,
    /// Pass of the reading.
    RepeatNumber,
    Position(Axis),
    /// Displacement of a scan sample, mm; empty for a touch and for a sample without a valid value.
    Value,
    Sensor,
    /// Time on the clock of the run, s.
    Time,
    /// Why a sample has no valid value, or that the reading is excluded.
    Flag,
    /// Temperature, °C, of the thermometer with this name.
    Temperature(String),
}

impl Column {
    /// All columns except the temperatures, in the order in which they are written.
    fn fixed_columns() -> impl Iterator<Item = Column> {
        let head = [Column::Step, Column::RepeatNumber].into_iter();
        let tail = [Column::Value, Column::Sensor, Column::Time, Column::Flag];
        head.chain(Axis::ALL.into_iter().map(Column::Position)).chain(tail)
    }

    fn name(&self) -> String {
        match self {
            Column::Step => "step".to_owned(),
            Column::RepeatNumber => "repeat".to_owned(),
            Column::Position(axis) => {
                let unit = if axis.is_linear() { "mm" } else { "deg" };
                format!("{}_{unit}", axis.letter().to_ascii_lowercase())
            }
            Column::Value => "value_mm".to_owned(),
            Column::Sensor => "sensor".to_owned(),
            Column::Time => "t_s".to_owned(),
            Column::Flag => "flag".to_owned(),
            Column::Temperature(sensor) => format!("temp_{sensor}_c"),
        }
    }
}

/// Writes `readings` with `comments` (a line each) below the first line. Numbers are printed in the shortest
/// form that reads back to the same number; degrees are rounded as by [`Axis::to_mm_or_deg`].
///
/// # Errors
/// `out` fails, or a number is not finite (`InvalidData`).
pub fn write_readings(readings: &[Reading], comments: &[String], mut out: impl Write) -> io::Result<()> {
    writeln!(out, "{FIRST_LINE}")?;
    for line in comments.iter().flat_map(|comment| comment.lines()) {
        writeln!(out, "# {line}")?;
    }
    let named = readings.iter().flat_map(|row| row.temperatures_c.iter());
    let names: BTreeSet<&str> = named.map(|(name, _)| name).collect();
    let temperatures = names.into_iter().map(|name| Column::Temperature(name.to_owned()));
    let columns: Vec<Column> = Column::fixed_columns().chain(temperatures).collect();
    let mut csv = csv::Writer::from_writer(out);
    csv.write_record(columns.iter().map(Column::name))?;
    for reading in readings {
        let fields: io::Result<Vec<String>> = columns.iter().map(|column| format_field(reading, column)).collect();
        csv.write_record(fields?)?;
    }
    csv.flush()
}

fn format_field(reading: &Reading, column: &Column) -> io::Result<String> {
    let number = |value: Option<f64>| match value {
        None => Ok(String::new()),
        // The sum turns -0 into 0.
        Some(value) if value.is_finite() => Ok((value + 0.0).to_string()),
        Some(_) => Err(io::Error::new(
            io::ErrorKind::InvalidData,
            format!("step {}: {} is not finite", reading.step, column.name()),
        )),
    };
    match column {
        Column::Step => Ok(reading.step.to_string()),
        Column::RepeatNumber => Ok(reading.repeat.to_string()),
        Column::Position(axis) => number(reading.position.get(*axis).map(|value| axis.to_mm_or_deg(value))),
        Column::Value => number(reading.value_mm),
        Column::Sensor => Ok(reading.sensor.clone()),
        Column::Time => number(Some(reading.t_s)),
        Column::Flag => Ok(reading.flag.as_str().to_owned()),
        Column::Temperature(sensor) => number(reading.temperatures_c.get(sensor)),
    }
}
