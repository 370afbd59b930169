//! `trued check`. Part by part, does the machine do what its file says? Each part looks at
//! one thing, says what it found, and names the mistake with its remedy. Nothing moves that a person
//! has not allowed just before, and that was not proven; what nobody can answer for is told as not
//! looked at.
//!
//! A part that fails where going on would not be safe ends the check; otherwise the next one follows.

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
mod retract;
mod sensors;
mod stop;
mod thermometers;
mod words;

use std::pin::Pin;
use std::time::Instant;

pub use finding::{Finding, Part, Summary, Verdict};
pub use person::{Answering, Nobody, Person};
pub use stop::Stop;
pub use words::of as words_of;

use crate::setup::{Devices, MachineFile, Pace, SetupError, Site};
use crate::store::Journal;
use devices::controllers::Controller;
use machine::record::question::{Answer, Question};
use machine::{Axis, Position};
use planning::gcode::Transmission;

/// Why the parts that follow are not looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ended {
    /// What failed must be put right first.
    Unsafe,
    /// A person has stopped it.
    Stopped,
}

type Looking<'c> = Pin<Box<dyn Future<Output = Result<(), Ended>> + 'c>>;
type Look = for<'c, 'a> fn(&'c mut Check<'a>) -> Looking<'c>;

/// The parts in their order. A device more is a line here.
const PARTS: [(Part, Look); 7] = [
    (Part::Links, |check| Box::pin(links::look(check))),
    (Part::Sensors, |check| Box::pin(sensors::look(check))),
    (Part::Control, |check| Box::pin(control::look(check))),
    (Part::Probe, |check| Box::pin(probe::look(check))),
    (Part::Axes, |check| Box::pin(axes::look(check))),
    (Part::Hold, |check| Box::pin(hold::look(check))),
    (Part::Latch, |check| Box::pin(latch::look(check))),
];

/// Whom and what a check needs.
pub struct Check<'a> {
    file: &'a MachineFile,
    site: &'a Site<'a>,
    pace: Pace,
    /// Takes the run that the last part makes.
    journal: &'a Journal,
    person: &'a mut dyn Person,
    /// Told of each finding as it comes.
    tell: &'a mut dyn FnMut(&Finding),
    stop: Stop,
    /// Open, once the links were looked at.
    devices: Option<Devices>,
    /// Where the machine stands, once the control was looked at.
    stands: Option<Position>,
    /// How the control receives blocks, once it was prepared.
    transmission: Option<Transmission>,
    /// How the sense of the probe's input is turned at the control, in its words.
    polarity: Option<String>,
    /// It was seen open and closed.
    probe_answers: bool,
    /// An axis did not go as it was told to.
    strays: bool,
    /// Axes that the machine file lets travel beyond the control's limits: a jog may end in an alarm.
    beyond_limits: Vec<Axis>,
    summary: Summary,
}

impl<'a> Check<'a> {
    /// `stop` holds whatever is open.
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

    /// All parts. Call inside a tokio runtime.
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

    /// Put the control's modes back. After a fault or a stop nothing more is sent.
    async fn leave_as_found(&self) {
        let sound = self.summary.count(Verdict::Failed) == 0 && !self.summary.stopped;
        if let (Ok(controller), Some(_), true) = (self.controller(), &self.stands, sound) {
            // Whatever it says: the check is over, and the next one sets them anew.
            drop(controller.finish().await);
        }
    }

    /// # Errors
    /// A stop.
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

    /// Open the control, anew after a hold.
    async fn open(&mut self, pace: Pace) -> Result<(), SetupError> {
        // A port is open once.
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

    /// Whether `what` was found to be wrong already.
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
