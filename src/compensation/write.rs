//! Writes approved values to a control. The intent is journaled before the first write, and each value is read back.

use crate::archive::run_story::is_abandoned;
use crate::store::{
    CompensationState, CompensationValue, Journal, MachineLock, NewCompensation, RunFilter, RunId, StoreError,
    StoredCompensation, UnfinishedCompensation,
};
use devices::compensation::{ValueToWrite, are_values_equal};
use jiff::{SignedDuration, Timestamp};
use methods::compensation::ControlModel;

use super::proposal::ControlProposal;
use super::target::{CompensationTarget, TargetError, last_compensation, values_before_or_after};

/// Maximum age of a measurement for a change of the control, from the start of the run (of a combination: of its
/// oldest run): after this time the temperatures of the machine differ.
const MAX_AGE_OF_MEASUREMENT: SignedDuration = SignedDuration::from_hours(24);
/// Maximum time by which the start of a run may be later than the present time: a later start means a wrong clock.
const MAX_CLOCK_ERROR: SignedDuration = SignedDuration::from_hours(1);

#[derive(Debug, thiserror::Error)]
pub enum CompensationWriteError {
    #[error(transparent)]
    Journal(#[from] StoreError),
    #[error(transparent)]
    Target(#[from] TargetError),
    #[error("the proposal cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// SHA-256 of the approved and of the present proposal.
    #[error(
        "the approved proposal {approved} is not the present proposal {present}: the run, the machine file or a value \
         of the control has changed"
    )]
    OtherProposal { approved: String, present: String },
    #[error("the proposal has expired: run {run} was not started within the last {} h", MAX_AGE_OF_MEASUREMENT.as_hours())]
    Expired { run: i64 },
    #[error("the proposal changes no value")]
    NothingToWrite,
    #[error(transparent)]
    Unfinished(#[from] UnfinishedCompensation),
    #[error("run {0} of this machine can still be resumed: with other values its readings would not be consistent")]
    ResumableRun(RunId),
    #[error(
        "there is nothing to undo: `{machine}` has no compensation of these values, or its last compensation is undone already"
    )]
    NothingToUndo { machine: String },
    #[error("there is nothing to finish: no compensation of `{machine}` is unfinished")]
    NothingToFinish { machine: String },
    #[error(
        "{name} is {present_mm} mm, neither {before_mm} mm nor {after_mm} mm: another program or person has changed it"
    )]
    ChangedByOther { name: String, present_mm: f64, before_mm: f64, after_mm: f64 },
    #[error("the compensation is of {name}, which is no value of the control by the present machine file")]
    OtherValueNames { name: String },
    #[error("{name} is {present_mm} mm, not {expected_mm} mm as written: another program or person has changed it")]
    NotAsWritten { name: String, present_mm: f64, expected_mm: f64 },
}

impl CompensationWriteError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Journal(error) => error.remedy(),
            Self::Target(error) => return error.remedy(),
            Self::Json(_) => "report this error",
            Self::OtherProposal { .. } => {
                "read the present proposal with `trued compensate propose`, then approve its hash"
            }
            Self::Expired { .. } => "measure again; check the clock of this computer",
            Self::NothingToWrite => "nothing needs to be done",
            Self::ResumableRun(run) => {
                return format!(
                    "finish run {run} with `trued resume {run}`, or leave it unfinished at the page of the machine"
                );
            }
            Self::Unfinished(unfinished) => return unfinished.remedy(),
            Self::NothingToUndo { .. } | Self::NothingToFinish { .. } => {
                "list the values of the control with `trued compensate status`"
            }
            Self::OtherValueNames { .. } => {
                "name the values of the last compensation (file or slot) in [compensation] of the machine file, then try again"
            }
            Self::NotAsWritten { .. } => {
                "restore the previous values with `trued compensate undo`, or set the value as it was written, then \
                 start the control again"
            }
            Self::ChangedByOther { .. } => {
                "set the value at the control to the value before or after the compensation, then try again; `trued \
                 compensate status` lists both values"
            }
        };
        text.to_owned()
    }
}

/// Changes the values of the control. Requires the lock of the machine, which only one process can hold.
pub struct CompensationWriter<'a> {
    pub journal: &'a Journal,
    pub lock: &'a MachineLock,
    pub target: &'a (dyn CompensationTarget + 'a),
    /// Name of the person who approves or requests the change.
    pub who: &'a str,
}

