//! Checks that the control itself latches the position of a contact, by the method `latch-delay`: one point of the part
//! is touched at two feeds. The journal stores these touches as a run of `latch-delay`.

use std::sync::Arc;

use super::axes::PROBE_UNTESTED_REASON;
use super::{CheckEnd, CheckPart, MachineCheck, PartTimer};
use crate::run::{CycleError, IdentificationError, Run, RunError, identify_judge_and_store};
use crate::setup;
use crate::store::NewRun;
use devices::controllers::ControllerError;
use machine::record::event::RunEvent;
use machine::record::machine::{LiveCheck, Probe};
use machine::record::plan::Plan;
use machine::record::question::{OperatorAnswer, OperatorQuestion};
use methods::latch_delay::{self, LatchDelayResult, LatchDiagnosis};
use methods::{IdentifyError, Method, MethodRefusal};

/// Maximum share of the declared repeatability that the PLC scan may add to a touch; the advised feed follows from it.
const MAX_PLC_SCAN_SHARE_OF_REPEATABILITY: f64 = 0.1;

/// Touches the part by the method `latch-delay`, with the operator's permission. Not checked after a fault of an axis
/// or with an untested probe. A fault of this part does not end the check.
pub(super) async fn check_latch(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    if check.has_axis_fault || check.position.is_none() {
        check.report_unchecked(CheckPart::Latch, "the machine is not ready for touches; see the findings above");
        return Ok(());
    }
    if !check.is_probe_working {
        check.report_unchecked(CheckPart::Latch, PROBE_UNTESTED_REASON);
        return Ok(());
    }
    let timer = PartTimer::start(CheckPart::Latch);
    // The plan is made without prompts: the check itself asks the operator.
    let file = check.machine_file.without_prompts();
    let configured = setup::configure_method_and_plan_without_steps(&file, latch_delay::METHOD_NAME, None);
    let described =
        configured.and_then(|(method, plan)| Ok((describe_latch_run(method.as_ref(), plan.clone())?, method, plan)));
    let (action, method, plan_without_steps) = match described {
        Ok(described) => described,
        Err(error) => {
            check.report_failed(timer, error.to_string(), error.remedy().unwrap_or_default());
            return Ok(());
        }
    };
    let why = match check.prompt_operator(OperatorQuestion::AllowAction { action }).await? {
        OperatorAnswer::Yes => return touch_part_and_report_latch(check, method.into(), plan_without_steps).await,
        OperatorAnswer::NoOperator => "no operator is present to permit touches of the part",
        _ => "the operator did not permit touches of the part",
    };
    check.report_unchecked(CheckPart::Latch, why);
    Ok(())
}

/// Description of the run, for the operator's permission.
fn describe_latch_run(method: &dyn Method, plan_without_steps: Plan) -> Result<String, MethodRefusal> {
    let (plan, stages) = methods::plan_nominal_stages(method, plan_without_steps)?;
    let planned = planning::plan_blocks_and_time_s_by_stage(&plan, &stages);
    let (_, seconds) = planned.map_err(|error| MethodRefusal { reason: error.to_string(), remedy: error.remedy() })?;
    let start = plan.steps.first().map_or(String::new(), |step| {
        let axes = step.from.iter();
        axes.map(|(axis, at)| format!(" {axis}{:.3}", axis.to_mm_or_deg(at))).collect()
    });
    Ok(format!(
        "The probe moves to{start} and touches the part there {} times at two feeds, in about {:.0} min. Is \
        the part at the position in the machine file, is the path free, and is the emergency stop within reach?",
        plan.steps.len(),
        (seconds / 60.0).ceil()
    ))
}

async fn touch_part_and_report_latch(
    check: &mut MachineCheck<'_>,
    method: Arc<dyn Method>,
    plan_without_steps: Plan,
) -> Result<(), CheckEnd> {
    let timer = PartTimer::start(CheckPart::Latch);
    let probe = plan_without_steps.probe.clone();
    let measured = run_latch_delay_method(check, method, plan_without_steps).await?;
    check.require_no_stop_request()?;
    match measured {
        Ok(result) => report_latch(check, &result, &probe, timer),
        Err(CycleError::MeasurementIncomplete { error, .. }) if is_no_contact(&error) => check.report_failed(
            timer,
            format!("{error}: the part is not at the position in the machine file"),
            "move the part to the position of [artefact], or correct centre_mm, radius_mm and height_mm \
            there; if the position is right, correct tool_mm of [machine] or the zero of the axes",
        ),
        Err(error) => {
            let remedy = failed_cycle_remedy(&error);
            check.report_failed(timer, error.to_string(), remedy);
        }
    }
    Ok(())
}

