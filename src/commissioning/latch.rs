//! Checks that the control itself latches the position of a contact, by a run of `latch-delay`: one point of
//! the part, touched at two feeds. The journal contains it as such a run.

use std::sync::Arc;
use std::time::Instant;

use super::axes::NO_PROBE_REASON;
use super::{Check, Ended, Part};
use crate::run::{CycleError, Run, RunError, Unidentified, conclude};
use crate::setup;
use crate::store::NewRun;
use devices::controllers::ControllerError;
use machine::record::event::Event;
use machine::record::machine::{LiveCheck, Probe};
use machine::record::plan::Plan;
use machine::record::question::{Answer, Question};
use methods::latch_delay::{self, Found, Latch};
use methods::{IdentifyError, Method, Refused};

/// Maximum share of the declared repeatability that the scan period may add to a touch.
const SHARE: f64 = 0.1;

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    if check.strays || check.stands.is_none() {
        check.not_looked_at(Part::Latch, "the machine is not fit to touch, as told above");
        return Ok(());
    }
    if !check.probe_answers {
        check.not_looked_at(Part::Latch, NO_PROBE_REASON);
        return Ok(());
    }
    let since = Instant::now();
    // The check itself asks the operator.
    let file = check.file.without_prompts();
    let (method, plan) = match setup::header(&file, latch_delay::NAME, None) {
        Ok((method, plan)) => (Arc::<dyn Method>::from(method), plan),
        Err(error) => {
            check.failed(Part::Latch, since, error.to_string(), error.remedy().unwrap_or_default());
            return Ok(());
        }
    };
    let what = match announced(method.as_ref(), plan.clone()) {
        Ok(what) => what,
        Err(Refused { why, instead }) => {
            check.failed(Part::Latch, since, why, instead);
            return Ok(());
        }
    };
    match check.ask(Question::May { what }).await? {
        Answer::Yes => touch(check, method, plan).await,
        Answer::Nobody => {
            check.not_looked_at(Part::Latch, "nobody is there to let the probe touch the part");
            Ok(())
        }
        _ => {
            check.not_looked_at(Part::Latch, "a person did not let the probe touch the part");
            Ok(())
        }
    }
}

/// Description of the run, for the operator's permission.
fn announced(method: &dyn Method, plan: Plan) -> Result<String, Refused> {
    let (plan, stages) = methods::nominal(method, plan)?;
    let planned = planning::staged_blocks(&plan, &stages);
    let (_, seconds) =
        planned.map_err(|error| Refused { why: error.to_string(), instead: error.remedy() })?;
    let start = plan.steps.first().map_or(String::new(), |step| {
        let axes = step.from.iter();
        axes.map(|(axis, at)| format!(" {axis}{:.3}", axis.to_edge(at))).collect()
    });
    Ok(format!(
        "The probe goes to{start} and touches the part there {} times, slowly and fast, within about \
         {:.0} min. Does the part stand where the file says, is the way free, and the stop in your hand?",
        plan.steps.len(),
        (seconds / 60.0).ceil()
    ))
}

async fn touch(check: &mut Check<'_>, method: Arc<dyn Method>, plan: Plan) -> Result<(), Ended> {
    let since = Instant::now();
    let probe = plan.probe.clone();
    let measured = measure(check, method, plan).await?;
    check.go_on()?;
    match measured {
        Ok(found) => judge(check, &found, &probe, since),
        Err(CycleError::Run { error, .. }) if met_nothing(&error) => check.failed(
            Part::Latch,
            since,
            format!("{error}: the part does not stand where the machine file says"),
            "set the part up where [artefact] says, or correct centre_mm, radius_mm and height_mm \
                 there; if it stands right, tool_mm of [machine] or the zero of an axis is off",
        ),
        Err(error) => {
            let remedy = remedy(&error);
            check.failed(Part::Latch, since, error.to_string(), remedy);
        }
    }
    Ok(())
}

