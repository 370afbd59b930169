//! Two stored runs beside each other.

use serde::Serialize;

use crate::store::{Journal, RunId, RunSummary, StoreError, StoredRun};
use methods::decision::difference::{Difference, differences};

#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("run {} measured by {}, run {} by {}", .0.id, .0.method, .1.id, .1.method)]
    Methods(Box<RunSummary>, Box<RunSummary>),
}

impl CompareError {
    /// What to do next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Store(error) => error.remedy(),
            Self::NoEstimate(_) => "take a run that has come to its end",
            Self::Methods(..) => "take two runs of one method",
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    pub runs: [RunSummary; 2],
    pub differences: Vec<Difference>,
    /// What else is not the same, in words.
    pub besides: Vec<String>,
}

/// The last estimates of two runs of one method.
///
/// # Errors
/// No such run, no estimate, or runs of different methods.
pub fn compare(journal: &Journal, first: RunId, second: RunId) -> Result<Comparison, CompareError> {
    let [one, other] = [journal.load(first)?, journal.load(second)?];
    if one.summary.method != other.summary.method {
        return Err(CompareError::Methods(Box::new(one.summary), Box::new(other.summary)));
    }
    let last = |run: &StoredRun| {
        let last = run.estimates.last().map(|stored| stored.estimate.clone());
        last.ok_or(CompareError::NoEstimate(run.summary.id))
    };
    let differences = differences(&last(&one)?, &last(&other)?);
    let besides = besides(&one, &other);
    Ok(Comparison { runs: [one.summary, other.summary], differences, besides })
}

fn besides(one: &StoredRun, other: &StoredRun) -> Vec<String> {
    let said = [
        (one.summary.machine != other.summary.machine, "they are of two machines"),
        (one.config != other.config, "the machine file was changed between them"),
        (one.plan.settings != other.plan.settings, "the settings of the method differ"),
        (one.plan.artefact != other.plan.artefact, "the artefact is stated differently"),
    ];
    said.into_iter().filter(|(differs, _)| *differs).map(|(_, words)| words.to_owned()).collect()
}
