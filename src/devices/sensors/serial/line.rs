//! Format of a line of text: delimiters, and the columns of value, counter, encoder count and status.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::finite_numbers::parse_finite_number;
use crate::sensors::encoder_count;
use crate::sensors::sample_layout::{DecodedSample, InvalidReason, NumberLocation, SampleLayout, check_scale};

/// Keys of `[sensor.serial.line]`; columns count from 1.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LineKeys {
    /// Text that ends each line.
    #[serde(default = "default_end")]
    end: String,
    /// Text at the beginning of each line.
    #[serde(default)]
    prefix: String,
    /// Text at the end of each line, before `end`.
    #[serde(default)]
    suffix: String,
    /// Text between columns; if absent, the text between prefix and suffix is the only column.
    separator: Option<String>,
    /// Number of columns, a line with another number is invalid; if absent, any number is valid.
    columns: Option<usize>,
    value: LineValueKeys,
    counter: Option<LineCounterKeys>,
    encoder_count: Option<LineEncoderKeys>,
    #[serde(default)]
    status: Vec<LineStatusKeys>,
}

/// Keys of the value: value = `offset_mm` + `scale_mm` × the number; columns count from 1.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineValueKeys {
    #[serde(default = "default_column")]
    column: usize,
    /// Millimetres per unit of the number; negative if the sensor counts in the other direction.
    scale_mm: f64,
    #[serde(default)]
    offset_mm: f64,
    /// Words that may appear in place of the value.
    #[serde(default)]
    codes: Vec<LineCodeKeys>,
}

/// Keys of a code: while the column of the value has exactly the text `is`, the value is invalid.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineCodeKeys {
    is: String,
    means: InvalidReason,
}

/// Keys of the counter. The counter increases by one with each sample, up to `round` - 1, and restarts from 0.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineCounterKeys {
    column: usize,
    round: u64,
}

/// Keys of the count of a rotary encoder: an integer that restarts after `round` counts, or never without `round`.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineEncoderKeys {
    column: usize,
    round: Option<u64>,
}

/// Keys of a status: the value is invalid while the column has exactly the text `is`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineStatusKeys {
    column: usize,
    is: String,
    means: InvalidReason,
}

fn default_end() -> String {
    "\n".to_owned()
}

fn default_column() -> usize {
    1
}

/// Format of a line that has passed the checks.
#[derive(Debug, Clone)]
pub(super) struct LineFormat {
    pub line_end: Vec<u8>,
    prefix: String,
    suffix: String,
    /// Text between columns; `None`: the text between prefix and suffix is the only column.
    separator: Option<String>,
    /// Required number of columns; `None`: any number.
    column_count: Option<usize>,
    pub sample_layout: SampleLayout<ColumnNumber>,
}

/// Number of a column, from 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct ColumnNumber(usize);

impl ColumnNumber {
    fn text_in<'t>(self, columns: &[&'t str]) -> Option<&'t str> {
        columns.get(self.0 - 1).copied()
    }
}

impl NumberLocation for ColumnNumber {
    type Data<'d> = &'d [&'d str];
    type Error = ();
    /// Column, and the text in it that makes the value invalid.
    type Condition = (ColumnNumber, String);

    fn read_number(self, columns: &[&str]) -> Result<f64, ()> {
        self.text_in(columns).and_then(parse_decimal_number).ok_or(())
    }

    fn read_integer(self, columns: &[&str]) -> Result<i128, ()> {
        let number = self.text_in(columns).and_then(|text| text.parse::<i64>().ok());
        number.map(i128::from).ok_or(())
    }

    fn is_met((column, text): &(ColumnNumber, String), columns: &[&str]) -> bool {
        column.text_in(columns) == Some(text)
    }
}

/// Characters that a number may contain.
const NUMBER_CHARACTERS: &str = "0123456789+-.eE";

impl LineFormat {
    /// Keys that must be equal for all sensors of one port.
    pub fn framing_keys(&self) -> [(&'static str, String); 6] {
        let or_none = |text: Option<String>| text.unwrap_or("not set".to_owned());
        [
            ("its table", "[sensor.serial.line]".to_owned()),
            ("`end`", format!("\"{}\"", self.line_end.escape_ascii())),
            ("`prefix`", format!("{:?}", self.prefix)),
            ("`suffix`", format!("{:?}", self.suffix)),
            ("`separator`", or_none(self.separator.as_ref().map(|text| format!("{text:?}")))),
            ("`columns`", or_none(self.column_count.map(|count| count.to_string()))),
        ]
    }

    /// Decodes a line without its end; `None` if it is invalid.
    pub fn decode(&self, line: &[u8]) -> Option<DecodedSample> {
        let text = std::str::from_utf8(line).ok()?;
        let rest = text.strip_prefix(self.prefix.as_str())?.strip_suffix(self.suffix.as_str())?;
        let columns = self.split_columns(rest);
        if self.column_count.is_some_and(|count| count != columns.len()) {
            return None;
        }
        // A line without the value's column is invalid, whatever its status is.
        self.sample_layout.value_location.text_in(&columns)?;
        let decoded = self.sample_layout.decode(&columns).ok()?;
        let modulus = self.sample_layout.counter_modulus().unwrap_or_default();
        decoded.counter_value.is_none_or(|count| count < modulus).then_some(decoded)
    }

    /// Splits the text at the separator and trims each column; a separator of one space stands for any white space.
    fn split_columns<'t>(&self, text: &'t str) -> Vec<&'t str> {
        match self.separator.as_deref() {
            Some(" ") => text.split_ascii_whitespace().collect(),
            Some(separator) => text.split(separator).map(str::trim).collect(),
            None => vec![text.trim()],
        }
    }
}