/// Makes the run as any other run.
async fn measure(
    check: &Check<'_>,
    method: Arc<dyn Method>,
    mut plan: Plan,
) -> Result<Result<Found, CycleError>, Ended> {
    let devices = check.devices.as_ref().ok_or(Ended::Unsafe)?;
    // The operator has deflected the stylus already.
    plan.probe.live_check = LiveCheck::Touch;
    let new = NewRun { config: check.file.text().to_owned(), plan: plan.clone() };
    let id = match check.journal.begin(&new).await {
        Ok(id) => id,
        Err(error) => return Ok(Err(error.into())),
    };
    let mut tell = |_: &Event| {};
    let motion = check.stop.motion().ok_or(Ended::Stopped)?;
    let mut run = Run::new(id, method.as_ref(), devices, check.journal, plan, &mut tell);
    let ended = run.execute().await;
    drop(motion);
    let (plan, readings) = (run.plan.clone(), run.readings.clone());
    let concluded = conclude(run, ended, &method, &check.file.tolerance).await;
    let found = concluded.and_then(|_| {
        let refused = |why: IdentifyError| CycleError::Identification { run: id, why: why.into() };
        Found::of(&plan, &readings).map_err(refused)
    });
    Ok(found)
}

fn judge(check: &mut Check<'_>, found: &Found, probe: &Probe, since: Instant) {
    match found.latch {
        Latch::Control { .. } => check.well(Part::Latch, since, &found.latch_in_words),
        Latch::Scan(time) => {
            check.failed(
                Part::Latch,
                since,
                &found.latch_in_words,
                to_the_control(probe, time.t_s),
            );
        }
        Latch::Unsteady(_) => check.failed(
            Part::Latch,
            since,
            &found.latch_in_words,
            "look for a loose probe, stylus, part or table; a lower search_feed_mm_min shakes less",
        ),
    }
    if let Some(words) = &found.delay_in_words {
        if found.delay_s > 0.0 {
            check.well(Part::Latch, since, words);
        } else {
            check.failed(
                Part::Latch,
                since,
                words,
                "set the feed override to 100 %, and switch off at the control what corrects for a delay \
                 of the probe",
            );
        }
    }
    match (&found.scatter_in_words, probe.repeatability_um) {
        (Some(words), _) => check.failed(
            Part::Latch,
            since,
            words,
            format!(
                "clean stylus and part and see that both are tight; if touches still scatter so, write \
                 [probe] repeatability_um = {:.2}",
                found.scatter_mm * 1e3
            ),
        ),
        (None, Some(um)) if !matches!(found.latch, Latch::Scan(_)) => {
            let seen = found.scatter_mm * 1e3;
            let mut what = format!("a touch scatters by {seen:.2} µm; {um} µm are declared");
            if let Some(bound_mm) = found.scatter_bound_mm {
                let bound = bound_mm * 1e3;
                what += &format!(", which so few touches leave not contradicted below {bound:.2} µm (χ²)");
            }
            check.well(Part::Latch, since, what);
        }
        _ => {}
    }
}

/// Remedy for a latch that the control reads once per scan period `t_s`, s.
fn to_the_control(probe: &Probe, t_s: f64) -> String {
    let wire = "lead the probe to the control's own probe (skip) input, a fast or interrupt input, \
                instead of the PLC's";
    match probe.repeatability_um {
        // A scan period T adds v·T/√12 at feed v.
        Some(um) => format!(
            "{wire}; until then a feed_mm_min of at most {:.2} keeps what the scan adds to a touch under \
             a tenth of repeatability_um",
            SHARE * um * 1e-3 * 12f64.sqrt() / t_s * 60.0
        ),
        None => format!("{wire}; what the scan adds to a touch falls with the feed"),
    }
}

/// Whether a touch ended without contact.
fn met_nothing(error: &RunError) -> bool {
    match error {
        RunError::NoFirstContact { .. } => true,
        RunError::OnStep { source, .. } => met_nothing(source),
        other => matches!(other.of_control(), Some(ControllerError::NoContact { .. })),
    }
}

fn remedy(error: &CycleError) -> String {
    match error {
        CycleError::Run { error, .. } => error.remedy(),
        CycleError::Identification { why: Unidentified::Refused(error), .. } => match error {
            IdentifyError::Refused(_) | IdentifyError::Numerical(_) => error.remedy(),
            // The other errors refer to a plan of the user or to a run that can be resumed.
            _ => "check again".to_owned(),
        },
        CycleError::Identification { .. } => "check again".to_owned(),
        CycleError::Store(error) => error.remedy().to_owned(),
        CycleError::Unqualified(error) => error.remedy(),
    }
}
