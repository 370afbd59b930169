//! A line of text: position and format of the value in it.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::sensors::encoder;
use crate::sensors::layout::{Decoded, Means};
use machine::record::reading::Flag;

/// Keys of `[sensor.serial.line]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Keys {
    #[serde(default = "feed")]
    end: String,
    /// Text at the beginning of each line; `suffix`: text at its end.
    #[serde(default)]
    prefix: String,
    #[serde(default)]
    suffix: String,
    /// Text between columns; if absent, the text between prefix and suffix is the only column.
    separator: Option<String>,
    /// Number of columns; a line with another number is invalid.
    columns: Option<usize>,
    value: ValueKeys,
    counter: Option<CounterKeys>,
    encoder_count: Option<EncoderCountKeys>,
    #[serde(default)]
    status: Vec<StatusKeys>,
}

/// Keys of the value: value = `offset_mm` + `scale_mm` × the number; columns count from 1.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ValueKeys {
    #[serde(default = "one")]
    column: usize,
    scale_mm: f64,
    #[serde(default)]
    offset_mm: f64,
    /// Words that may appear in place of the value.
    #[serde(default)]
    codes: Vec<CodeKeys>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CodeKeys {
    is: String,
    means: Means,
}

/// Keys of the counter: it increases by one with each sample, up to `round` - 1, and restarts from 0.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct CounterKeys {
    column: usize,
    round: u64,
}

/// Keys of the count of a rotary encoder, an integer; without `round` it is unlimited.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct EncoderCountKeys {
    column: usize,
    round: Option<u64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StatusKeys {
    column: usize,
    is: String,
    means: Means,
}

fn feed() -> String {
    "\n".to_owned()
}

fn one() -> usize {
    1
}

/// A line layout that has passed the checks.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub end: Vec<u8>,
    prefix: String,
    suffix: String,
    separator: Option<String>,
    columns: Option<usize>,
    value: usize,
    scale_mm: f64,
    offset_mm: f64,
    counter: Option<CounterKeys>,
    /// Column of the encoder's count, and number of different counts.
    encoder: Option<(usize, u64)>,
    /// Column, text and meaning of each status.
    says: Vec<(usize, String, Flag)>,
}

/// Permitted range of the number of different counts of a counter.
const ROUNDS: std::ops::RangeInclusive<u64> = 2..=1 << 32;
/// Characters of a number.
const OF_NUMBERS: &str = "0123456789+-.eE";

impl Layout {
    pub fn round(&self) -> Option<u64> {
        self.counter.map(|counter| counter.round)
    }

    pub fn encoder_round(&self) -> Option<u64> {
        self.encoder.map(|(_, round)| round)
    }

    /// Keys that must be equal for all sensors of one port.
    pub fn framing(&self) -> [(&'static str, String); 6] {
        let or_none = |text: Option<String>| text.unwrap_or("not set".to_owned());
        [
            ("its table", "[sensor.serial.line]".to_owned()),
            ("`end`", format!("\"{}\"", self.end.escape_ascii())),
            ("`prefix`", format!("{:?}", self.prefix)),
            ("`suffix`", format!("{:?}", self.suffix)),
            ("`separator`", or_none(self.separator.as_ref().map(|text| format!("{text:?}")))),
            ("`columns`", or_none(self.columns.map(|count| count.to_string()))),
        ]
    }

    /// Decodes a line without its end; `None` if it is invalid.
    pub fn read(&self, line: &[u8]) -> Option<Decoded> {
        let text = std::str::from_utf8(line).ok()?;
        let rest = text.strip_prefix(self.prefix.as_str())?.strip_suffix(self.suffix.as_str())?;
        let columns = self.split(rest);
        if self.columns.is_some_and(|count| count != columns.len()) {
            return None;
        }
        let counter = match self.counter {
            Some(CounterKeys { column, round }) => {
                let count: u64 = columns.get(column - 1)?.parse().ok()?;
                Some(Some(count).filter(|count| *count < round)?)
            }
            None => None,
        };
        let encoder_count = match self.encoder {
            Some((column, round)) => {
                let count: i64 = columns.get(column - 1)?.parse().ok()?;
                Some(encoder::wrapped(count.into(), round))
            }
            None => None,
        };
        let value = *columns.get(self.value - 1)?;
        let said = |(column, is, _): &&(usize, String, Flag)| {
            columns.get(column - 1) == Some(&is.as_str())
        };
        let value = match self.says.iter().find(said) {
            Some((.., flag)) => Err(*flag),
            None => Ok(self.offset_mm + self.scale_mm * number(value)?),
        };
        Some(Decoded { value, counter, encoder_count })
    }

    fn split<'t>(&self, text: &'t str) -> Vec<&'t str> {
        match self.separator.as_deref() {
            Some(" ") => text.split_ascii_whitespace().collect(),
            Some(separator) => text.split(separator).map(str::trim).collect(),
            None => vec![text.trim()],
        }
    }
}

