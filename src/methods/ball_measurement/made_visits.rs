//! The visits last designed: they are the same at every stage, and take their time.

use std::sync::{Arc, Mutex, PoisonError};

use super::setup::Visit;
use crate::Refused;
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};
use machine::record::plan::Plan;

#[derive(Default)]
pub struct MadeVisits(Mutex<Option<Made>>);

/// What a design follows from, besides the settings, and the design.
struct Made {
    machine: Machine,
    probe: Probe,
    artefact: Artefact,
    visits: Arc<[Visit]>,
}

impl MadeVisits {
    /// Those of the plan; `design` makes them where they are not those made last.
    ///
    /// # Errors
    /// Those of `design`.
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
