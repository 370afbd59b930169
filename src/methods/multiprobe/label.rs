//! Labels of the steps.

use std::fmt;
use std::str::FromStr;

/// Purpose of a step. Mountings and rounds of centring are counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepLabel {
    Mount(usize),
    Centring(usize),
    Reference(usize),
    Forward(usize),
    Backward(usize),
}

impl fmt::Display for StepLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mount(number) => write!(f, "mount/{number}"),
            Self::Centring(round) => write!(f, "centring/{round}"),
            Self::Reference(number) => write!(f, "reference/{number}"),
            Self::Forward(number) => write!(f, "index/{number}/forward"),
            Self::Backward(number) => write!(f, "index/{number}/backward"),
        }
    }
}

impl FromStr for StepLabel {
    type Err = ();

    fn from_str(label: &str) -> Result<Self, ()> {
        let parts: Vec<&str> = label.split('/').collect();
        let number = parts.get(1).and_then(|number| number.parse().ok()).ok_or(())?;
        match (parts.first().copied(), parts.get(2).copied()) {
            (Some("mount"), None) => Ok(Self::Mount(number)),
            (Some("centring"), None) => Ok(Self::Centring(number)),
            (Some("reference"), None) => Ok(Self::Reference(number)),
            (Some("index"), Some("forward")) => Ok(Self::Forward(number)),
            (Some("index"), Some("backward")) => Ok(Self::Backward(number)),
            _ => Err(()),
        }
    }
}