/// Whether a write sets the new values of a compensation, or restores the values before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum WriteDirection {
    ToNewValues,
    ToValuesBefore,
}

impl WriteDirection {
    fn state_during_write(self) -> CompensationState {
        match self {
            Self::ToNewValues => CompensationState::Writing,
            Self::ToValuesBefore => CompensationState::Undoing,
        }
    }

    fn state_after_write(self, needs_restart: bool) -> CompensationState {
        match (self, needs_restart) {
            (Self::ToNewValues, true) => CompensationState::AwaitingRestart,
            (Self::ToNewValues, false) => CompensationState::Written,
            (Self::ToValuesBefore, true) => CompensationState::UndoneAwaitingRestart,
            (Self::ToValuesBefore, false) => CompensationState::Undone,
        }
    }

    /// Text of the value to write; to restore a value, the text that the control had before, if it is journaled.
    fn value_text(self, change: &CompensationValue) -> String {
        match self {
            Self::ToNewValues => change.after_mm.to_string(),
            Self::ToValuesBefore if change.before_text.is_empty() => change.before_mm.to_string(),
            Self::ToValuesBefore => change.before_text.clone(),
        }
    }
}

impl CompensationWriter<'_> {
    /// Writes the values of `proposal`, whose hash `approved_sha256` a person has approved. Returns the number of the
    /// compensation.
    ///
    /// # Errors
    /// The approval is of another proposal; the measurement is too old; an earlier compensation is unfinished; a run
    /// can still be resumed; no value changes; the control refuses a write or reads back another value. An error
    /// after the first write leaves the compensation unfinished.
    pub fn write(&self, proposal: &ControlProposal, approved_sha256: &str) -> Result<i64, CompensationWriteError> {
        if let Some(unfinished) = self.journal.unfinished_compensation(self.lock.machine())? {
            return Err(unfinished.into());
        }
        self.check_no_resumable_run()?;
        let present = proposal.sha256()?;
        if approved_sha256 != present {
            return Err(CompensationWriteError::OtherProposal { approved: approved_sha256.to_owned(), present });
        }
        let age = Timestamp::now().duration_since(proposal.measured_at);
        if age > MAX_AGE_OF_MEASUREMENT || age < -MAX_CLOCK_ERROR {
            return Err(CompensationWriteError::Expired { run: proposal.run.0 });
        }
        let values = proposal.proposal.values.iter();
        let changes: Vec<CompensationValue> = values
            .map(|value| CompensationValue {
                name: value.name.clone(),
                before_mm: value.present_mm,
                before_text: value.present_text.clone(),
                after_mm: value.proposed_mm,
            })
            .collect();
        if changes.iter().all(|change| change.before_mm == change.after_mm) {
            return Err(CompensationWriteError::NothingToWrite);
        }
        self.target.check_writable()?;
        let new = NewCompensation {
            machine: self.lock.machine().to_owned(),
            target: self.target.kind().to_owned(),
            run: proposal.run,
            who: self.who.to_owned(),
            proposal_sha256: present,
            changes: changes.clone(),
        };
        let id = self.journal.begin_compensation(&new).wait()?;
        self.write_values(id, &changes, WriteDirection::ToNewValues)?;
        Ok(id)
    }

    /// Restores the values before the last compensation, whether it is finished or not. Returns the compensation
    /// with its state before the undo.
    ///
    /// # Errors
    /// There is no compensation to undo; the compensation is finished and a run can still be resumed; a value is
    /// neither that before nor that after; the control refuses a write.
    pub fn undo(&self) -> Result<StoredCompensation, CompensationWriteError> {
        let last = self.last_compensation()?.filter(|last| !last.state.is_undone());
        let nothing = || CompensationWriteError::NothingToUndo { machine: self.lock.machine().to_owned() };
        let last = last.ok_or_else(nothing)?;
        if !last.state.forbids_motion() {
            self.check_no_resumable_run()?;
        }
        self.rewrite(&last, WriteDirection::ToValuesBefore)?;
        Ok(last)
    }

    /// Writes the new values of an unfinished compensation, also after an interrupted undo; or confirms that the
    /// control uses the values after a restart. Returns the compensation with its state before this call.
    ///
    /// # Errors
    /// No compensation is unfinished; a value is neither that before nor that after the compensation; the control
    /// refuses a write, or still uses the replaced values.
    pub fn finish(&self) -> Result<StoredCompensation, CompensationWriteError> {
        let last = self.last_compensation()?.filter(|last| last.state.forbids_motion());
        let nothing = || CompensationWriteError::NothingToFinish { machine: self.lock.machine().to_owned() };
        let last = last.ok_or_else(nothing)?;
        if last.state.awaits_restart() {
            self.confirm_restart(&last)?;
        } else {
            self.rewrite(&last, WriteDirection::ToNewValues)?;
        }
        Ok(last)
    }

    /// Refuses a change while a run of the machine can be resumed. A run that a person has abandoned does not count.
    fn check_no_resumable_run(&self) -> Result<(), CompensationWriteError> {
        let of_machine = RunFilter { machine: Some(self.lock.machine()), ..RunFilter::default() };
        let runs = self.journal.list_runs(of_machine, usize::MAX)?;
        for run in runs.into_iter().filter(|run| run.state.is_resumable()) {
            if !is_abandoned(&self.journal.load_run(run.id)?) {
                return Err(CompensationWriteError::ResumableRun(run.id));
            }
        }
        Ok(())
    }

    fn last_compensation(&self) -> Result<Option<StoredCompensation>, StoreError> {
        last_compensation(self.journal, self.lock.machine(), self.target)
    }

    /// Checks that the control has the values of the last write and no longer uses the replaced ones, and then ends
    /// the compensation as written, or as undone.
    fn confirm_restart(&self, last: &StoredCompensation) -> Result<(), CompensationWriteError> {
        let is_undone = last.state.is_undone();
        let present = self.target.read()?;
        for (name, expected_mm) in values_before_or_after(&last.changes, !is_undone) {
            let present_mm = known_value_mm(&present, &name)?;
            if !are_values_equal(present_mm, expected_mm) {
                return Err(CompensationWriteError::NotAsWritten { name, present_mm, expected_mm });
            }
        }
        self.target.check_in_effect(&values_before_or_after(&last.changes, is_undone))?;
        let end = if is_undone { CompensationState::Undone } else { CompensationState::Written };
        Ok(self.journal.set_compensation_state(last.id, end, self.who).wait()?)
    }

    /// Writes the changed values of a journaled compensation again, in either direction.
    fn rewrite(&self, last: &StoredCompensation, direction: WriteDirection) -> Result<(), CompensationWriteError> {
        self.check_not_changed_by_other(&last.changes)?;
        self.target.check_writable()?;
        self.journal.set_compensation_state(last.id, direction.state_during_write(), self.who).wait()?;
        self.write_values(last.id, &last.changes, direction)
    }

    /// Checks that each value is that before or that after the compensation: another person or program has set any
    /// other value.
    fn check_not_changed_by_other(&self, changes: &[CompensationValue]) -> Result<(), CompensationWriteError> {
        let present = self.target.read()?;
        for CompensationValue { name, before_mm, after_mm, .. } in changes {
            let present_mm = known_value_mm(&present, name)?;
            if ![before_mm, after_mm].into_iter().any(|mm| are_values_equal(present_mm, *mm)) {
                let (name, before_mm, after_mm) = (name.clone(), *before_mm, *after_mm);
                return Err(CompensationWriteError::ChangedByOther { name, present_mm, before_mm, after_mm });
            }
        }
        Ok(())
    }

    /// Writes the values that the compensation changes, and journals the state after the write.
    fn write_values(
        &self,
        id: i64,
        changes: &[CompensationValue],
        direction: WriteDirection,
    ) -> Result<(), CompensationWriteError> {
        let changed = changes.iter().filter(|change| change.before_mm != change.after_mm);
        let texts: Vec<(&str, String)> =
            changed.map(|change| (change.name.as_str(), direction.value_text(change))).collect();
        let values: Vec<ValueToWrite<'_>> = texts.iter().map(|(name, text)| ValueToWrite { name, text }).collect();
        let batch_len = if self.target.is_written_in_one_batch() { values.len().max(1) } else { 1 };
        for batch in values.chunks(batch_len) {
            self.check_not_changed_by_other(changes)?;
            self.target.write(batch)?;
        }
        let end = direction.state_after_write(self.target.needs_restart());
        Ok(self.journal.set_compensation_state(id, end, self.who).wait()?)
    }
}

/// # Errors
/// The machine file states other values than those of the compensation.
fn known_value_mm(control: &ControlModel, name: &str) -> Result<f64, CompensationWriteError> {
    let value = control.values().iter().find(|value| value.name == name);
    value.map(|value| value.present_mm).ok_or_else(|| CompensationWriteError::OtherValueNames { name: name.to_owned() })
}
