//! Errors in a readings file, with their location and remedy.

use super::FIRST_LINE;
use machine::record::reading::UnknownFlag;

/// A problem and its line (from 1).
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("readings file, line {line}: {problem}")]
pub struct ReadingsError {
    pub line: u64,
    #[source]
    pub problem: Problem,
}

#[derive(Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    #[error("the file must begin with `{FIRST_LINE}`, not with `{found}`")]
    FirstLine { found: String },
    #[error("this is not UTF-8 text; save the file as UTF-8")]
    NotUtf8,
    #[error("there is no line of column names; give at least step,x_mm,y_mm,z_mm")]
    NoHeader,
    #[error("unknown column `{name}`; the nearest known one is `{nearest}`")]
    UnknownColumn { name: String, nearest: String },
    #[error("column `{name}` stands twice; remove one")]
    RepeatedColumn { name: String },
    #[error("column `{name}` is missing; every reading needs it")]
    MissingColumn { name: String },
    #[error("{found} fields instead of {expected}; is the line cut off?")]
    FieldCount { found: usize, expected: usize },
    #[error("the last line has no line end; if the file is complete and not cut off, add one")]
    CutOff,
    #[error("`{name}` is empty; every reading needs it, or, for times, leave out the column")]
    Empty { name: String },
    #[error("`{text}` in `{name}` is not a number; write it like 12 or -0.125")]
    NotANumber { name: String, text: String },
    #[error("`{text}` in `{name}` is not a whole number from 0 up")]
    NotACount { name: String, text: String },
    #[error("`{text}` in `{name}` is not finite; remove the row and measure the step again")]
    NotFinite { name: String, text: String },
    #[error(transparent)]
    Flag(#[from] UnknownFlag),
    #[error(
        "step {step} repeat {repeat} stands already in line {first}; \
         number repeated touches in `repeat`"
    )]
    Duplicate { step: u32, repeat: u32, first: u64 },
    #[error("{0}")]
    Csv(String),
}
