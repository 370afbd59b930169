//! Describes the events of a stored run, its end and the next possible action, in words.

use jiff::Timestamp;
use jiff::tz::TimeZone;

use crate::report::time::format_local_time;
use crate::store::{EstimateSignature, RunId, RunState, RunSummary, StoredRun};
use machine::record::event::RunEvent;
use machine::record::machine::Homing;

/// Stops, faults, prompts, acknowledgements, resumptions and deletions of samples, in the order of the journal, then
/// all signatures: the time and the text of each.
pub fn describe_events_with_times(stored: &StoredRun) -> Vec<(Timestamp, String)> {
    let told = |event: &RunEvent| match event {
        RunEvent::Held { reason } => Some(format!("held: {reason}")),
        RunEvent::Faulted { what, .. } => Some(format!("fault: {what}")),
        RunEvent::Acknowledged { who, what, .. } => Some(format!("confirmed by {who}: {what}")),
        RunEvent::PromptStarted { text, .. } => Some(format!("prompt for the operator: {text}")),
        RunEvent::PromptConfirmed { who, .. } => Some(format!("prompt confirmed by {who}")),
        RunEvent::Resumed { gap_s } => Some(format!("resumed after an interruption at t = {gap_s:.1} s")),
        RunEvent::SamplesRemoved { scans } => {
            Some(format!("the samples of {scans} scans were deleted at the end of their retention period"))
        }
        _ => None,
    };
    let events = stored.events.iter();
    let events = events.filter_map(|(at, event)| Some((*at, told(event)?)));
    let signed = stored.signatures.iter().map(|(at, signature)| {
        let of = if signs_last_estimate(stored, signature) { "" } else { " (an earlier estimate)" };
        (*at, format!("signed{of} {}", describe_signer(signature)))
    });
    events.chain(signed).collect()
}

/// The times in local time, as texts.
pub fn in_local_time(events: Vec<(Timestamp, String)>) -> Vec<(String, String)> {
    events.into_iter().map(|(at, text)| (format_local_time(at), text)).collect()
}

/// Signatures of the last estimate, in words; signatures of earlier estimates are left out.
pub fn describe_signatures(stored: &StoredRun) -> Vec<String> {
    let of_last = stored.signatures.iter().filter(|(_, signature)| signs_last_estimate(stored, signature));
    of_last.map(|(at, signature)| format!("{} on {}", describe_signer(signature), format_local_time(*at))).collect()
}

fn signs_last_estimate(stored: &StoredRun, signature: &EstimateSignature) -> bool {
    stored.estimates.last().is_some_and(|last| last.sha256 == signature.estimate_sha256)
}

fn describe_signer(EstimateSignature { who, remark, .. }: &EstimateSignature) -> String {
    match remark.as_str() {
        "" => format!("by {who}"),
        remark => format!("by {who} ({remark})"),
    }
}

/// Sentence about an incomplete run: its state, its number of readings, and the reason why it ended.
pub fn describe_run_end(stored: &StoredRun) -> String {
    let (id, state) = (stored.summary.id, stored.summary.state);
    let last = stored.events.iter().rev().find_map(|(_, event)| match event {
        RunEvent::Held { reason } => Some(reason.clone()),
        RunEvent::Faulted { what, remedy, .. } => Some(format!("{what} ({remedy})")),
        _ => None,
    });
    let why = match (state, last) {
        (RunState::NotIdentified, _) => {
            identification_fault(stored).unwrap_or_else(|| "no estimate is stored yet".to_owned())
        }
        (RunState::Interrupted, _) => "the process ended without writing a reason".to_owned(),
        (_, Some(last)) => last,
        (_, None) => "no reason is stored".to_owned(),
    };
    format!("run {id} is {} after {} readings: {why}", state.as_str(), stored.readings.len())
}

/// For a run in the state `NotIdentified`: reason why its identification failed, with the remedy. `None` if no
/// identification has failed: the process ended first, or the computation is in progress.
pub fn identification_fault(stored: &StoredRun) -> Option<String> {
    let events = stored.events.iter().rev().map(|(_, event)| event);
    let mut since = events.take_while(|event| !matches!(event, RunEvent::Finished | RunEvent::Resumed { .. }));
    since.find_map(|event| match event {
        RunEvent::Faulted { what, remedy, .. } => Some(format!("{what} ({remedy})")),
        _ => None,
    })
}

/// Whether the control may have lost the position of an axis since the run was last resumed. An axis without a
/// homing switch may have lost its zero in any interruption, and no control reports that.
pub fn may_have_lost_position(stored: &StoredRun) -> bool {
    if stored.plan.machine.axes.values().any(|axis| axis.homing == Homing::None) {
        return true;
    }
    let events = stored.events.iter().rev().map(|(_, event)| event);
    let mut since = events.take_while(|event| !matches!(event, RunEvent::Resumed { .. }));
    since.any(|event| matches!(event, RunEvent::Faulted { position_lost: true, .. }))
}

/// Whether a person has acknowledged the stop and abandoned the run: no further action is expected. An
/// acknowledgement for a resume does not count.
pub fn is_abandoned(stored: &StoredRun) -> bool {
    let last = stored.events.iter().rev().find_map(|(_, event)| match event {
        RunEvent::Acknowledged { leaves, .. } => Some(*leaves),
        // These events do not change whether the run is abandoned.
        RunEvent::OperatorMessage { .. } | RunEvent::SamplesRemoved { .. } => None,
        _ => Some(false),
    });
    last.unwrap_or(false)
}

/// Command that resumes a stopped run, or the reason why it cannot be resumed. `can_resume`: the references of the
/// run were measured.
pub fn resume_hint(run: RunId, can_resume: bool, position_lost: bool) -> String {
    match (can_resume, position_lost) {
        (true, true) => format!(
            "check the machine and home all axes, then continue with `trued resume {run} --acknowledge \
            YOUR_NAME --homed`"
        ),
        (true, false) => format!("check the machine, then continue with `trued resume {run}`"),
        (false, _) => format!(
            "run {run} cannot be resumed, because its references were not measured before the stop: start a \
            new run"
        ),
    }
}

/// Next action that is possible for a run in its state; `None` for a finished, failed or running run. `can_resume` as
/// in [`resume_hint`].
pub fn next_action(stored: &StoredRun, can_resume: bool) -> Option<String> {
    let RunSummary { id, state, method, .. } = &stored.summary;
    match state {
        RunState::Held | RunState::Interrupted => Some(resume_hint(*id, can_resume, may_have_lost_position(stored))),
        RunState::NotResumable => Some(format!(
            "`trued identify {method} --run {id}` computes an estimate from the stored \
                readings"
        )),
        RunState::NotIdentified => Some(format!(
            "`trued resume {id}` computes the estimate from the stored readings; the machine does not move"
        )),
        RunState::Finished | RunState::Failed | RunState::Running => None,
    }
}

/// Whether the certificate of the artefact had expired when the run started. The certificate is valid on its last
/// day.
pub fn is_certificate_expired(stored: &StoredRun) -> bool {
    let day = stored.summary.started.to_zoned(TimeZone::system()).strftime("%Y-%m-%d").to_string();
    stored.plan.report.is_certificate_expired(&day)
}

/// Warning about a certificate of the artefact that had expired when the run started; otherwise empty. The warnings
/// of the estimate are not included.
pub fn describe_record_warnings(stored: &StoredRun) -> Vec<String> {
    let due = stored.plan.report.certificate_due.iter().filter(|_| is_certificate_expired(stored));
    due.map(|due| format!("the certificate of the artefact was valid until {due}: it had expired when the run started"))
        .collect()
}
