//! What a run tells while it goes on: to the journal, the terminal and, later, the page.

use serde::{Deserialize, Serialize};

use super::plan::Stage;
use super::proof::Proof;
use super::reading::Reading;
use super::watch::LiveValues;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum Event {
    /// Free text for the person at the machine.
    Announced {
        text: String,
    },
    /// The text of a stage was read back and proven; nothing of it has moved yet.
    StageProven {
        stage: u32,
        proof: Proof,
    },
    StageStarted {
        stage: Stage,
    },
    StepStarted {
        step: u32,
        repeat: u32,
        label: String,
        remaining_s: f64,
    },
    ReadingStored {
        reading: Reading,
    },
    /// A person is asked to do this; nothing moves until somebody has said that it is done.
    Asked {
        step: u32,
        repeat: u32,
        text: String,
    },
    /// The watched sensors of a prompt while it waits, a few times a second; not in the journal.
    Watched {
        values: LiveValues,
    },
    /// Somebody has done it.
    Answered {
        step: u32,
        repeat: u32,
        who: String,
    },
    /// All samples of a scan.
    ScanStored {
        step: u32,
        samples: usize,
        flagged: usize,
    },
    Held {
        reason: String,
    },
    Faulted {
        what: String,
        remedy: String,
        /// The control may not know where its axes are: they must be homed before the run goes on.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        position_lost: bool,
    },
    /// A person has looked at the machine after a fault or a stop.
    Acknowledged {
        who: String,
        what: String,
        /// The run is left as it is, and new ones may begin; otherwise it is this one that goes on.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        leaves: bool,
    },
    /// The run goes on after an interruption; `gap_s` as in the plan.
    Resumed {
        gap_s: f64,
    },
    Finished,
    /// So many scans have lost their samples, because their time to be kept was over.
    SamplesRemoved {
        scans: u32,
    },
}
