//! Decision whether a due slot may start: a pure function of the current state.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::entry::{OverlapPolicy, ReadinessCondition};
use crate::service::config::StartInterlock;
use crate::service::machine_state::Refusal;
use crate::service::not_started::NotStartedReason;
use crate::service::schedule_state::Readiness;
use crate::store::Arming;

/// Maximum time by which an arming may be later than the clock; beyond it, the clock was set back, and the arming is
/// invalid.
const MAX_TOLERATED_CLOCK_SETBACK: SignedDuration = SignedDuration::from_hours(1);

/// Conditions that a start must meet.
#[derive(Debug, Clone)]
pub struct StartRequirements<'a> {
    /// Interlocks that `[serve]` demands. The gate checks them (`gate_refusal`); here they only name missing inputs.
    pub required_interlocks: &'a [StartInterlock],
    /// Conditions that the machine must report in addition to the interlocks.
    pub required_conditions: &'a [ReadinessCondition],
    /// Minimum time for which the control must have executed no program; 0: no condition.
    pub min_idle_time: Duration,
    pub overlap_policy: OverlapPolicy,
    /// After this time an unmet condition skips the slot instead of letting the slot wait. A slot whose conditions
    /// all hold starts even then.
    pub latest_start: Timestamp,
}

/// Conditions at the time of the decision.
#[derive(Debug, Clone)]
pub struct CurrentConditions<'a> {
    pub now: Timestamp,
    /// Reason for which the gate would refuse a start now; `None`: the gate would accept.
    pub gate_refusal: Option<Refusal>,
    /// Last arming of this cycle, valid or not; `None`: never armed.
    pub arming: Option<&'a Arming>,
    /// Combined readiness that the machine reports; `None` without a source, or while a source is stale.
    pub readiness: Option<Readiness>,
    /// Time for which the machine has reported without a break that the control executes no program, and for which no
    /// run of this service was in progress. `None`: not idle, or not reported.
    pub idle_time: Option<Duration>,
}

/// Decision about a due slot.
#[derive(Debug)]
pub enum StartDecision {
    Start,
    /// Decide again at the next check.
    Wait(NotStartedReason),
    /// The slot does not start any more.
    Skip(NotStartedReason),
}

/// Skips without a valid arming; starts if all conditions hold; otherwise waits until the latest start. A plan with
/// prompts, and a run in progress under [`OverlapPolicy::Skip`], skip at once.
pub fn decide_start(requirements: &StartRequirements<'_>, conditions: &CurrentConditions<'_>) -> StartDecision {
    if let Err(why) = check_arming(conditions.arming, conditions.now) {
        return StartDecision::Skip(why);
    }
    let Some(why) = unmet_condition(requirements, conditions) else { return StartDecision::Start };
    if conditions.now > requirements.latest_start {
        return StartDecision::Skip(NotStartedReason::LatestStartPassed(Box::new(why)));
    }
    match conditions.gate_refusal {
        // Waiting does not help: an unattended machine has no person for the prompts later either.
        Some(Refusal::PlanHasPrompts) => StartDecision::Skip(why),
        Some(Refusal::Busy) if requirements.overlap_policy == OverlapPolicy::Skip => StartDecision::Skip(why),
        _ => StartDecision::Wait(why),
    }
}

/// Checks that the arming is valid at `now`.
///
/// # Errors
/// Why the arming is not valid.
pub fn check_arming(arming: Option<&Arming>, now: Timestamp) -> Result<(), NotStartedReason> {
    let Arming { who, ended, broken_by_run: broken, until, armed, .. } =
        arming.ok_or(NotStartedReason::CycleNotArmed)?;
    let who = who.clone();
    if let Some((when, why)) = ended {
        return Err(NotStartedReason::ArmingEnded { who, when: *when, why: why.clone() });
    }
    if let Some(run) = *broken {
        return Err(NotStartedReason::ArmingBroken { who, run });
    }
    if now >= *until {
        return Err(NotStartedReason::ArmingExpired { who, until: *until });
    }
    match armed.duration_since(now) > MAX_TOLERATED_CLOCK_SETBACK {
        true => Err(NotStartedReason::ClockSetBack { who }),
        false => Ok(()),
    }
}

/// First condition that does not hold; `None`: all hold. The arming is not checked here.
fn unmet_condition(
    requirements: &StartRequirements<'_>,
    conditions: &CurrentConditions<'_>,
) -> Option<NotStartedReason> {
    let readiness = match (conditions.readiness, conditions.gate_refusal) {
        (None, None | Some(Refusal::Stale)) => {
            let inputs = required_input_names(requirements);
            return Some(NotStartedReason::NoCurrentInputReport { inputs });
        }
        (_, Some(why)) => return Some(NotStartedReason::GateWouldRefuse(why)),
        (Some(readiness), None) => readiness,
    };
    let unmet_input = requirements.required_conditions.iter().find_map(|input| match input {
        ReadinessCondition::Probe => {
            (!readiness.is_probe_ready).then_some("the control does not report that the probe is ready (`probe`)")
        }
        ReadinessCondition::Artefact => (!readiness.is_artefact_in_place)
            .then_some("the control does not report that the artefact is in place (`artefact`)"),
        ReadinessCondition::Temperature => (!readiness.is_temperature_in_range)
            .then_some("the control does not report that the temperature is in the permitted range (`temperature`)"),
    });
    if let Some(condition) = unmet_input {
        return Some(NotStartedReason::UnmetCondition { condition });
    }
    unmet_idle_time(requirements.min_idle_time, conditions.idle_time)
}

