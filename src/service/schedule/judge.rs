//! Decision whether a due slot may start: a pure function of the current state.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::entry::{Overlap, ReadinessCondition};
use crate::service::config::Demand;
use crate::service::machine_state::Refusal;
use crate::service::schedule_state::Readiness;
use crate::store::Arming;

/// Maximum time by which an arming may be later than the clock; beyond it, the clock was set back, and the arming is
/// invalid.
const SET_BACK: SignedDuration = SignedDuration::from_hours(1);

/// Conditions of a start.
#[derive(Debug, Clone)]
pub struct StartRequirements<'a> {
    pub demand: &'a [Demand],
    pub ready: &'a [ReadinessCondition],
    pub idle: Duration,
    pub overlap: Overlap,
    pub latest: Timestamp,
}

/// Current state of the machine, for the decision.
#[derive(Debug, Clone)]
pub struct StartConditions<'a> {
    pub now: Timestamp,
    /// Reason for which the gate would refuse a start now.
    pub refused: Option<Refusal>,
    /// Last arming of this cycle.
    pub arming: Option<&'a Arming>,
    /// Readiness that the machine reports; `None` without a fresh report.
    pub readiness: Option<Readiness>,
    /// Time for which the machine has reported without a break that the control executes no program, and for which no
    /// run of this service was in progress.
    pub idle: Option<Duration>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decision {
    Start,
    Wait(String),
    Skip(String),
}

pub fn judge(requirements: &StartRequirements<'_>, standing: &StartConditions<'_>) -> Decision {
    if let Err(why) = armed(standing.arming, standing.now) {
        return Decision::Skip(why);
    }
    let Some(why) = unmet_condition(requirements, standing) else { return Decision::Start };
    if standing.now > requirements.latest {
        return Decision::Skip(format!("its latest start is over: {why}"));
    }
    match standing.refused {
        // Waiting does not help: no person will be at the machine later either.
        Some(Refusal::AsksPerson) => Decision::Skip(why),
        Some(Refusal::Busy) if requirements.overlap == Overlap::Skip => Decision::Skip(why),
        _ => Decision::Wait(why),
    }
}

/// Checks that the arming is valid at `now`.
///
/// # Errors
/// Why the arming is not valid.
pub fn armed(arming: Option<&Arming>, now: Timestamp) -> Result<(), String> {
    let Some(arming) = arming else {
        return Err("nobody has armed this cycle for unattended motion".to_owned());
    };
    let who = &arming.who;
    if let Some((when, why)) = &arming.ended {
        return Err(format!("the arming by {who} ended at {when}: {why}"));
    }
    if let Some(run) = arming.broken {
        return Err(format!("run {run} did not come to its end since {who} armed this cycle"));
    }
    if now >= arming.until {
        return Err(format!("the arming by {who} was until {}", arming.until));
    }
    match arming.armed.duration_since(now) > SET_BACK {
        true => Err(format!("the clock was set back to before the arming by {who}")),
        false => Ok(()),
    }
}

fn unmet_condition(
    requirements: &StartRequirements<'_>,
    standing: &StartConditions<'_>,
) -> Option<String> {
    let Some(readiness) = standing.readiness else {
        return Some(match standing.refused {
            None | Some(Refusal::Stale) => {
                format!("not ready: nobody tells {}", names(requirements))
            }
            Some(why) => format!("not ready: {why}"),
        });
    };
    if let Some(why) = standing.refused {
        return Some(format!("not ready: {why}"));
    }
    let needs = requirements.ready.iter().find_map(|need| match need {
        ReadinessCondition::Probe => (!readiness.probe).then_some("the probe (`probe`)"),
        ReadinessCondition::Artefact => {
            (!readiness.artefact).then_some("the artefact (`artefact`)")
        }
        ReadinessCondition::Temperature => {
            (!readiness.temperature).then_some("the temperature (`temperature`)")
        }
    });
    if let Some(need) = needs {
        return Some(format!(
            "not ready: the machine does not tell that {need} is as it should be"
        ));
    }
    unmet_idle_time(requirements.idle, standing.idle)
}

