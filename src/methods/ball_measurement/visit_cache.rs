//! Cache of the last designed visits: they are the same at every stage, and their computation is slow.

use std::sync::{Arc, Mutex, PoisonError};

use super::setup::BallVisit;
use crate::MethodRefusal;
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};
use machine::record::plan::Plan;

/// The last designed visits of a method, whose settings are constant.
#[derive(Default)]
pub struct VisitCache(Mutex<Option<CachedDesign>>);

/// Visits and the inputs from which they were designed; the settings of the method are not compared.
struct CachedDesign {
    machine: Machine,
    probe: Probe,
    artefact: Artefact,
    visits: Arc<[BallVisit]>,
}

impl VisitCache {
    /// The visits of the plan. `design` computes them if the cached visits belong to other inputs.
    ///
    /// # Errors
    /// The errors of `design`.
    pub fn get_or_design(
        &self,
        plan: &Plan,
        design: impl FnOnce() -> Result<Vec<BallVisit>, MethodRefusal>,
    ) -> Result<Arc<[BallVisit]>, MethodRefusal> {
        let Plan { machine, probe, artefact, .. } = plan;
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |made: &&CachedDesign| (&made.machine, &made.probe, &made.artefact) == (machine, probe, artefact);
        if let Some(made) = made.as_ref().filter(fits) {
            return Ok(made.visits.clone());
        }
        let visits: Arc<[BallVisit]> = design()?.into();
        let (machine, probe, artefact) = (machine.clone(), probe.clone(), artefact.clone());
        *made = Some(CachedDesign { machine, probe, artefact, visits: visits.clone() });
        Ok(visits)
    }
}
