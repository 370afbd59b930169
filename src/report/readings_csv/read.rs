//! Strict reading of a readings file: anything unknown is an error with its location.

use std::collections::BTreeMap;

use csv::StringRecord;

use super::{Column, FIRST_LINE, ReadingsError, ReadingsProblem};
use machine::Axis;
use machine::record::reading::{Reading, ReadingFlag};

/// Reads a whole file. Defaults of missing optional columns: `repeat` 0, `t_s` 0, `sensor` and `flag` empty,
/// `value_mm` none (a touch), other axes without a position.
///
/// # Errors
/// The first problem in the file, with its line.
pub fn read_readings(bytes: &[u8]) -> Result<Vec<Reading>, ReadingsError> {
    let text = decode_and_check_file(bytes)?;
    let mut rows =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).comment(Some(b'#')).from_reader(text.as_bytes());
    let Some((line, names)) = next_record(&mut rows)? else {
        return Err(error_at(text.lines().count() as u64, ReadingsProblem::NoHeader));
    };
    let columns = parse_header(&names).map_err(|problem| error_at(line, problem))?;
    let mut touches = BTreeMap::new();
    let mut readings = Vec::new();
    while let Some((line, record)) = next_record(&mut rows)? {
        let reading = parse_row(&columns, &record).map_err(|problem| error_at(line, problem))?;
        let (step, repeat) = (reading.step, reading.repeat);
        // A sample whose flag explains the missing value is not a touch.
        let is_touch = matches!(reading.flag, ReadingFlag::None | ReadingFlag::Excluded);
        if reading.value_mm.is_none()
            && is_touch
            && let Some(first) = touches.insert((step, repeat), line)
        {
            return Err(error_at(line, ReadingsProblem::DuplicateTouch { step, repeat, first_line: first }));
        }
        readings.push(reading);
    }
    Ok(readings)
}

fn error_at(line: u64, problem: ReadingsProblem) -> ReadingsError {
    ReadingsError { line, problem }
}

/// The file as text, after the checks of the whole file.
fn decode_and_check_file(bytes: &[u8]) -> Result<&str, ReadingsError> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let before = bytes.iter().take(error.valid_up_to());
        error_at(1 + before.filter(|byte| **byte == b'\n').count() as u64, ReadingsProblem::NotUtf8)
    })?;
    // Spreadsheet programs write a byte order mark before UTF-8.
    let text = text.trim_start_matches('\u{feff}');
    let first = text.lines().next().unwrap_or_default().trim_end();
    if first != FIRST_LINE {
        let found = first.chars().take(60).collect();
        return Err(error_at(1, ReadingsProblem::WrongFirstLine { found }));
    }
    // Text without a final line end is refused: a truncated line can look complete. 12.3 may be the beginning of
    // 12.345, and an empty flag may be the beginning of `excluded`.
    if !text.ends_with('\n') {
        return Err(error_at(text.lines().count() as u64, ReadingsProblem::NoFinalLineEnd));
    }
    Ok(text)
}

/// The next record and the line on which it ends.
fn next_record(rows: &mut csv::Reader<&[u8]>) -> Result<Option<(u64, StringRecord)>, ReadingsError> {
    let mut record = StringRecord::new();
    let more = rows.read_record(&mut record);
    // The position of a record includes the comments before it; the position of the reader is after the line
    // end.
    let ended = rows.position().line();
    match more {
        Ok(true) => Ok(Some((ended.saturating_sub(1), record))),
        Ok(false) => Ok(None),
        Err(error) => Err(error_at(ended, ReadingsProblem::InvalidCsv(error.to_string()))),
    }
}

fn parse_header(names: &StringRecord) -> Result<Vec<Column>, ReadingsProblem> {
    let mut columns = Vec::new();
    for name in names.iter().map(str::trim) {
        let column = parse_column(name).ok_or_else(|| ReadingsProblem::UnknownColumn {
            name: name.to_owned(),
            nearest: nearest_column_name(name),
        })?;
        if columns.contains(&column) {
            return Err(ReadingsProblem::RepeatedColumn { name: name.to_owned() });
        }
        columns.push(column);
    }
    let needed = [Column::Step].into_iter().chain(Axis::LINEAR.map(Column::Position));
    match needed.into_iter().find(|column| !columns.contains(column)) {
        Some(missing) => Err(ReadingsProblem::MissingColumn { name: missing.name() }),
        None => Ok(columns),
    }
}

fn parse_column(name: &str) -> Option<Column> {
    let temperature = || name.strip_prefix("temp_")?.strip_suffix("_c");
    let temperature = || temperature().filter(|sensor| !sensor.is_empty());
    Column::fixed_columns()
        .find(|column| column.name() == name)
        .or_else(|| temperature().map(|sensor| Column::Temperature(sensor.to_owned())))
}

fn nearest_column_name(name: &str) -> String {
    let known = Column::fixed_columns().chain([Column::Temperature("NAME".to_owned())]);
    let likeness = |candidate: &String| strsim::normalized_damerau_levenshtein(name, candidate);
    known.map(|column| column.name()).max_by(|a, b| likeness(a).total_cmp(&likeness(b))).unwrap_or_default()
}

fn parse_row(columns: &[Column], record: &StringRecord) -> Result<Reading, ReadingsProblem> {
    if record.len() != columns.len() {
        return Err(ReadingsProblem::WrongFieldCount { found: record.len(), expected: columns.len() });
    }
    let mut reading = Reading::default();
    let mut temperatures_c = BTreeMap::new();
    for (column, text) in columns.iter().zip(record) {
        match column {
            Column::Temperature(_) if text.trim().is_empty() => {}
            Column::Temperature(name) => {
                temperatures_c.insert(name.clone(), parse_number(column, text)?);
            }
            _ => set_field(&mut reading, column, text)?,
        }
    }
    Ok(Reading { temperatures_c: temperatures_c.into(), ..reading })
}

fn set_field(reading: &mut Reading, column: &Column, text: &str) -> Result<(), ReadingsProblem> {
    let empty = text.trim().is_empty();
    match column {
        Column::Step => reading.step = parse_count(column, text)?,
        Column::RepeatNumber => reading.repeat = if empty { 0 } else { parse_count(column, text)? },
        Column::Position(axis) if axis.is_linear() && empty => {
            return Err(ReadingsProblem::EmptyField { name: column.name() });
        }
        // The column must be complete, as missing times would look like drift.
        Column::Time if empty => return Err(ReadingsProblem::EmptyField { name: column.name() }),
        Column::Sensor => reading.sensor = text.to_owned(),
        Column::Flag => reading.flag = text.trim().parse()?,
        _ if empty => {}
        Column::Position(axis) => {
            reading.position.set(*axis, axis.to_mm_or_rad(parse_number(column, text)?));
        }
        Column::Value => reading.value_mm = Some(parse_number(column, text)?),
        Column::Time => reading.t_s = parse_number(column, text)?,
        // Temperatures are collected per row.
        Column::Temperature(_) => {}
    }
    Ok(())
}

fn parse_count(column: &Column, text: &str) -> Result<u32, ReadingsProblem> {
    let problem = || ReadingsProblem::NotACount { name: column.name(), text: text.to_owned() };
    text.trim().parse().map_err(|_| problem())
}

fn parse_number(column: &Column, text: &str) -> Result<f64, ReadingsProblem> {
    let (name, text) = (column.name(), text.trim().to_owned());
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(ReadingsProblem::NotFinite { name, text }),
        Err(_) => Err(ReadingsProblem::NotANumber { name, text }),
    }
}
