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
        let number: usize = label.split('/').nth(1).and_then(|number| number.parse().ok()).ok_or(())?;
        let purposes = [Self::Mount, Self::Centring, Self::Reference, Self::Forward, Self::Backward];
        purposes.map(|purpose| purpose(number)).into_iter().find(|candidate| candidate.to_string() == label).ok_or(())
    }
}