/// Parses a decimal number; unlike Rust it accepts no `inf` or `nan`.
fn parse_decimal_number(text: &str) -> Option<f64> {
    let is_decimal = text.chars().all(|character| NUMBER_CHARACTERS.contains(character));
    parse_finite_number(text).filter(|_| is_decimal)
}

impl TryFrom<LineKeys> for LineFormat {
    type Error = String;

    fn try_from(keys: LineKeys) -> Result<Self, String> {
        check_delimiters(&keys)?;
        let LineValueKeys { scale_mm, offset_mm, .. } = keys.value;
        check_scale(scale_mm, offset_mm)?;
        check_columns_are_distinct(&keys)?;
        let modulus = |name: &str, column, round| {
            encoder_count::resolve_modulus(name, round, 64).map(|modulus| (ColumnNumber(column), modulus))
        };
        let counter = keys.counter.map(|k| modulus("counter", k.column, Some(k.round)));
        let encoder = keys.encoder_count.map(|k| modulus("encoder_count", k.column, k.round));
        let (counter, encoder) = (counter.transpose()?, encoder.transpose()?);
        let value = ColumnNumber(keys.value.column);
        let codes = keys.value.codes.into_iter();
        let codes = codes.map(|code| ((value, code.is), code.means.reading_flag()));
        let status = keys.status.into_iter().map(|s| ((ColumnNumber(s.column), s.is), s.means.reading_flag()));
        let flags = codes.chain(status).collect();
        Ok(Self {
            line_end: keys.end.into_bytes(),
            prefix: keys.prefix,
            suffix: keys.suffix,
            separator: keys.separator,
            column_count: keys.columns,
            sample_layout: SampleLayout {
                value_location: value,
                scale_mm,
                offset_mm,
                counter_and_modulus: counter,
                encoder_and_modulus: encoder,
                conditions_with_flags: flags,
            },
        })
    }
}

fn check_delimiters(keys: &LineKeys) -> Result<(), String> {
    if keys.end.is_empty() {
        return Err("`end` is empty; set the end of a line: \"\\r\\n\", \"\\n\" or \"\\r\"".to_owned());
    }
    for (name, text) in [("prefix", &keys.prefix), ("suffix", &keys.suffix)] {
        if text.contains(&keys.end) {
            return Err(format!("`{name}` contains `end`: a line could never match; remove `end` from `{name}`"));
        }
    }
    match &keys.separator {
        Some(separator) if separator.is_empty() => {
            Err("`separator` is empty; remove it for lines with one column".to_owned())
        }
        Some(separator) if separator.chars().any(|character| NUMBER_CHARACTERS.contains(character)) => {
            Err(format!("`separator` is `{separator}`, which can be part of a number"))
        }
        _ => Ok(()),
    }
}

/// Checks that each column exists and that no column has two meanings, except several texts of one status.
fn check_columns_are_distinct(keys: &LineKeys) -> Result<(), String> {
    let mut taken = BTreeMap::new();
    let named = [
        ("value", Some(keys.value.column)),
        ("counter", keys.counter.map(|counter| counter.column)),
        ("encoder_count", keys.encoder_count.map(|count| count.column)),
    ];
    let status = keys.status.iter().map(|status| ("status", Some(status.column)));
    for (name, column) in named.into_iter().chain(status) {
        let Some(column) = column else { continue };
        check_column_exists(name, column, keys)?;
        let previous = taken.insert(column, name);
        if let Some(previous) = previous.filter(|previous| *previous != "status") {
            return Err(format!("`{previous}` and `{name}` are both column {column}"));
        }
    }
    Ok(())
}

fn check_column_exists(name: &str, column: usize, keys: &LineKeys) -> Result<(), String> {
    let most = if keys.separator.is_some() { keys.columns.unwrap_or(usize::MAX) } else { 1 };
    if (1..=most).contains(&column) {
        return Ok(());
    }
    let why = match (column, &keys.separator, keys.columns) {
        (0, ..) => "the first column is 1".to_owned(),
        (_, None, _) => "a line without a `separator` has only one column".to_owned(),
        (_, _, columns) => format!("a line has {} columns", columns.unwrap_or_default()),
    };
    Err(format!("`{name}.column` is {column}: {why}"))
}
