//! The compensation of one machine, as the command line and the service use it.

use serde::Serialize;

use super::proposal::{ControlProposal, ControlProposalError, propose_for_control};
use super::target::{CompensationTarget, TargetError, last_compensation};
use super::targets::open_target;
use super::verification::{Verification, VerificationError, verify_by_run};
use super::write::{CompensationWriteError, CompensationWriter};
use crate::setup::MachineFile;
use crate::store::{Journal, MachineLock, RunId, StoreError, StoredCompensation};
use methods::compensation::{ControlValue, ProposalOptions};

#[derive(Debug, thiserror::Error)]
pub enum CompensationError {
    #[error(transparent)]
    Target(#[from] TargetError),
    #[error(transparent)]
    Proposal(#[from] ControlProposalError),
    #[error(transparent)]
    Write(#[from] CompensationWriteError),
    #[error(transparent)]
    Verification(#[from] VerificationError),
    #[error(transparent)]
    Journal(#[from] StoreError),
}

impl CompensationError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        match self {
            Self::Target(error) => error.remedy(),
            Self::Proposal(error) => error.remedy(),
            Self::Write(error) => error.remedy(),
            Self::Verification(error) => error.remedy(),
            Self::Journal(error) => error.remedy().to_owned(),
        }
    }
}

/// A run, and the options for a proposal from this run.
#[derive(Debug, Clone, Copy)]
pub struct ProposalSource {
    pub run: RunId,
    pub options: ProposalOptions,
}

/// A proposal, with the hash by which a person approves the proposal.
#[derive(Debug, Clone, Serialize)]
pub struct HashedProposal {
    pub sha256: String,
    #[serde(flatten)]
    pub proposal: ControlProposal,
}

/// Present compensation values of the control, and the last compensation in the journal.
#[derive(Debug, Clone, Serialize)]
pub struct CompensationStatus {
    /// Present values of the control.
    pub values: Vec<ControlValue>,
    /// Newest compensation of these values, or the unfinished one of their kind.
    pub last: Option<StoredCompensation>,
}

/// Compensation of the control of one machine, recorded in the journal. Each call blocks the thread.
pub struct MachineCompensation<'a> {
    file: &'a MachineFile,
    journal: &'a Journal,
    target: Box<dyn CompensationTarget + 'a>,
}

impl<'a> MachineCompensation<'a> {
    /// # Errors
    /// The machine file has no section `[compensation]`, or the configuration of the control is not supported.
    /// `kind`: as for [`open_target`].
    pub fn open(file: &'a MachineFile, journal: &'a Journal, kind: Option<&str>) -> Result<Self, CompensationError> {
        Ok(Self { file, journal, target: open_target(file, kind)? })
    }

    pub fn target(&self) -> &dyn CompensationTarget {
        &*self.target
    }

    /// Proposes values from the last estimate of the run; nothing is written.
    ///
    /// # Errors
    /// As [`propose_for_control`].
    pub fn propose(&self, source: ProposalSource) -> Result<HashedProposal, CompensationError> {
        let proposal = propose_for_control(self.journal, source.run, self.file, &*self.target, source.options)?;
        Ok(HashedProposal { sha256: proposal.sha256().map_err(ControlProposalError::from)?, proposal })
    }

    /// Writes the proposal whose hash `who` has approved. Returns the number of the compensation and the proposal.
    ///
    /// # Errors
    /// As [`Self::propose`] and [`CompensationWriter::write`].
    pub fn write(
        &self,
        lock: &MachineLock,
        who: &str,
        source: ProposalSource,
        approved_sha256: &str,
    ) -> Result<(i64, ControlProposal), CompensationError> {
        let HashedProposal { proposal, .. } = self.propose(source)?;
        Ok((self.writer(lock, who).write(&proposal, approved_sha256)?, proposal))
    }

    /// Compares `run` with the prediction of the last compensation.
    ///
    /// # Errors
    /// As [`verify_by_run`].
    pub fn compare_with_prediction(&self, run: RunId) -> Result<Verification, CompensationError> {
        Ok(verify_by_run(self.journal, run, self.file, &*self.target)?)
    }

    /// Compares `run` with the prediction of the last compensation, and journals the result as that of `who`.
    ///
    /// # Errors
    /// As [`Self::compare_with_prediction`].
    pub fn verify(&self, _lock: &MachineLock, who: &str, run: RunId) -> Result<Verification, CompensationError> {
        let verification = self.compare_with_prediction(run)?;
        let (id, state) = (verification.compensation, verification.state());
        self.journal.set_compensation_verification(id, state, who, run).wait()?;
        Ok(verification)
    }

    /// Restores the values before the last compensation; returns the compensation with its state before the undo.
    ///
    /// # Errors
    /// As [`CompensationWriter::undo`].
    pub fn undo(&self, lock: &MachineLock, who: &str) -> Result<StoredCompensation, CompensationError> {
        Ok(self.writer(lock, who).undo()?)
    }

    /// Completes an unfinished compensation; returns the compensation with its state before this call.
    ///
    /// # Errors
    /// As [`CompensationWriter::finish`].
    pub fn finish(&self, lock: &MachineLock, who: &str) -> Result<StoredCompensation, CompensationError> {
        Ok(self.writer(lock, who).finish()?)
    }

    /// # Errors
    /// The control or the journal cannot be read.
    pub fn status(&self) -> Result<CompensationStatus, CompensationError> {
        let values = self.target.read()?.values().to_vec();
        let last = last_compensation(self.journal, &self.file.machine.name, &*self.target)?;
        Ok(CompensationStatus { values, last })
    }

    fn writer<'w>(&'w self, lock: &'w MachineLock, who: &'w str) -> CompensationWriter<'w> {
        CompensationWriter { journal: self.journal, lock, target: &*self.target, who }
    }
}
