//! What a run tells while it goes on: to the journal, the terminal and, later, the page.

use serde::{Deserialize, Serialize};

use super::plan::Stage;
use super::reading::Reading;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum Event {
    /// Free text for the person at the machine.
    Announced {
        text: String,
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
    Held {
        reason: String,
    },
    Faulted {
        what: String,
        remedy: String,
    },
    Finished,
}
