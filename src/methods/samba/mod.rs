//! SAMBA: the geometry of a five-axis machine, the stylus and the artefact at once, from master balls
//! that nobody has calibrated and one scale bar (paper 4; METHODS section 4).

mod design;
mod fit;
mod harmonics;
mod identify;
mod label;
mod left_out;
mod model;
mod observe;
mod outputs;
mod parameters;
mod separable;
mod settings;
mod solution;
mod sources;
mod stages;
mod suspects;
#[cfg(test)]
mod tests;
mod warnings;

pub use crate::identification::LeastSquares;
pub use fit::{Bar, Measured, Measurement, Problem, Seen};
pub use model::Model;
pub use settings::Settings;

use std::sync::{Arc, Mutex, PoisonError};

use self::design::{Bench, Visit};
use self::stages::Known;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use machine::record::artefact::Artefact;
use machine::record::estimate::Estimate;
use machine::record::machine::{Machine, Probe};
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const NAME: &str = "samba";
pub struct Samba {
    settings: Settings,
    /// The design last made, and for what: it is the same at every stage, and takes its time.
    made: Mutex<Option<Made>>,
}

/// What a design follows from, and the design.
struct Made {
    machine: Machine,
    probe: Probe,
    artefact: Artefact,
    visits: Arc<[Visit]>,
}

impl Samba {
    fn visits(&self, bench: &Bench<'_>) -> Result<Arc<[Visit]>, Refused> {
        let Plan { machine, probe, artefact, .. } = bench.plan;
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |made: &&Made| {
            (&made.machine, &made.probe, &made.artefact) == (machine, probe, artefact)
        };
        if let Some(made) = made.as_ref().filter(fits) {
            return Ok(made.visits.clone());
        }
        let visits: Arc<[Visit]> =
            design::design(bench, |visits| stages::machine_time_s(bench, visits))?.into();
        let (machine, probe, artefact) = (machine.clone(), probe.clone(), artefact.clone());
        *made = Some(Made { machine, probe, artefact, visits: visits.clone() });
        Ok(visits)
    }
}

impl Registered for Samba {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "uncalibrated master balls, and one scale bar",
        finds: "location errors of all axes, scales of X, Y, Z, spindle offsets, stylus \
                and balls, with their covariance",
        machine_file: "samba.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings, made: Mutex::new(None) }
    }
}

impl Method for Samba {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        let bench = Bench::new(plan, &self.settings)?;
        let visits = self.visits(&bench)?;
        let id = done.last().map_or(0, |stage| stage.id + 1);
        let known = match source {
            Source::Nominal => Known::nominal(&bench),
            Source::Measured(readings) => {
                if let Some(stage) = once_more(&bench, done, readings, id)? {
                    return Ok(Next::Stage { stage, new_steps: Vec::new() });
                }
                Known::of(&bench, readings)
            }
        };
        let tasks = stages::tasks(&bench, &visits);
        let passed = done.iter().filter(|stage| stage.repeat == 0).count();
        let Some(task) = tasks.get(passed) else { return Ok(Next::Done) };
        let (stage, new_steps) = stages::stage(&bench, &visits, task, &known, id)?;
        Ok(Next::Stage { stage, new_steps })
    }

    fn identify(
        &self,
        plan: &Plan,
        readings: &[Reading],
        priors: &[Estimate],
    ) -> Result<Estimate, IdentifyError> {
        self.check_priors(priors)?;
        identify::identify(plan, &self.settings, readings)
    }
}

/// The measurements of the last stage that were outside the limits, once more.
fn once_more(
    bench: &Bench<'_>,
    done: &[Stage],
    readings: &[Reading],
    id: u32,
) -> Result<Option<Stage>, Refused> {
    let Some(last) = done.last() else { return Ok(None) };
    let Some((steps, repeat)) = stages::review(bench, last, readings)? else { return Ok(None) };
    let name = format!("{}, once more", last.name.trim_end_matches(", once more"));
    Ok(Some(Stage { id, name, repeat, steps, found: last.found.clone() }))
}
