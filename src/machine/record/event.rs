//! Events of a run, for the journal, the terminal, the log and state of the service, and, from the journal, the web
//! page of the run.

use serde::{Deserialize, Serialize};

use super::plan::Stage;
use super::reading::Reading;
use super::stage_proof::StageProof;
use super::tool_centre::ToolCentreReading;
use super::watched_sensors::LiveValues;

/// Event of a run. `step`: id of a step; `repeat`: its pass, coded as in `Stage::repeat`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum RunEvent {
    /// Free text for the operator.
    #[serde(rename = "announced")]
    OperatorMessage { text: String },
    /// The control has passed all checks before motion; `identity`: its firmware and version.
    ControlPrepared { identity: String },
    /// The prompts of a stage are confirmed, and its text was read back and proven; none of its motions has started.
    StageProven { stage: u32, proof: StageProof },
    /// The stage is stored; its prompts and its proof follow. After a stop, `stage` has the remaining steps only.
    StageStarted { stage: Stage },
    /// A step begins. `remaining_s`: computed machine time from the start of this step to the end of the run.
    StepStarted { step: u32, repeat: u32, label: String, remaining_s: f64 },
    /// The reading of a touch is stored; the samples of a scan are reported by `ScanStored`.
    ReadingStored { reading: Reading },
    /// The prompt waits for the operator; nothing moves until the operator confirms it.
    #[serde(rename = "asked")]
    PromptStarted { step: u32, repeat: u32, text: String },
    /// Values of the watched sensors while a prompt waits, a few times per second; not in the journal.
    Watched { values: LiveValues },
    /// The operator has confirmed the prompt.
    #[serde(rename = "answered")]
    PromptConfirmed { step: u32, repeat: u32, who: String },
    /// All samples of a scan are stored; `flagged` of them have a flag.
    ScanStored { step: u32, samples: usize, flagged: usize },
    /// The tool centre by the control after the step `step`: after the last step of a stage, and before the machine
    /// turns to another position of its rotary axes.
    ToolCentreRead { step: u32, repeat: u32, reading: ToolCentreReading },
    /// The run is interrupted because a person requested the stop.
    Held { reason: String },
    /// The run is interrupted by an error, or its readings cannot be identified. `what`: the error.
    Faulted {
        what: String,
        remedy: String,
        /// Whether the control may have lost the axis positions: the axes must be homed before the run continues.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        position_lost: bool,
    },
    /// The operator has checked the machine after a fault or a stop. `what`: what was confirmed, as text.
    Acknowledged {
        who: String,
        what: String,
        /// Whether the run is abandoned, so that new runs may begin; otherwise this run continues.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        leaves: bool,
    },
    /// The run continues after an interruption. `gap_s`: time of the last reading before it, on the clock of the
    /// readings.
    Resumed { gap_s: f64 },
    /// All stages are measured; the identification follows.
    Finished,
    /// The samples of this many scans were removed, because their retention time was over.
    SamplesRemoved { scans: u32 },
}
