//! Labels of the steps.

use std::fmt;
use std::str::FromStr;

/// Label of a step: its purpose, with the number of the mounting or of the centring round, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepLabel {
    /// Prompt to mount the artefact at this index.
    MountPrompt(usize),
    /// Turn of a centring round. The prompt before it has the label `centre/N`, which is not a `StepLabel`.
    CentringRound(usize),
    /// Scan with two stops that is repeated after an interruption of this mounting.
    MountingReference(usize),
    ForwardTurn(usize),
    BackwardTurn(usize),
}

impl fmt::Display for StepLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            StepLabel::MountPrompt(number) => write!(f, "mount/{number}"),
            StepLabel::CentringRound(round) => write!(f, "centring/{round}"),
            StepLabel::MountingReference(number) => write!(f, "reference/{number}"),
            StepLabel::ForwardTurn(number) => write!(f, "index/{number}/forward"),
            StepLabel::BackwardTurn(number) => write!(f, "index/{number}/backward"),
        }
    }
}

impl FromStr for StepLabel {
    type Err = ();

    fn from_str(label: &str) -> Result<Self, ()> {
        let number: usize = label.split('/').nth(1).and_then(|number| number.parse().ok()).ok_or(())?;
        let purposes = [
            StepLabel::MountPrompt,
            StepLabel::CentringRound,
            StepLabel::MountingReference,
            StepLabel::ForwardTurn,
            StepLabel::BackwardTurn,
        ];
        purposes.map(|purpose| purpose(number)).into_iter().find(|candidate| candidate.to_string() == label).ok_or(())
    }
}