/// Why the idle time is too short; `None`: long enough, or not required.
fn unmet_idle_time(min_idle: Duration, idle_time: Option<Duration>) -> Option<NotStartedReason> {
    let minutes = |span: Duration| span.as_secs() / 60;
    match idle_time {
        _ if min_idle.is_zero() => None,
        None => Some(NotStartedReason::IdleNotReported),
        Some(idle) if idle < min_idle => {
            Some(NotStartedReason::IdleTooShort { idle_min: minutes(idle), min_idle_min: minutes(min_idle) })
        }
        Some(_) => None,
    }
}

/// Names of all inputs that the machine would have to report.
fn required_input_names(requirements: &StartRequirements<'_>) -> String {
    let demands = requirements.required_interlocks.iter().map(|demand| match demand {
        StartInterlock::Enable => "enable",
        StartInterlock::Auto => "auto",
        StartInterlock::Door => "door",
    });
    let inputs = requirements.required_conditions.iter().map(|input| match input {
        ReadinessCondition::Probe => "probe",
        ReadinessCondition::Artefact => "artefact",
        ReadinessCondition::Temperature => "temperature",
    });
    let idle = (!requirements.min_idle_time.is_zero()).then_some("idle");
    demands.chain(inputs).chain(idle).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::machine_state::Interlocks;
    use crate::store::RunId;

    const ALL_INTERLOCKS: [StartInterlock; 3] = [StartInterlock::Enable, StartInterlock::Auto, StartInterlock::Door];
    const ALL_CONDITIONS: [ReadinessCondition; 3] =
        [ReadinessCondition::Probe, ReadinessCondition::Artefact, ReadinessCondition::Temperature];
    const MIN_IDLE_TIME: Duration = Duration::from_secs(20 * 60);

    fn parse_timestamp(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    fn valid_arming() -> Arming {
        Arming {
            machine: "m".to_owned(),
            cycle: 1,
            who: "Ada".to_owned(),
            why: String::new(),
            armed: parse_timestamp("2026-11-20T16:00:00Z"),
            until: parse_timestamp("2026-11-27T16:00:00Z"),
            ended: None,
            broken_by_run: None,
        }
    }

    fn full_readiness() -> Readiness {
        let interlocks = Interlocks {
            is_fresh: true,
            is_start_enabled: true,
            is_auto_mode: true,
            is_door_closed: true,
            is_stop_set: false,
            has_person_for_prompts: false,
        };
        Readiness {
            interlocks,
            is_probe_ready: true,
            is_artefact_in_place: true,
            is_temperature_in_range: true,
            is_control_idle: true,
        }
    }

    /// Decision with all conditions met at 05:30 in Berlin, after `change`.
    fn decide_start_after(
        change: impl FnOnce(&mut StartRequirements<'_>, &mut CurrentConditions<'_>, &mut Arming),
    ) -> StartDecision {
        let (mut arming, mut requirements, mut conditions) = (
            valid_arming(),
            StartRequirements {
                required_interlocks: &ALL_INTERLOCKS,
                required_conditions: &ALL_CONDITIONS,
                min_idle_time: MIN_IDLE_TIME,
                overlap_policy: OverlapPolicy::Wait,
                latest_start: parse_timestamp("2026-11-23T05:00:00Z"),
            },
            CurrentConditions {
                now: parse_timestamp("2026-11-23T04:30:00Z"),
                gate_refusal: None,
                arming: None,
                readiness: Some(full_readiness()),
                idle_time: Some(MIN_IDLE_TIME),
            },
        );
        change(&mut requirements, &mut conditions, &mut arming);
        decide_start(&requirements, &CurrentConditions { arming: Some(&arming), ..conditions })
    }

    /// `!` for a start, `w` for waiting, `s` for a skipped slot; with the reason.
    fn decision_letter_and_reason(decision: StartDecision) -> (char, String) {
        match decision {
            StartDecision::Start => ('!', String::new()),
            StartDecision::Wait(why) => ('w', why.to_string()),
            StartDecision::Skip(why) => ('s', why.to_string()),
        }
    }

    #[test]
    fn armed_and_ready_cycle_starts_until_the_latest_start() {
        assert_eq!(decision_letter_and_reason(decide_start_after(|_, _, _| {})).0, '!');
        let latest_start = decide_start_after(|requirements, conditions, _| conditions.now = requirements.latest_start);
        assert_eq!(decision_letter_and_reason(latest_start).0, '!');
    }

    #[test]
    fn each_unmet_condition_is_awaited_and_named() {
        type ReadinessChange = fn(&mut Readiness);
        let cases: [(ReadinessChange, &str); 3] = [
            (|readiness| readiness.is_probe_ready = false, "`probe`"),
            (|readiness| readiness.is_artefact_in_place = false, "`artefact`"),
            (|readiness| readiness.is_temperature_in_range = false, "`temperature`"),
        ];
        for (change, name) in cases {
            let (kind, why) = decision_letter_and_reason(decide_start_after(|_, conditions, _| {
                let mut readiness = full_readiness();
                change(&mut readiness);
                conditions.readiness = Some(readiness);
            }));
            assert!(kind == 'w' && why.contains(name), "{kind} {why}");
        }
        for (refused, name) in [(Refusal::NotEnabled, "external start"), (Refusal::DoorOpen, "guard")] {
            let (kind, why) = decision_letter_and_reason(decide_start_after(|_, conditions, _| {
                conditions.gate_refusal = Some(refused)
            }));
            assert!(kind == 'w' && why.contains(name), "{kind} {why}");
        }
        for (idle, name) in [(None, "`idle`"), (Some(MIN_IDLE_TIME / 4), "5 of 20 minutes")] {
            let (kind, why) =
                decision_letter_and_reason(decide_start_after(|_, conditions, _| conditions.idle_time = idle));
            assert!(kind == 'w' && why.contains(name), "{kind} {why}");
        }
    }

    #[test]
    fn start_without_a_report_waits_and_names_all_inputs() {
        let remove_reports = |conditions: &mut CurrentConditions<'_>| {
            (conditions.readiness, conditions.idle_time) = (None, None);
            conditions.gate_refusal = Some(Refusal::Stale);
        };
        let (kind, why) = decision_letter_and_reason(decide_start_after(|_, conditions, _| remove_reports(conditions)));
        let all = "not ready: no current report of enable, auto, door, probe, artefact, temperature, idle";
        assert_eq!((kind, why.as_str()), ('w', all));
    }

    #[test]
    fn start_after_latest_time_is_skipped_with_the_unmet_condition() {
        let (kind, why) = decision_letter_and_reason(decide_start_after(|requirements, conditions, _| {
            conditions.now = parse_timestamp("2026-11-23T05:00:01Z");
            conditions.gate_refusal = Some(Refusal::DoorOpen);
            requirements.overlap_policy = OverlapPolicy::Wait;
        }));
        assert_eq!((kind, why.as_str()), ('s', "the latest start time has passed: not ready: a guard is open"));
    }

    #[test]
    fn start_during_a_run_waits_or_is_skipped_by_the_overlap_policy() {
        let busy = |overlap| {
            let (kind, why) = decision_letter_and_reason(decide_start_after(|requirements, conditions, _| {
                (requirements.overlap_policy, conditions.gate_refusal) = (overlap, Some(Refusal::Busy));
            }));
            assert!(why.contains("a run is in progress"), "{why}");
            kind
        };
        assert_eq!([busy(OverlapPolicy::Wait), busy(OverlapPolicy::Skip)], ['w', 's']);
        // The minimum interval after the end of the run is not over yet: a later start is possible.
        let soon = decide_start_after(|requirements, conditions, _| {
            (requirements.overlap_policy, conditions.gate_refusal) = (OverlapPolicy::Skip, Some(Refusal::TooSoon));
        });
        assert_eq!(decision_letter_and_reason(soon).0, 'w');
    }

    #[test]
    fn cycle_with_prompts_is_skipped() {
        let (kind, why) = decision_letter_and_reason(decide_start_after(|_, conditions, _| {
            conditions.gate_refusal = Some(Refusal::PlanHasPrompts)
        }));
        assert!(kind == 's' && why.contains("has prompts"), "{kind} {why}");
    }

    #[test]
    fn start_without_valid_arming_is_skipped_with_the_reason() {
        type ArmingChange = fn(&mut Arming);
        let cases: [(ArmingChange, &str); 4] = [
            (|arming| arming.until = parse_timestamp("2026-11-23T04:30:00Z"), "expired at"),
            (|arming| arming.broken_by_run = Some(RunId(7)), "run 7"),
            (|arming| arming.ended = Some((arming.armed, "it is Sunday".to_owned())), "Sunday"),
            (|arming| arming.armed = parse_timestamp("2026-11-23T05:30:01Z"), "set back"),
        ];
        for (change, name) in cases {
            let (kind, why) = decision_letter_and_reason(decide_start_after(|_, _, arming| change(arming)));
            assert!(kind == 's' && why.contains(name), "{kind} {why}");
        }
        assert!(check_arming(None, parse_timestamp("2026-11-23T04:30:00Z")).is_err());
    }
}
