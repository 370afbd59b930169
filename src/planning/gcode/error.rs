//! Errors of dialects, of rendering motions as text, and of the comparison of the text with its motions.

use machine::Axis;

/// Error: a dialect is unknown or incomplete, or an option of the machine file does not suit the dialect.
#[derive(Debug, thiserror::Error)]
pub enum DialectError {
    #[error("unknown dialect `{name}`; available: {}", known.join(", "))]
    UnknownDialect { name: String, known: Vec<&'static str> },
    /// The folder of the dialect in `gcode-templates/` is incomplete or contains an invalid file.
    #[error("gcode-templates/{folder}: {reason}")]
    InvalidFolder { folder: String, reason: String },
    /// The value of a key of the machine file, a command or the name of an input, does not suit the dialect.
    #[error("{key} = \"{value}\" in the machine file: {reason}")]
    InvalidOption { key: String, value: String, reason: String },
}

impl DialectError {
    /// What the operator should do next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::UnknownDialect { .. } => "choose an available dialect in [controller] dialect",
            Self::InvalidFolder { .. } => "correct the files in this folder",
            Self::InvalidOption { .. } => {
                "set the key of a command to one M word of the control with its parameters, e.g. \"M64 P1\", and the \
                 key of an input to the name of an input of the control; or remove the key"
            }
        }
    }
}

/// Error: a block cannot be rendered in this dialect.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    #[error("the value {0} is not a finite number")]
    ValueNotFinite(f64),
    #[error("the dialect {dialect} has no template `{missing_template}`: the control does not support this motion")]
    MissingTemplate { dialect: String, missing_template: &'static str },
    #[error("the dialect {dialect} has no word for the axis {axis}")]
    NoWordForAxis { dialect: String, axis: Axis },
    #[error("the step number {0} is too large for an N word (at most 99999)")]
    StepNumberTooLarge(u32),
    #[error("a motion has no target axis")]
    MotionWithoutTargetAxis,
    #[error("template `{template}`: {reason}")]
    TemplateFailed { template: String, reason: String },
}

impl RenderError {
    /// What the operator should do next. Nothing has been sent.
    pub fn remedy(&self) -> String {
        match self {
            RenderError::MissingTemplate { missing_template: "orient", .. } => {
                "write spindle = \"fixed\" in the method's section of the machine file, or choose a \
                 dialect that orients the spindle"
                    .to_owned()
            }
            RenderError::MissingTemplate { dialect, missing_template } => {
                format!("choose another dialect, or add gcode-templates/{dialect}/{missing_template}.j2")
            }
            RenderError::NoWordForAxis { dialect, axis } => {
                format!("choose another dialect, or add {axis} to gcode-templates/{dialect}/dialect.toml")
            }
            RenderError::ValueNotFinite(_)
            | RenderError::StepNumberTooLarge(_)
            | RenderError::MotionWithoutTargetAxis
            | RenderError::TemplateFailed { .. } => "report this error with the plan".to_owned(),
        }
    }
}

/// Error: the text does not agree with the motions that it was rendered from.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadBackMismatch {
    #[error("the program has {read} motions instead of {expected}")]
    MotionCountDiffers { expected: usize, read: usize },
    #[error("line {line} of the program differs from step {step}: {reason}")]
    MotionDiffers { step: u32, line: usize, reason: String },
}
