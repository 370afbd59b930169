//! Cache of the last designed visits: they are the same at every stage, and their computation is slow.

use std::sync::{Arc, Mutex, PoisonError};

use super::setup::Visit;
use crate::Refused;
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};
use machine::record::plan::Plan;

#[derive(Default)]
pub struct MadeVisits(Mutex<Option<Made>>);

/// Inputs of a design, besides the settings, and the design.
struct Made {
    machine: Machine,
    probe: Probe,
    artefact: Artefact,
    visits: Arc<[Visit]>,
}

impl MadeVisits {
    /// The visits of the plan. `design` computes them if the cached ones are of other inputs.
    ///
    /// # Errors
    /// The errors of `design`.
    pub fn of(
        &self,
        plan: &Plan,
        design: impl FnOnce() -> Result<Vec<Visit>, Refused>,
    ) -> Result<Arc<[Visit]>, Refused> {
        let Plan { machine, probe, artefact, .. } = plan;
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |made: &&Made| {
            (&made.machine, &made.probe, &made.artefact) == (machine, probe, artefact)
        };
        if let Some(made) = made.as_ref().filter(fits) {
            return Ok(made.visits.clone());
        }
        let visits: Arc<[Visit]> = design()?.into();
        let (machine, probe, artefact) = (machine.clone(), probe.clone(), artefact.clone());
        *made = Some(Made { machine, probe, artefact, visits: visits.clone() });
        Ok(visits)
    }
}
