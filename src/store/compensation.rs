//! Compensations: values that were written to a control. A compensation is stored before the first write to the
//! control; each later state is a new row. Rows are never changed.

use jiff::Timestamp;
use rusqlite::{Connection, Row, params};
use serde::{Deserialize, Serialize};

use super::{AwaitableWrite, Journal, RunId, StoreError, StoreFault, columns};

/// A value of the control, before and after a compensation. A value that stays equal is not written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CompensationValue {
    /// Name of the value at the control.
    pub name: String,
    /// Value of the control before the write.
    pub before_mm: f64,
    /// The value before, as the control stated it. Empty: as `before_mm`, in journals before format 10.
    #[serde(default)]
    pub before_text: String,
    /// Value of the control after the write.
    pub after_mm: f64,
}

/// State of a compensation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CompensationState {
    /// The write may be incomplete.
    Writing,
    /// All values were written and read back. The control uses them after its next start.
    AwaitingRestart,
    /// All values were written and read back, and the control uses them.
    Written,
    /// A later run has measured what the estimate of the compensation predicts.
    Verified,
    /// A later run has measured something else than predicted. The values stay in the control, and the machine may
    /// move.
    NotConfirmed,
    /// The return to the values before may be incomplete.
    Undoing,
    /// All earlier values are restored. The control uses them after its next start.
    UndoneAwaitingRestart,
    /// All earlier values are restored, and the control uses them.
    Undone,
}

impl CompensationState {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Writing => "writing",
            Self::AwaitingRestart => "awaiting-restart",
            Self::Written => "written",
            Self::Verified => "verified",
            Self::NotConfirmed => "not-confirmed",
            Self::Undoing => "undoing",
            Self::UndoneAwaitingRestart => "undone-awaiting-restart",
            Self::Undone => "undone",
        }
    }

    /// Whether the machine must not move: a write or an undo may be incomplete, or the control must be started again.
    pub fn forbids_motion(self) -> bool {
        !matches!(self, Self::Written | Self::Verified | Self::NotConfirmed | Self::Undone)
    }

    /// Whether the earlier values are in the control again, used already or only after its next start.
    pub fn is_undone(self) -> bool {
        matches!(self, Self::UndoneAwaitingRestart | Self::Undone)
    }

    /// Whether the control must be started again.
    pub fn awaits_restart(self) -> bool {
        matches!(self, Self::AwaitingRestart | Self::UndoneAwaitingRestart)
    }
}

/// An unfinished compensation. The machine must not move until a person finishes or undoes it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("compensation {id} is unfinished: {}", self.reason())]
pub struct UnfinishedCompensation {
    /// Number of the compensation.
    pub id: i64,
    /// Kind of the values, as a key of `[compensation]`.
    pub target: String,
    state: CompensationState,
}

impl UnfinishedCompensation {
    fn reason(&self) -> &'static str {
        match self.state.awaits_restart() {
            true => "the control uses its values only after a restart",
            false => "some values of the control may be new and others old",
        }
    }

    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        let target = &self.target;
        match self.state.awaits_restart() {
            true => format!(
                "restart the control, home all axes, and move each corrected axis near an end of its travel, then confirm with \
                 `trued compensate finish --target {target} --machine FILE --who NAME`"
            ),
            false => format!(
                "restore the earlier values with `trued compensate undo --target {target} --machine FILE --who NAME`, or write \
                 the rest with `finish` in place of `undo`"
            ),
        }
    }
}

/// Compensation to be written to a control.
#[derive(Debug, Clone, PartialEq)]
pub struct NewCompensation {
    pub machine: String,
    /// Kind of the values, as a key of `[compensation]`.
    pub target: String,
    /// Run whose estimate is the reason.
    pub run: RunId,
    /// Person who writes the compensation.
    pub who: String,
    /// SHA-256 of the approved proposal.
    pub proposal_sha256: String,
    /// All values of the target, unchanged ones included.
    pub changes: Vec<CompensationValue>,
}

/// A compensation with its last state.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StoredCompensation {
    /// Number of the compensation.
    pub id: i64,
    pub machine: String,
    /// Kind of the values, as a key of `[compensation]`.
    pub target: String,
    /// Run whose estimate is the reason for the compensation.
    pub run: RunId,
    /// All values of the target, unchanged ones included.
    pub changes: Vec<CompensationValue>,
    pub state: CompensationState,
    /// Time at which the state was stored.
    pub at: Timestamp,
    /// Person who caused the state.
    pub who: String,
    /// Run whose comparison gave the last state, `Verified` or `NotConfirmed`; `None`: the last state has another
    /// cause.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verified_by: Option<RunId>,
}

impl StoredCompensation {
    /// Whether `run` may verify the compensation: the values are in the control and used by it, and the run is newer
    /// than the run of the compensation and not older than that of its last verification.
    pub fn can_be_verified_by(&self, run: RunId) -> bool {
        let is_newer = run.0 > self.run.0 && self.verified_by.is_none_or(|last| run.0 >= last.0);
        is_newer && !self.state.is_undone() && !self.state.forbids_motion()
    }

    /// The unfinished compensation, which forbids motion; `None`: the machine may move.
    pub fn unfinished(&self) -> Option<UnfinishedCompensation> {
        let Self { id, target, state, .. } = self;
        state.forbids_motion().then(|| UnfinishedCompensation { id: *id, target: target.clone(), state: *state })
    }
}

