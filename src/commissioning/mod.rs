//! `trued check`: compares the machine with its machine file, part by part. Each part checks one aspect,
//! reports its finding, and names a fault with its remedy. Every motion is proven and needs the operator's
//! permission directly before it; a check that nobody can confirm is reported as not checked.
//!
//! A failed part ends the check if it would not be safe to continue; otherwise the next part follows.

mod axes;
mod compare;
mod control;
mod finding;
mod hold;
mod jog;
mod latch;
mod links;
mod person;
mod probe;
mod question_text;
mod retract;
mod sensors;
mod stop;
mod thermometers;

use std::pin::Pin;
use std::time::Instant;

pub use finding::{Finding, Part, Summary, Verdict};
pub use person::{Answering, Nobody, Person};
pub use question_text::of as words_of;
pub use stop::Stop;

use crate::setup::{Devices, MachineFile, Pace, SetupError, Site};
use crate::store::Journal;
use devices::controllers::Controller;
use machine::record::question::{Answer, Question};
use machine::{Axis, Position};
use planning::gcode::Transmission;

/// Reason why the remaining parts are not checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ended {
    /// The fault must be corrected first.
    Unsafe,
    /// A person has stopped the check.
    Stopped,
}

type Looking<'c> = Pin<Box<dyn Future<Output = Result<(), Ended>> + 'c>>;
type Look = for<'c, 'a> fn(&'c mut Check<'a>) -> Looking<'c>;

/// The parts in their order. A new part is a line here.
const PARTS: [(Part, Look); 7] = [
    (Part::Links, |check| Box::pin(links::look(check))),
    (Part::Sensors, |check| Box::pin(sensors::look(check))),
    (Part::Control, |check| Box::pin(control::look(check))),
    (Part::Probe, |check| Box::pin(probe::look(check))),
    (Part::Axes, |check| Box::pin(axes::look(check))),
    (Part::Hold, |check| Box::pin(hold::look(check))),
    (Part::Latch, |check| Box::pin(latch::look(check))),
];

/// State of a check, with its machine and its operator.
pub struct Check<'a> {
    file: &'a MachineFile,
    site: &'a Site<'a>,
    pace: Pace,
    /// Stores the run that the last part makes.
    journal: &'a Journal,
    person: &'a mut dyn Person,
    /// Called with each finding.
    tell: &'a mut dyn FnMut(&Finding),
    stop: Stop,
    /// The open devices, once the links are checked.
    devices: Option<Devices>,
    /// Position of the machine, once the control is checked.
    stands: Option<Position>,
    /// How the control receives blocks; known after it was prepared.
    transmission: Option<Transmission>,
    /// Setting that inverts the probe input at the control, in its own terms.
    polarity: Option<String>,
    /// Whether the probe input was seen both open and closed.
    probe_answers: bool,
    /// Whether an axis did not follow its command.
    strays: bool,
    /// Axes whose travel in the machine file exceeds the control's limits: a jog may end in an alarm.
    beyond_limits: Vec<Axis>,
    summary: Summary,
}

impl<'a> Check<'a> {
    /// A new check; `stop` holds the open control.
    pub fn new(
        (file, site, pace): (&'a MachineFile, &'a Site<'a>, Pace),
        journal: &'a Journal,
        person: &'a mut dyn Person,
        stop: Stop,
        tell: &'a mut dyn FnMut(&Finding),
    ) -> Self {
        let summary = Summary::of(&file.machine.name);
        let (devices, stands, transmission, polarity) = (None, None, None, None);
        let (probe_answers, strays) = (false, false);
        Self {
            file,
            site,
            pace,
            journal,
            person,
            tell,
            stop,
            devices,
            stands,
            transmission,
            polarity,
            probe_answers,
            strays,
            beyond_limits: Vec::new(),
            summary,
        }
    }

    /// Runs all parts. Call inside a tokio runtime.
    pub async fn through(mut self) -> Summary {
        let mut ended = None;
        for (part, look) in PARTS {
            match ended {
                None => ended = look(&mut self).await.err(),
                Some(Ended::Unsafe) => self.not_looked_at(
                    part,
                    "what failed before it must be put right first".to_owned(),
                ),
                Some(Ended::Stopped) => break,
            }
        }
        self.summary.stopped = ended == Some(Ended::Stopped) || self.stop.is_asked();
        self.summary.held |= self.stop.has_held();
        self.leave_as_found().await;
        self.summary
    }

    /// Restores the control's modes. After a fault or a stop nothing more is sent.
    async fn leave_as_found(&self) {
        let sound = self.summary.count(Verdict::Failed) == 0 && !self.summary.stopped;
        if let (Ok(controller), Some(_), true) = (self.controller(), &self.stands, sound) {
            // An error is ignored: the check is over, and the next one sets the modes again.
            drop(controller.finish().await);
        }
    }

    /// Asks the operator.
    ///
    /// # Errors
    /// A stop was requested.
    async fn ask(&mut self, question: Question) -> Result<Answer, Ended> {
        self.go_on()?;
        let answer = self.person.ask(&question).await;
        self.go_on()?;
        Ok(answer)
    }

    fn go_on(&self) -> Result<(), Ended> {
        if self.stop.is_asked() { Err(Ended::Stopped) } else { Ok(()) }
    }

    /// The open control.
    fn controller(&self) -> Result<&Controller, Ended> {
        self.devices.as_ref().map(|devices| &devices.controller).ok_or(Ended::Unsafe)
    }

    /// Opens the control, also again after a hold.
    async fn open(&mut self, pace: Pace) -> Result<(), SetupError> {
        // A port can be open only once.
        self.devices = None;
        let devices = self.site.open(pace).await?;
        self.stop.guards(devices.controller.halt());
        self.devices = Some(devices);
        Ok(())
    }

    fn well(&mut self, part: Part, since: Instant, what: impl Into<String>) {
        self.found(part, Verdict::Ok, since, what.into(), None);
    }

    fn failed(
        &mut self,
        part: Part,
        since: Instant,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        self.found(part, Verdict::Failed, since, what.into(), Some(remedy.into()));
    }

    /// Whether `what` was reported as a failure already.
    fn has_failed(&self, what: &str) -> bool {
        let mut findings = self.summary.findings.iter();
        findings.any(|finding| finding.verdict == Verdict::Failed && finding.what == what)
    }

    fn not_looked_at(&mut self, part: Part, why: impl Into<String>) {
        self.found(part, Verdict::NotLookedAt, Instant::now(), why.into(), None);
    }

    fn found(
        &mut self,
        part: Part,
        verdict: Verdict,
        since: Instant,
        what: String,
        remedy: Option<String>,
    ) {
        let took_s = since.elapsed().as_secs_f64();
        let finding = Finding { part, what, took_s, verdict, remedy };
        (self.tell)(&finding);
        self.summary.findings.push(finding);
    }
}