/// Parses a decimal number; unlike Rust it accepts no `inf` or `nan`.
fn number(text: &str) -> Option<f64> {
    let plain = text.chars().all(|character| OF_NUMBERS.contains(character));
    text.parse().ok().filter(|number: &f64| plain && number.is_finite())
}

impl TryFrom<Keys> for Layout {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        check_ends(&keys)?;
        check_numbers(&keys.value)?;
        check_columns(&keys)?;
        if keys.counter.is_some_and(|counter| !ROUNDS.contains(&counter.round)) {
            return Err("`counter.round` is how many different numbers it counts: 2 to 4294967296"
                .to_owned());
        }
        let round = |keys: EncoderCountKeys| {
            encoder::round(keys.round, 64).map(|round| (keys.column, round))
        };
        let encoder = keys.encoder_count.map(round).transpose()?;
        let codes = keys.value.codes.into_iter();
        let codes = codes.map(|code| (keys.value.column, code.is, code.means.flag()));
        let status = keys.status.into_iter().map(|s| (s.column, s.is, s.means.flag()));
        Ok(Self {
            end: keys.end.into_bytes(),
            prefix: keys.prefix,
            suffix: keys.suffix,
            separator: keys.separator,
            columns: keys.columns,
            value: keys.value.column,
            scale_mm: keys.value.scale_mm,
            offset_mm: keys.value.offset_mm,
            counter: keys.counter,
            encoder,
            says: codes.chain(status).collect(),
        })
    }
}

fn check_ends(keys: &Keys) -> Result<(), String> {
    if keys.end.is_empty() {
        return Err("`end` must be what ends a line: \"\\r\\n\", \"\\n\" or \"\\r\"".to_owned());
    }
    for (name, text) in [("prefix", &keys.prefix), ("suffix", &keys.suffix)] {
        if text.contains(&keys.end) {
            return Err(format!("`{name}` holds the line's `end`: it would never be seen"));
        }
    }
    match &keys.separator {
        Some(separator) if separator.is_empty() => {
            Err("`separator` is empty; leave it out where a line has one column".to_owned())
        }
        Some(separator) if separator.chars().any(|character| OF_NUMBERS.contains(character)) => {
            Err(format!("`separator` is `{separator}`, which can stand in a number"))
        }
        _ => Ok(()),
    }
}

fn check_numbers(value: &ValueKeys) -> Result<(), String> {
    if value.scale_mm == 0.0 || !value.scale_mm.is_finite() {
        return Err(format!(
            "`value.scale_mm` is {}: every reading would be the same; it is the mm of what the line \
             counts, 1.0 where it writes mm",
            value.scale_mm
        ));
    }
    if !value.offset_mm.is_finite() {
        return Err("`value.offset_mm` must be a finite number".to_owned());
    }
    Ok(())
}

/// Checks that no column has two meanings, except several texts of one status.
fn check_columns(keys: &Keys) -> Result<(), String> {
    let mut taken = BTreeMap::new();
    let named = [
        ("value", Some(keys.value.column)),
        ("counter", keys.counter.map(|counter| counter.column)),
        ("encoder_count", keys.encoder_count.map(|count| count.column)),
    ];
    let status = keys.status.iter().map(|status| ("status", Some(status.column)));
    for (name, column) in named.into_iter().chain(status) {
        let Some(column) = column else { continue };
        check_column(name, column, keys)?;
        let other = taken.insert(column, name);
        if let Some(other) = other.filter(|other| *other != "status") {
            return Err(format!("`{other}` and `{name}` are both column {column}"));
        }
    }
    Ok(())
}

fn check_column(name: &str, column: usize, keys: &Keys) -> Result<(), String> {
    let most = if keys.separator.is_some() { keys.columns.unwrap_or(usize::MAX) } else { 1 };
    if (1..=most).contains(&column) {
        return Ok(());
    }
    let why = match (column, &keys.separator, keys.columns) {
        (0, ..) => "columns count from 1".to_owned(),
        (_, None, _) => "without a `separator` a line has one column".to_owned(),
        (_, _, columns) => format!("a line has {} columns", columns.unwrap_or_default()),
    };
    Err(format!("`{name}.column` is {column}: {why}"))
}
