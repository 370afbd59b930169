//! Whether what is due may start: one answer from how things stand, without a look at anything else.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::entry::{Need, Overlap};
use crate::service::board::Refusal;
use crate::service::config::Demand;
use crate::service::rota::Told;
use crate::store::Arming;

/// A clock that stands before an arming by more than this is not the clock that it was made by.
const SET_BACK: SignedDuration = SignedDuration::from_hours(1);

/// What a start needs.
#[derive(Debug, Clone)]
pub struct Wanted<'a> {
    pub demand: &'a [Demand],
    pub ready: &'a [Need],
    pub idle: Duration,
    pub overlap: Overlap,
    pub latest: Timestamp,
}

/// How things stand.
#[derive(Debug, Clone)]
pub struct Standing<'a> {
    pub now: Timestamp,
    /// What the desk would refuse a start for, just now.
    pub refused: Option<Refusal>,
    /// The last of this cycle.
    pub arming: Option<&'a Arming>,
    /// `None`: nobody tells anything just now.
    pub told: Option<Told>,
    /// So long it was told without a break that the control executes no program, and none of ours ran.
    pub idle: Option<Duration>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decision {
    Start,
    Wait(String),
    Skip(String),
}

pub fn judge(wanted: &Wanted<'_>, standing: &Standing<'_>) -> Decision {
    if let Err(why) = armed(standing.arming, standing.now) {
        return Decision::Skip(why);
    }
    let Some(why) = hindered(wanted, standing) else { return Decision::Start };
    if standing.now > wanted.latest {
        return Decision::Skip(format!("its latest start is over: {why}"));
    }
    match standing.refused {
        // Nobody will be there later either.
        Some(Refusal::AsksPerson) => Decision::Skip(why),
        Some(Refusal::Busy) if wanted.overlap == Overlap::Skip => Decision::Skip(why),
        _ => Decision::Wait(why),
    }
}

/// # Errors
/// Why it does not count.
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

fn hindered(wanted: &Wanted<'_>, standing: &Standing<'_>) -> Option<String> {
    let Some(told) = standing.told else {
        return Some(match standing.refused {
            None | Some(Refusal::Stale) => format!("not ready: nobody tells {}", names(wanted)),
            Some(why) => format!("not ready: {why}"),
        });
    };
    if let Some(why) = standing.refused {
        return Some(format!("not ready: {why}"));
    }
    let needs = wanted.ready.iter().find_map(|need| match need {
        Need::Probe => (!told.probe).then_some("the probe (`probe`)"),
        Need::Artefact => (!told.artefact).then_some("the artefact (`artefact`)"),
        Need::Temperature => (!told.temperature).then_some("the temperature (`temperature`)"),
    });
    if let Some(need) = needs {
        return Some(format!(
            "not ready: the machine does not tell that {need} is as it should be"
        ));
    }
    rests(wanted.idle, standing.idle)
}

fn rests(wanted: Duration, idle: Option<Duration>) -> Option<String> {
    let minutes = |span: Duration| span.as_secs() / 60;
    match idle {
        _ if wanted.is_zero() => None,
        None => Some("not ready: the machine does not tell that it is idle (`idle`)".to_owned()),
        Some(idle) if idle < wanted => {
            Some(format!("not ready: idle for {} of {} minutes", minutes(idle), minutes(wanted)))
        }
        Some(_) => None,
    }
}

/// Everything that somebody would have to tell.
fn names(wanted: &Wanted<'_>) -> String {
    let demands = wanted.demand.iter().map(|demand| match demand {
        Demand::Enable => "enable",
        Demand::Auto => "auto",
        Demand::Door => "door",
    });
    let needs = wanted.ready.iter().map(|need| match need {
        Need::Probe => "probe",
        Need::Artefact => "artefact",
        Need::Temperature => "temperature",
    });
    let idle = (!wanted.idle.is_zero()).then_some("idle");
    demands.chain(needs).chain(idle).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::board::Said;
    use crate::store::RunId;

    const DEMAND: [Demand; 3] = [Demand::Enable, Demand::Auto, Demand::Door];
    const READY: [Need; 3] = [Need::Probe, Need::Artefact, Need::Temperature];
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

    fn told() -> Told {
        let said =
            Said { fresh: true, enable: true, auto: true, door: true, stop: false, person: false };
        Told { said, probe: true, artefact: true, temperature: true, idle: true }
    }

    /// Everything as it should be, at 05:30 in Berlin, but for what `change` does.
    fn decided(change: impl FnOnce(&mut Wanted<'_>, &mut Standing<'_>, &mut Arming)) -> Decision {
        let (mut arming, mut wanted, mut standing) = (
            arming(),
            Wanted {
                demand: &DEMAND,
                ready: &READY,
                idle: IDLE,
                overlap: Overlap::Wait,
                latest: at("2026-11-23T05:00:00Z"),
            },
            Standing {
                now: at("2026-11-23T04:30:00Z"),
                refused: None,
                arming: None,
                told: Some(told()),
                idle: Some(IDLE),
            },
        );
        change(&mut wanted, &mut standing, &mut arming);
        judge(&wanted, &Standing { arming: Some(&arming), ..standing })
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
        let latest = decided(|wanted, standing, _| standing.now = wanted.latest);
        assert_eq!(latest, Decision::Start);
    }

    #[test]
    fn each_condition_that_does_not_hold_is_waited_for_and_named() {
        type Change = fn(&mut Told);
        let cases: [(Change, &str); 3] = [
            (|told| told.probe = false, "`probe`"),
            (|told| told.artefact = false, "`artefact`"),
            (|told| told.temperature = false, "`temperature`"),
        ];
        for (change, name) in cases {
            let (kind, why) = words(decided(|_, standing, _| {
                let mut told = told();
                change(&mut told);
                standing.told = Some(told);
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
        let nobody = |standing: &mut Standing<'_>| {
            (standing.told, standing.idle) = (None, None);
            standing.refused = Some(Refusal::Stale);
        };
        let (kind, why) = words(decided(|_, standing, _| nobody(standing)));
        let all = "not ready: nobody tells enable, auto, door, probe, artefact, temperature, idle";
        assert_eq!((kind, why.as_str()), ('w', all));
    }

    #[test]
    fn after_the_latest_start_nothing_starts_and_why_not_is_told() {
        let (kind, why) = words(decided(|wanted, standing, _| {
            standing.now = at("2026-11-23T05:00:01Z");
            standing.refused = Some(Refusal::DoorOpen);
            wanted.overlap = Overlap::Wait;
        }));
        assert_eq!(
            (kind, why.as_str()),
            ('s', "its latest start is over: not ready: a guard is open")
        );
    }

    #[test]
    fn a_run_that_is_on_is_waited_for_or_not() {
        let busy = |overlap| {
            let (kind, why) = words(decided(|wanted, standing, _| {
                (wanted.overlap, standing.refused) = (overlap, Some(Refusal::Busy));
            }));
            assert!(why.contains("a run is on"), "{why}");
            kind
        };
        assert_eq!([busy(Overlap::Wait), busy(Overlap::Skip)], ['w', 's']);
        // Too soon after its end: in a moment it may.
        let soon = decided(|wanted, standing, _| {
            (wanted.overlap, standing.refused) = (Overlap::Skip, Some(Refusal::TooSoon));
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
