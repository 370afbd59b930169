//! `dialect.toml`: the settings of a dialect's folder, in addition to its templates.

use serde::Deserialize;

use super::error::DialectError;
use machine::Axis;

/// Contents of `dialect.toml`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DialectFile {
    pub name: String,
    /// Language of the text, for which a G-code reader must exist: `rs274`.
    pub language: String,
    /// File extension of programs, without the dot.
    pub extension: String,
    /// Decimals of positions of linear axes, mm.
    pub decimals_mm: usize,
    /// Decimals of positions of rotary axes, degrees.
    pub decimals_deg: usize,
    /// Axes that the dialect has a word for.
    pub axes: Vec<Axis>,
    /// Work offset slot of the programs: there, work coordinates equal machine coordinates.
    pub work_offset: String,
    /// Form of the names of inputs. Absent: the control has no readable inputs.
    #[serde(default)]
    pub inputs: InputNaming,
}

/// Form of the names of the control's inputs in the machine file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum InputNaming {
    /// The control has no readable inputs.
    #[default]
    None,
    /// Numbers from 0 to 63.
    Numbers,
    /// One upper-case letter, except P.
    Letters,
}

impl InputNaming {
    pub(super) fn check_input_name(self, key: &str, input: Option<&str>) -> Result<(), DialectError> {
        let Some(input) = input else { return Ok(()) };
        let (holds, reason) = match self {
            Self::None => (false, "this control has no readable inputs"),
            Self::Numbers => {
                let number = input.parse::<u8>().is_ok_and(|number| number < 64);
                (number, "the inputs of this control are numbered from 0 to 63")
            }
            Self::Letters => {
                let is_letter = |c: char| c.is_ascii_uppercase() && c != 'P';
                let one = input.len() == 1 && input.chars().all(is_letter);
                (one, "the inputs of this control have one-letter names, and P is the probe input")
            }
        };
        let (key, value) = (key.to_owned(), input.to_owned());
        if holds { Ok(()) } else { Err(DialectError::InvalidOption { key, value, reason: reason.to_owned() }) }
    }
}