/// Event in a history: the control began to use the values of a compensation, or the earlier values again.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompensationEvent {
    /// Number of the compensation; its events have the same number.
    pub id: i64,
    /// Kind of the values, as a key of `[compensation]`.
    pub target: String,
    /// Run whose estimate is the reason for the compensation, also if `is_undone`.
    pub run: RunId,
    /// Whether the earlier values are used again; `false`: the compensation took effect.
    pub is_undone: bool,
    /// Time at which the journal stored that the control uses the values.
    pub at: Timestamp,
}

impl Journal {
    /// Adds the compensation in state `Writing`, before the first write to the control. Returns the number of the
    /// compensation.
    pub fn begin_compensation(&self, new: &NewCompensation) -> AwaitableWrite<i64> {
        let new = new.clone();
        self.submit_job(move |connection| insert_compensation(connection, &new))
    }

    /// Adds a state to the compensation `id`.
    pub fn set_compensation_state(&self, id: i64, state: CompensationState, who: &str) -> AwaitableWrite<()> {
        let who = who.to_owned();
        self.submit_job(move |connection| insert_state(connection, id, state, &who, None))
    }

    /// Adds the result of a verification by `run`: `state` is `Verified` or `NotConfirmed`.
    pub fn set_compensation_verification(
        &self,
        id: i64,
        state: CompensationState,
        who: &str,
        run: RunId,
    ) -> AwaitableWrite<()> {
        let who = who.to_owned();
        self.submit_job(move |connection| insert_state(connection, id, state, &who, Some(run)))
    }

    /// The compensation of `machine` that a person must finish or undo, if any; until then the machine must not move.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn unfinished_compensation(&self, machine: &str) -> Result<Option<UnfinishedCompensation>, StoreError> {
        Ok(self.compensations(machine)?.iter().find_map(StoredCompensation::unfinished))
    }

    /// Times at which compensations of `machine` took effect or were undone, oldest first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn compensation_history(&self, machine: &str) -> Result<Vec<CompensationEvent>, StoreError> {
        self.query(|connection| select_history(connection, machine))
    }

    /// The compensations of `machine`, newest first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn compensations(&self, machine: &str) -> Result<Vec<StoredCompensation>, StoreError> {
        self.query(|connection| select_compensations(connection, machine))
    }
}

fn insert_compensation(connection: &mut Connection, new: &NewCompensation) -> Result<i64, StoreFault> {
    let changes = columns::to_json_with_finite_numbers("the values of a compensation", &new.changes)?;
    let transaction = connection.transaction()?;
    transaction
        .execute(
            "INSERT INTO compensations (machine, target, run, proposal_sha256, changes) VALUES (?1, ?2, ?3, ?4, ?5)",
            params![new.machine, new.target, new.run.0, new.proposal_sha256, changes],
        )
        .map_err(StoreFault::from_run_error(new.run))?;
    let id = transaction.last_insert_rowid();
    insert_state(&transaction, id, CompensationState::Writing, &new.who, None)?;
    transaction.commit()?;
    Ok(id)
}

fn insert_state(
    connection: &Connection,
    id: i64,
    state: CompensationState,
    who: &str,
    verified_by: Option<RunId>,
) -> Result<(), StoreFault> {
    connection.execute(
        "INSERT INTO compensation_states (compensation, at, who, state, verified_by) VALUES (?1, ?2, ?3, ?4, ?5)",
        params![id, columns::now_text(), who, state.as_str(), verified_by.map(|run| run.0)],
    )?;
    Ok(())
}

fn select_compensations(connection: &Connection, machine: &str) -> Result<Vec<StoredCompensation>, StoreFault> {
    let select = "SELECT id, machine, target, run, changes, state, at, who, verified_by FROM compensations
         JOIN compensation_states AS states ON compensation = id
         WHERE machine = ?1 AND seq = (SELECT max(seq) FROM compensation_states WHERE compensation = id)
         ORDER BY id DESC";
    columns::select_rows(connection, select, [machine], read_row)
}

fn select_history(connection: &Connection, machine: &str) -> Result<Vec<CompensationEvent>, StoreFault> {
    let select = "SELECT id, target, run, state, at FROM compensations
         JOIN compensation_states ON compensation = id
         WHERE machine = ?1 AND state IN ('written', 'undone') ORDER BY seq";
    columns::select_rows(connection, select, [machine], |row| {
        Ok(CompensationEvent {
            id: row.get(0)?,
            target: row.get(1)?,
            run: RunId(row.get(2)?),
            is_undone: row.get::<_, String>(3)? == CompensationState::Undone.as_str(),
            at: columns::parse_text_column(row, 4)?,
        })
    })
}

fn read_row(row: &Row<'_>) -> rusqlite::Result<StoredCompensation> {
    Ok(StoredCompensation {
        id: row.get(0)?,
        machine: row.get(1)?,
        target: row.get(2)?,
        run: RunId(row.get(3)?),
        changes: columns::parse_json_column(row, 4)?,
        state: columns::parse_name_column(row, 5, "state of a compensation")?,
        at: columns::parse_text_column(row, 6)?,
        who: row.get(7)?,
        verified_by: row.get::<_, Option<i64>>(8)?.map(RunId),
    })
}
