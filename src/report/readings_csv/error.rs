//! Errors in a readings file, with their location and remedy.

use super::FIRST_LINE;
use machine::record::reading::UnknownReadingFlag;

/// Problem in a readings file, and its line (from 1).
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("readings file, line {line}: {problem}")]
pub struct ReadingsError {
    pub line: u64,
    #[source]
    pub problem: ReadingsProblem,
}

/// Reason why a readings file is refused. `name`: of the column; `text`: content of the field.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ReadingsProblem {
    #[error("the file must begin with `{FIRST_LINE}`, not with `{found}`")]
    WrongFirstLine { found: String },
    #[error("the file is not UTF-8 text; save it as UTF-8")]
    NotUtf8,
    #[error("the line of column names is missing; write at least step,x_mm,y_mm,z_mm")]
    NoHeader,
    #[error("unknown column `{name}`; the most similar known column is `{nearest}`")]
    UnknownColumn { name: String, nearest: String },
    #[error("column `{name}` occurs twice; remove one of them")]
    RepeatedColumn { name: String },
    #[error("column `{name}` is missing; it is required for every reading")]
    MissingColumn { name: String },
    #[error("{found} fields instead of {expected}; is the line cut off?")]
    WrongFieldCount { found: usize, expected: usize },
    #[error("the last line has no line end; if the file is complete and not cut off, add one")]
    NoFinalLineEnd,
    #[error("`{name}` is empty; write a value for every reading, or remove the column if it contains times")]
    EmptyField { name: String },
    #[error("`{text}` in `{name}` is not a number; write a number such as 12 or -0.125")]
    NotANumber { name: String, text: String },
    #[error("`{text}` in `{name}` is not a whole number of at least 0")]
    NotACount { name: String, text: String },
    #[error("`{text}` in `{name}` is not finite; remove the row and measure the step again")]
    NotFinite { name: String, text: String },
    #[error(transparent)]
    UnknownFlag(#[from] UnknownReadingFlag),
    #[error("step {step} repeat {repeat} occurs already in line {first_line}; number repeated touches in `repeat`")]
    DuplicateTouch { step: u32, repeat: u32, first_line: u64 },
    #[error("{0}")]
    InvalidCsv(String),
}