fn unmet_idle_time(requirements: Duration, idle: Option<Duration>) -> Option<String> {
    let minutes = |span: Duration| span.as_secs() / 60;
    match idle {
        _ if requirements.is_zero() => None,
        None => Some("not ready: the machine does not tell that it is idle (`idle`)".to_owned()),
        Some(idle) if idle < requirements => Some(format!(
            "not ready: idle for {} of {} minutes",
            minutes(idle),
            minutes(requirements)
        )),
        Some(_) => None,
    }
}

/// Names of all inputs that the machine would have to report.
fn names(requirements: &StartRequirements<'_>) -> String {
    let demands = requirements.demand.iter().map(|demand| match demand {
        Demand::Enable => "enable",
        Demand::Auto => "auto",
        Demand::Door => "door",
    });
    let needs = requirements.ready.iter().map(|need| match need {
        ReadinessCondition::Probe => "probe",
        ReadinessCondition::Artefact => "artefact",
        ReadinessCondition::Temperature => "temperature",
    });
    let idle = (!requirements.idle.is_zero()).then_some("idle");
    demands.chain(needs).chain(idle).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::machine_state::Interlocks;
    use crate::store::RunId;

    const DEMAND: [Demand; 3] = [Demand::Enable, Demand::Auto, Demand::Door];
    const READY: [ReadinessCondition; 3] =
        [ReadinessCondition::Probe, ReadinessCondition::Artefact, ReadinessCondition::Temperature];
    const IDLE: Duration = Duration::from_secs(20 * 60);

    fn at(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    fn arming() -> Arming {
        Arming {
            machine: "m".to_owned(),
            cycle: 1,
            who: "Ada".to_owned(),
            why: String::new(),
            armed: at("2026-11-20T16:00:00Z"),
            until: at("2026-11-27T16:00:00Z"),
            ended: None,
            broken: None,
        }
    }

    fn readiness() -> Readiness {
        let interlocks = Interlocks {
            fresh: true,
            enable: true,
            auto: true,
            door: true,
            stop: false,
            person: false,
        };
        Readiness { interlocks, probe: true, artefact: true, temperature: true, idle: true }
    }

    /// Decision with all conditions met at 05:30 in Berlin, after `change`.
    fn decided(
        change: impl FnOnce(&mut StartRequirements<'_>, &mut StartConditions<'_>, &mut Arming),
    ) -> Decision {
        let (mut arming, mut requirements, mut standing) = (
            arming(),
            StartRequirements {
                demand: &DEMAND,
                ready: &READY,
                idle: IDLE,
                overlap: Overlap::Wait,
                latest: at("2026-11-23T05:00:00Z"),
            },
            StartConditions {
                now: at("2026-11-23T04:30:00Z"),
                refused: None,
                arming: None,
                readiness: Some(readiness()),
                idle: Some(IDLE),
            },
        );
        change(&mut requirements, &mut standing, &mut arming);
        judge(&requirements, &StartConditions { arming: Some(&arming), ..standing })
    }

    fn words(decision: Decision) -> (char, String) {
        match decision {
            Decision::Start => ('!', String::new()),
            Decision::Wait(why) => ('w', why),
            Decision::Skip(why) => ('s', why),
        }
    }

    #[test]
    fn it_starts_when_all_is_told_and_armed() {
        assert_eq!(decided(|_, _, _| {}), Decision::Start);
        let latest = decided(|requirements, standing, _| standing.now = requirements.latest);
        assert_eq!(latest, Decision::Start);
    }

    #[test]
    fn each_condition_that_does_not_hold_is_waited_for_and_named() {
        type Change = fn(&mut Readiness);
        let cases: [(Change, &str); 3] = [
            (|readiness| readiness.probe = false, "`probe`"),
            (|readiness| readiness.artefact = false, "`artefact`"),
            (|readiness| readiness.temperature = false, "`temperature`"),
        ];
        for (change, name) in cases {
            let (kind, why) = words(decided(|_, standing, _| {
                let mut readiness = readiness();
                change(&mut readiness);
                standing.readiness = Some(readiness);
            }));
            assert!(kind == 'w' && why.contains(name), "{kind} {why}");
        }
        for (refused, name) in
            [(Refusal::NotEnabled, "external start"), (Refusal::DoorOpen, "guard")]
        {
            let (kind, why) = words(decided(|_, standing, _| standing.refused = Some(refused)));
            assert!(kind == 'w' && why.contains(name), "{kind} {why}");
        }
        for (idle, name) in [(None, "`idle`"), (Some(IDLE / 4), "5 of 20 minutes")] {
            let (kind, why) = words(decided(|_, standing, _| standing.idle = idle));
            assert!(kind == 'w' && why.contains(name), "{kind} {why}");
        }
    }

    #[test]
    fn what_nobody_tells_is_not_assumed() {
        let nobody = |standing: &mut StartConditions<'_>| {
            (standing.readiness, standing.idle) = (None, None);
            standing.refused = Some(Refusal::Stale);
        };
        let (kind, why) = words(decided(|_, standing, _| nobody(standing)));
        let all = "not ready: nobody tells enable, auto, door, probe, artefact, temperature, idle";
        assert_eq!((kind, why.as_str()), ('w', all));
    }

    #[test]
    fn after_the_latest_start_nothing_starts_and_why_not_is_told() {
        let (kind, why) = words(decided(|requirements, standing, _| {
            standing.now = at("2026-11-23T05:00:01Z");
            standing.refused = Some(Refusal::DoorOpen);
            requirements.overlap = Overlap::Wait;
        }));
        assert_eq!(
            (kind, why.as_str()),
            ('s', "its latest start is over: not ready: a guard is open")
        );
    }

    #[test]
    fn a_run_that_is_on_is_waited_for_or_not() {
        let busy = |overlap| {
            let (kind, why) = words(decided(|requirements, standing, _| {
                (requirements.overlap, standing.refused) = (overlap, Some(Refusal::Busy));
            }));
            assert!(why.contains("a run is on"), "{why}");
            kind
        };
        assert_eq!([busy(Overlap::Wait), busy(Overlap::Skip)], ['w', 's']);
        // The minimum interval after the end of the run is not over yet: a later start is possible.
        let soon = decided(|requirements, standing, _| {
            (requirements.overlap, standing.refused) = (Overlap::Skip, Some(Refusal::TooSoon));
        });
        assert_eq!(words(soon).0, 'w');
    }

    #[test]
    fn a_cycle_that_asks_a_person_is_not_waited_for() {
        let (kind, why) =
            words(decided(|_, standing, _| standing.refused = Some(Refusal::AsksPerson)));
        assert!(kind == 's' && why.contains("asks a person"), "{kind} {why}");
    }

    #[test]
    fn nothing_starts_that_is_not_armed_now() {
        type Change = fn(&mut Arming);
        let cases: [(Change, &str); 4] = [
            (|arming| arming.until = at("2026-11-23T04:30:00Z"), "was until"),
            (|arming| arming.broken = Some(RunId(7)), "run 7"),
            (|arming| arming.ended = Some((arming.armed, "it is Sunday".to_owned())), "Sunday"),
            (|arming| arming.armed = at("2026-11-23T05:30:01Z"), "set back"),
        ];
        for (change, name) in cases {
            let (kind, why) = words(decided(|_, _, arming| change(arming)));
            assert!(kind == 's' && why.contains(name), "{kind} {why}");
        }
        assert!(armed(None, at("2026-11-23T04:30:00Z")).is_err());
    }
}
