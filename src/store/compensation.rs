//! Compensations: values that were written to a control. Each is an intent before the first write; its states follow.
//! Rows are never changed.

use jiff::Timestamp;
use rusqlite::{Connection, OptionalExtension, Row, params};
use serde::{Deserialize, Serialize};

use super::{AwaitableWrite, Journal, RunId, StoreError, StoreFault, columns};

/// A value of the control, before and after.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CompensationChange {
    /// Name at the control.
    pub name: String,
    pub before_mm: f64,
    pub after_mm: f64,
}

/// State of a compensation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CompensationState {
    /// The write may be incomplete.
    Writing,
    /// All values were written and read back.
    Written,
    /// The return to the values before may be incomplete.
    Undoing,
    /// All values are as before.
    Undone,
}

impl CompensationState {
    const ALL: [Self; 4] = [Self::Writing, Self::Written, Self::Undoing, Self::Undone];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Writing => "writing",
            Self::Written => "written",
            Self::Undoing => "undoing",
            Self::Undone => "undone",
        }
    }

    /// Whether some values may be new and others old.
    fn is_unfinished(self) -> bool {
        matches!(self, Self::Writing | Self::Undoing)
    }
}

/// What is to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct NewCompensation {
    pub machine: String,
    /// Run whose estimate is the reason.
    pub run: RunId,
    pub who: String,
    /// Hash of the approved proposal.
    pub proposal_sha256: String,
    pub changes: Vec<CompensationChange>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StoredCompensation {
    pub id: i64,
    pub machine: String,
    pub run: RunId,
    pub changes: Vec<CompensationChange>,
    pub state: CompensationState,
    /// Time of the state, and the person who caused it.
    pub at: Timestamp,
    pub who: String,
}

impl Journal {
    /// Adds the intent to write. Returns the number of the compensation.
    pub fn begin_compensation(&self, new: &NewCompensation) -> AwaitableWrite<i64> {
        let new = new.clone();
        self.submit_job(move |connection| insert_compensation(connection, &new))
    }

    /// Adds a state.
    pub fn set_compensation_state(&self, id: i64, state: CompensationState, who: &str) -> AwaitableWrite<()> {
        let who = who.to_owned();
        self.submit_job(move |connection| insert_state(connection, id, state, &who))
    }

    /// The newest compensation of `machine`, if it may be incomplete: then the machine must not move.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn unfinished_compensation(&self, machine: &str) -> Result<Option<StoredCompensation>, StoreError> {
        Ok(self.last_compensation(machine)?.filter(|last| last.state.is_unfinished()))
    }

    /// The newest compensation of `machine`.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn last_compensation(&self, machine: &str) -> Result<Option<StoredCompensation>, StoreError> {
        self.query(|connection| select_last(connection, machine))
    }
}

fn insert_compensation(connection: &mut Connection, new: &NewCompensation) -> Result<i64, StoreFault> {
    let changes = columns::to_json_with_finite_numbers("the values of a compensation", &new.changes)?;
    let transaction = connection.transaction()?;
    transaction
        .execute(
            "INSERT INTO compensations (machine, run, proposal_sha256, changes) VALUES (?1, ?2, ?3, ?4)",
            params![new.machine, new.run.0, new.proposal_sha256, changes],
        )
        .map_err(StoreFault::from_run_error(new.run))?;
    let id = transaction.last_insert_rowid();
    insert_state(&transaction, id, CompensationState::Writing, &new.who)?;
    transaction.commit()?;
    Ok(id)
}

fn insert_state(connection: &Connection, id: i64, state: CompensationState, who: &str) -> Result<(), StoreFault> {
    connection.execute(
        "INSERT INTO compensation_states (compensation, at, who, state) VALUES (?1, ?2, ?3, ?4)",
        params![id, columns::now_text(), who, state.as_str()],
    )?;
    Ok(())
}

fn select_last(connection: &Connection, machine: &str) -> Result<Option<StoredCompensation>, StoreFault> {
    let select = "SELECT id, machine, run, changes, state, at, who FROM compensations
         JOIN compensation_states ON compensation = id WHERE machine = ?1
         ORDER BY id DESC, compensation_states.seq DESC LIMIT 1";
    Ok(connection.query_row(select, params![machine], read_row).optional()?)
}

fn read_row(row: &Row<'_>) -> rusqlite::Result<StoredCompensation> {
    let text: String = row.get(4)?;
    let state = CompensationState::ALL.into_iter().find(|state| state.as_str() == text);
    Ok(StoredCompensation {
        id: row.get(0)?,
        machine: row.get(1)?,
        run: RunId(row.get(2)?),
        changes: columns::parse_json_column(row, 3)?,
        state: state.ok_or_else(|| columns::damaged_column_error(4, "unknown state of a compensation".into()))?,
        at: columns::parse_text_column(row, 5)?,
        who: row.get(6)?,
    })
}