/// Measures with the method `latch-delay` and stores the run as any other run. The inner error is that of the run;
/// the outer error ends the check.
async fn run_latch_delay_method(
    check: &MachineCheck<'_>,
    method: Arc<dyn Method>,
    mut plan_without_steps: Plan,
) -> Result<Result<LatchDelayResult, CycleError>, CheckEnd> {
    let devices = check.devices.as_ref().ok_or(CheckEnd::Unsafe)?;
    // The touch itself needs no stylus check: the operator has deflected the stylus before.
    plan_without_steps.probe.live_check = LiveCheck::Touch;
    let new = NewRun { machine_file_text: check.machine_file.text().to_owned(), plan: plan_without_steps.clone() };
    let id = match check.journal.begin_run(&new).await {
        Ok(id) => id,
        Err(error) => return Ok(Err(error.into())),
    };
    let mut on_event = |_: &RunEvent| {};
    let motion = check.stop.begin_motion().ok_or(CheckEnd::Stopped)?;
    let mut run = Run::new(id, method.as_ref(), devices, check.journal, plan_without_steps, &mut on_event);
    let ended = run.execute().await;
    drop(motion);
    let (plan, readings) = (run.plan.clone(), run.readings.clone());
    let concluded = identify_judge_and_store(run, ended, &method, &check.machine_file.tolerances).await;
    let result = concluded.and_then(|_| {
        let refused = |why: IdentifyError| CycleError::NotIdentified { run: id, why: why.into() };
        LatchDelayResult::from_readings(&plan, &readings).map_err(refused)
    });
    Ok(result)
}

/// A PLC scan, excess scatter and a significant negative delay are failed findings.
fn report_latch(check: &mut MachineCheck<'_>, result: &LatchDelayResult, probe: &Probe, timer: PartTimer) {
    match result.latch_diagnosis {
        LatchDiagnosis::NoPlcScan { .. } => check.report_ok(timer, &result.latch_text),
        LatchDiagnosis::PlcScan(time) => {
            check.report_failed(timer, &result.latch_text, plc_scan_remedy(probe, time.duration_s));
        }
        LatchDiagnosis::ExcessScatter(_) => check.report_failed(
            timer,
            &result.latch_text,
            "check that probe, stylus, part and table are tight; a lower search_feed_mm_min causes less vibration",
        ),
    }
    if let Some(text) = &result.significant_delay_text {
        if result.delay_s > 0.0 {
            check.report_ok(timer, text);
        } else {
            check.report_failed(
                timer,
                text,
                "set the feed override to 100 %, and switch off the compensation of the probe delay at the control",
            );
        }
    }
    report_scatter(check, result, probe, timer);
}

/// Compares the scatter of the slow touches with the declared repeatability: excess scatter is a failed finding.
/// Otherwise nothing is reported if no repeatability is declared, or if a PLC scan is found.
fn report_scatter(check: &mut MachineCheck<'_>, result: &LatchDelayResult, probe: &Probe, timer: PartTimer) {
    match (&result.excess_scatter_text, probe.repeatability_um) {
        (Some(text), _) => check.report_failed(
            timer,
            text,
            format!(
                "clean the stylus and the part and check that both are tight; if the scatter stays the \
                same, write [probe] repeatability_um = {:.2}",
                result.slow_touch_std_dev_mm * 1e3
            ),
        ),
        (None, Some(um)) if !matches!(result.latch_diagnosis, LatchDiagnosis::PlcScan(_)) => {
            let scatter_um = result.slow_touch_std_dev_mm * 1e3;
            let mut what = format!("the touches have a standard deviation of {scatter_um:.2} µm; declared are {um} µm");
            if let Some(bound_mm) = result.max_explained_slow_touch_std_dev_mm {
                let bound = bound_mm * 1e3;
                what +=
                    &format!(" (with so few touches, a contradiction is detectable only above {bound:.2} µm, χ² test)");
            }
            check.report_ok(timer, what);
        }
        _ => {}
    }
}

/// Remedy for a latch that the control reads once per scan of its PLC.
fn plc_scan_remedy(probe: &Probe, scan_period_s: f64) -> String {
    let wire = "connect the probe to the probe (skip) input of the control, a fast or interrupt input, \
        instead of a PLC input";
    match probe.repeatability_um {
        // A scan period T adds v·T/√12 at feed v.
        Some(um) => format!(
            "{wire}; until then use a feed_mm_min of at most {:.2}: the PLC scan then adds less than a \
            tenth of repeatability_um to a touch",
            MAX_PLC_SCAN_SHARE_OF_REPEATABILITY * um * 1e-3 * 12f64.sqrt() / scan_period_s * 60.0
        ),
        None => format!("{wire}; a lower feed reduces the error that the PLC scan adds to a touch"),
    }
}

/// Whether the run failed because a touch ended without contact.
fn is_no_contact(error: &RunError) -> bool {
    match error {
        RunError::NoFirstContact { .. } => true,
        RunError::AtStep { source, .. } => is_no_contact(source),
        other => matches!(other.controller_error(), Some(ControllerError::NoContact { .. })),
    }
}

fn failed_cycle_remedy(error: &CycleError) -> String {
    match error {
        CycleError::MeasurementIncomplete { error, .. } => error.remedy(),
        CycleError::NotIdentified { why: IdentificationError::Refused(error), .. } => {
            match error {
                IdentifyError::Refused(_) | IdentifyError::IdentificationFailed(_) => error.remedy(),
                // The other errors refer to a plan of the user or to a run that can be resumed.
                _ => "repeat the check".to_owned(),
            }
        }
        CycleError::NotIdentified { .. } => "repeat the check".to_owned(),
        CycleError::Store(error) => error.remedy().to_owned(),
        CycleError::Qualification(error) => error.remedy(),
    }
}
