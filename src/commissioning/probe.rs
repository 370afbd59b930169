//! Checks that the probe input is open at rest, closed while the stylus is deflected, and open again. Nothing
//! moves but the stylus, by hand, and before it the retract out of contact.

use std::time::{Duration, Instant};

use tokio::time::sleep;

use super::{Check, Ended, Part, control, retract};
use machine::record::question::{Answer, Question, Stylus};

const NOBODY: &str = "nobody is there to deflect the stylus";
const POLL: Duration = Duration::from_millis(20);

/// Observed behaviour of the probe input.
struct Seen {
    /// The input is closed at rest.
    rests_closed: bool,
    /// The input changes while the stylus is deflected.
    answers: bool,
    /// The input returns to its state at rest.
    comes_back: bool,
}

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    retract::out_of_contact(check).await?;
    let since = Instant::now();
    let Some(seen) = watch(check, since).await? else {
        return if check.stands.is_some() {
            stands_anew(check, since).await
        } else {
            Err(Ended::Unsafe)
        };
    };
    if let Some((what, remedy)) = seen.mistake(check.polarity.as_deref()) {
        check.failed(Part::Probe, since, what, remedy);
        // With a faulty probe nothing would stop at a contact.
        return Err(Ended::Unsafe);
    }
    check.well(Part::Probe, since, "open at rest, closed while deflected, open again");
    check.probe_answers = true;
    match check.stands {
        Some(_) => stands_anew(check, since).await,
        // The stylus was deflected while the control was prepared.
        None => control::prepare(check).await,
    }
}

/// Watches the probe input; `None`, with a finding, if it cannot be checked.
async fn watch(check: &mut Check<'_>, since: Instant) -> Result<Option<Seen>, Ended> {
    if !mounted(check).await? {
        let rests_closed = control::status(check, since).await?.probe_closed;
        nobody(check, since, rests_closed, "the touch probe does not sit in the spindle");
        return Ok(None);
    }
    let asked = check.ask(Question::Stylus(Stylus::Free)).await?;
    let rests_closed = control::status(check, since).await?.probe_closed;
    if asked != Answer::Yes {
        nobody(check, since, rests_closed, NOBODY);
        return Ok(None);
    }
    let pressed = check.ask(Question::Stylus(Stylus::Deflected)).await?;
    if pressed != Answer::Yes {
        nobody(check, since, rests_closed, NOBODY);
        return Ok(None);
    }
    let answers = becomes(check, since, !rests_closed).await?;
    let let_go = check.ask(Question::Stylus(Stylus::Free)).await?;
    let comes_back = let_go == Answer::Yes && becomes(check, since, rests_closed).await?;
    Ok(Some(Seen { rests_closed, answers, comes_back }))
}

/// Whether the probe is mounted. The operator is asked to mount it if a sensor may have replaced it.
async fn mounted(check: &mut Check<'_>) -> Result<bool, Ended> {
    let swapped = check.file.sensors.iter().any(|entry| entry.sensor.mount.is_spindle());
    Ok(!swapped || check.ask(Question::Stylus(Stylus::Mounted)).await? != Answer::No)
}

fn nobody(check: &mut Check<'_>, since: Instant, rests_closed: bool, why: &str) {
    if rests_closed {
        let remedy = "run trued check at a terminal: it leads a stylus that is in contact out of it, step by \
                      step, and tells whether the input is inverted or stuck; or free the stylus by hand (with \
                      a sensor in the probe's place the input must read open as well)";
        check.failed(Part::Probe, since, "the probe reads closed", remedy);
    } else {
        check.well(Part::Probe, since, "open at rest");
        check.not_looked_at(Part::Probe, format!("{why}: whether it closes"));
    }
}

/// Updates the position: the operator may have moved the machine to reach the stylus.
async fn stands_anew(check: &mut Check<'_>, since: Instant) -> Result<(), Ended> {
    check.stands = Some(control::status(check, since).await?.stands);
    Ok(())
}

/// Waits for the state `closed` of the probe input; returns whether it came in time.
async fn becomes(check: &mut Check<'_>, since: Instant, closed: bool) -> Result<bool, Ended> {
    let deadline = Instant::now() + check.person.takes();
    loop {
        check.go_on()?;
        if control::status(check, since).await?.probe_closed == closed {
            return Ok(true);
        }
        if Instant::now() > deadline {
            return Ok(false);
        }
        sleep(POLL).await;
    }
}

impl Seen {
    /// Fault and remedy. `polarity`: the setting that inverts the input at the control.
    fn mistake(&self, polarity: Option<&str>) -> Option<(String, String)> {
        let (what, remedy) = match (self.rests_closed, self.answers) {
            (false, true) if self.comes_back => return None,
            (false, true) => (
                "it stays closed after the stylus was let go: the stylus does not come back",
                "free the stylus; does the probe seat again? Clean it, or have its spring looked at",
            ),
            (false, false) => (
                "the input never closes, though the stylus is deflected: the probe is dead",
                "is the probe on, its battery fresh, its receiver in sight, its cable plugged into the \
                 probe's input of the control? If a word of the control switches it on, write it in \
                 [probe] on",
            ),
            (true, true) => (
                "it reads closed at rest and open while deflected: the input is inverted",
                polarity.unwrap_or("turn the polarity of the probe's input round at the control"),
            ),
            (true, false) => (
                "the input is closed whatever the stylus does: it is stuck",
                "is the stylus jammed, the cable shorted, the wrong input connected, or does the \
                 receiver report an error (no battery, out of sight)?",
            ),
        };
        Some((what.to_owned(), remedy.to_owned()))
    }
}
