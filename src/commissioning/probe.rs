//! Checks that the probe input is open at rest, closed while the stylus is deflected, and open again. The operator
//! deflects the stylus by hand; the axes do not move, except for a retract out of contact at the start.

use std::time::{Duration, Instant};

use tokio::time::sleep;

use super::{CheckEnd, CheckPart, MachineCheck, PartTimer, control, retract};
use machine::record::question::{OperatorAnswer, OperatorQuestion, StylusState};

const NO_OPERATOR_REASON: &str = "no operator is present to deflect the stylus";
const PROBE_POLL_PERIOD: Duration = Duration::from_millis(20);

/// Observed behaviour of the probe input.
struct ProbeInputBehaviour {
    /// The input is closed at rest.
    is_closed_at_rest: bool,
    /// The input changes while the stylus is deflected.
    follows_stylus: bool,
    /// The input returns to its state at rest. False also if the operator does not confirm that the stylus is free
    /// again.
    returns_to_rest: bool,
}

/// Ends the check if the probe input has a fault. An untested probe that reads open does not end the check: the parts
/// that need contact detection are not checked then.
pub(super) async fn check_probe(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    retract::retract_from_contact(check).await?;
    let timer = PartTimer::start(CheckPart::Probe);
    let Some(test) = test_probe_input(check, timer).await? else {
        return if check.position.is_some() { update_position(check, timer).await } else { Err(CheckEnd::Unsafe) };
    };
    if let Some((what, remedy)) = test.fault_and_remedy(check.probe_polarity_hint.as_deref()) {
        check.report_failed(timer, what, remedy);
        // With a faulty probe a contact does not stop the machine.
        return Err(CheckEnd::Unsafe);
    }
    check.report_ok(timer, "the probe input is open at rest, closed while the stylus is deflected, then open again");
    check.is_probe_working = true;
    match check.position {
        Some(_) => update_position(check, timer).await,
        // The control is prepared only now, because the probe input was closed at the first attempt.
        None => control::prepare_and_confirm_position(check).await,
    }
}

/// Observes the probe input while the operator deflects the stylus; `None`, with a finding, if it cannot be checked.
async fn test_probe_input(
    check: &mut MachineCheck<'_>,
    timer: PartTimer,
) -> Result<Option<ProbeInputBehaviour>, CheckEnd> {
    let is_mounted = is_probe_possibly_mounted(check).await?;
    let is_free = is_mounted && is_stylus_state_confirmed(check, StylusState::Free).await?;
    let is_closed_at_rest = control::read_snapshot_for_probe_part(check, timer).await?.is_probe_closed;
    if !is_free || !is_stylus_state_confirmed(check, StylusState::Deflected).await? {
        let why = if is_mounted { NO_OPERATOR_REASON } else { "the touch probe is not in the spindle" };
        report_untested_probe(check, timer, is_closed_at_rest, why);
        return Ok(None);
    }
    let follows_stylus = wait_for_probe_input(check, timer, !is_closed_at_rest).await?;
    let is_released = is_stylus_state_confirmed(check, StylusState::Free).await?;
    let returns_to_rest = is_released && wait_for_probe_input(check, timer, is_closed_at_rest).await?;
    Ok(Some(ProbeInputBehaviour { is_closed_at_rest, follows_stylus, returns_to_rest }))
}

/// Whether the operator confirms the state of the stylus.
async fn is_stylus_state_confirmed(check: &mut MachineCheck<'_>, state: StylusState) -> Result<bool, CheckEnd> {
    Ok(check.prompt_operator(OperatorQuestion::StylusState(state)).await? == OperatorAnswer::Yes)
}

/// Whether the probe may be in the spindle: true if no sensor replaces it there, and also if no operator answers. The
/// operator is asked to mount it if a sensor may have replaced it.
async fn is_probe_possibly_mounted(check: &mut MachineCheck<'_>) -> Result<bool, CheckEnd> {
    let swapped = check.machine_file.sensors.iter().any(|entry| entry.sensor.mount.is_spindle());
    Ok(!swapped
        || check.prompt_operator(OperatorQuestion::StylusState(StylusState::Mounted)).await? != OperatorAnswer::No)
}

/// A closed input is a failed finding. An open input is ok, with the finding that its closing is not checked.
fn report_untested_probe(check: &mut MachineCheck<'_>, timer: PartTimer, is_closed_at_rest: bool, why: &str) {
    if is_closed_at_rest {
        let remedy = "run `trued check` on a terminal: it retracts a stylus from a contact step by step and \
            determines whether the input is inverted or stuck; or release the stylus by hand (the input must \
            also read open while a sensor is mounted instead of the probe)";
        check.report_failed(timer, "the probe reads closed", remedy);
    } else {
        check.report_ok(timer, "open at rest");
        check.report_unchecked(CheckPart::Probe, format!("whether the input closes is unknown: {why}"));
    }
}

/// Updates the position: the operator may have moved the machine to reach the stylus.
async fn update_position(check: &mut MachineCheck<'_>, timer: PartTimer) -> Result<(), CheckEnd> {
    check.position = Some(control::read_snapshot_for_probe_part(check, timer).await?.position);
    Ok(())
}

/// Waits until the probe input is closed (`expects_closed`) or open; returns whether that happened in time.
async fn wait_for_probe_input(
    check: &mut MachineCheck<'_>,
    timer: PartTimer,
    expects_closed: bool,
) -> Result<bool, CheckEnd> {
    let deadline = Instant::now() + check.operator.max_action_time();
    loop {
        check.require_no_stop_request()?;
        if control::read_snapshot_for_probe_part(check, timer).await?.is_probe_closed == expects_closed {
            return Ok(true);
        }
        if Instant::now() > deadline {
            return Ok(false);
        }
        sleep(PROBE_POLL_PERIOD).await;
    }
}

impl ProbeInputBehaviour {
    /// Fault and remedy; `None` if the input works. `polarity_hint`: the setting that inverts the input at the control.
    fn fault_and_remedy(&self, polarity_hint: Option<&str>) -> Option<(String, String)> {
        let (what, remedy) = match (self.is_closed_at_rest, self.follows_stylus) {
            (false, true) if self.returns_to_rest => return None,
            (false, true) => (
                "the probe input stays closed after the stylus was released: the stylus does not return to \
                its rest position",
                "release the stylus and check that the probe reseats; clean the probe, or have its spring checked",
            ),
            (false, false) => (
                "the probe input does not close while the stylus is deflected: the probe does not work",
                "check that the probe is switched on, its battery is charged, its receiver is in line of \
                sight, and its cable is connected to the probe input of the control. If the control \
                switches the probe on with a command, write this command in [probe] on",
            ),
            (true, true) => (
                "the probe input reads closed at rest and open while deflected: the input is inverted",
                polarity_hint.unwrap_or("invert the polarity of the probe input at the control"),
            ),
            (true, false) => (
                "the probe input stays closed with the stylus free and deflected: the input is stuck",
                "check the stylus for jamming, the cable for a short circuit, the wiring for the right \
                input, and the receiver for an error (empty battery, no line of sight)",
            ),
        };
        Some((what.to_owned(), remedy.to_owned()))
    }
}
