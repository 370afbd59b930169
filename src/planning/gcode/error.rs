//! Errors between motion and text.

use super::rs274::ReadError;
use machine::Axis;

/// Error: a dialect is missing or incomplete.
#[derive(Debug, thiserror::Error)]
pub enum DialectError {
    #[error("no dialect is called `{name}`; there are {}", known.join(", "))]
    Unknown { name: String, known: Vec<String> },
    #[error("gcode-templates/{folder}: {why}")]
    Broken { folder: String, why: String },
    #[error("{key} = \"{value}\" in the machine file: {why}")]
    Option { key: String, value: String, why: String },
}

impl DialectError {
    /// What the operator should do next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Unknown { .. } => "choose one of them in [controller] dialect",
            Self::Broken { .. } => "correct that folder",
            Self::Option { .. } => {
                "give one M word of your control with its parameters, e.g. \"M64 P1\"; an input as \
                 the control names it; or remove the key"
            }
        }
    }
}

/// Error: a block cannot be rendered in this dialect.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    #[error("a value is {0}, not a number that a control can be given")]
    NotFinite(f64),
    #[error("the dialect {dialect} has no template `{what}`: this control cannot do it")]
    Unsupported { dialect: String, what: &'static str },
    #[error("the dialect {dialect} has no word for the axis {axis}")]
    NoWord { dialect: String, axis: Axis },
    #[error("step {0} does not fit into an N word (at most 99999)")]
    StepTooLarge(u32),
    #[error("a motion without an axis to move")]
    NoTarget,
    #[error("template `{template}`: {why}")]
    Template { template: String, why: String },
}

impl RenderError {
    /// What the operator should do next. Nothing has been sent.
    pub fn remedy(&self) -> String {
        match self {
            Self::Unsupported { what: "orient", .. } => {
                "write spindle = \"fixed\" in the method's section of the machine file, or choose a \
                 dialect that orients the spindle"
                    .to_owned()
            }
            Self::Unsupported { dialect, what } => {
                format!("choose another dialect, or add gcode-templates/{dialect}/{what}.j2")
            }
            Self::NoWord { dialect, axis } => format!(
                "choose another dialect, or add {axis} to gcode-templates/{dialect}/dialect.toml"
            ),
            Self::NotFinite(_)
            | Self::StepTooLarge(_)
            | Self::NoTarget
            | Self::Template { .. } => "please report this with the plan".to_owned(),
        }
    }
}

/// Error: the text does not agree with the motions that it was rendered from.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Disagreement {
    #[error("the program cannot be read back: {0}")]
    Unreadable(#[from] ReadError),
    #[error("{meant} motions were meant, {read} are read back")]
    Count { meant: usize, read: usize },
    #[error("line {line} of the program does not say what step {step} means: {why}")]
    Motion { step: u32, line: usize, why: String },
}
