//! What the simulated control does with the machine: one job after the other, at once or in the
//! time it takes.

use std::time::Duration;

use super::{FaultKind, Firmware, HARD_LIMIT, Lock, NO_CONTACT, PROBE_CLOSED, Pace};
use crate::base::{Axis, Position};
use crate::world::{Contact, Probed, Speed, World};

/// One report may get lost on a bad wire.
const BRUSHED_REPORTS: u8 = 2;

#[derive(Debug, Clone)]
pub(super) enum Job {
    Travel { to: Position, feed_mm_min: Option<f64> },
    Probe { to: Position, feed_mm_min: f64, strict: bool, n: u32 },
    Orient { s: f64 },
    Dwell { seconds: f64 },
}

/// The result of a probing move.
#[derive(Debug, Clone, Default)]
pub(super) struct Last {
    position: Position,
    hit: bool,
    t_s: Option<f64>,
}

/// What the probe's input shows instead of the truth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Sham {
    #[default]
    No,
    Closed,
    Open,
    /// Something stands in the way of the next probing move.
    Early,
    /// Something brushes the stylus during the next rapid, or does so now: so many more reports
    /// read closed.
    Brush,
    Brushed(u8),
}

impl Sham {
    fn probe(self, world: &mut World, to: &Position, feed_mm_min: f64, n: u32) -> Probed {
        let way = |share: f64| {
            let from = world.position();
            to.iter()
                .map(|(axis, end)| (axis, from.at(axis) + share * (end - from.at(axis))))
                .collect()
        };
        let end: Position = match self {
            Sham::No | Sham::Closed | Sham::Brush | Sham::Brushed(_) => {
                return world.probe(to, feed_mm_min, n);
            }
            Sham::Open => to.clone(),
            Sham::Early => way(0.4),
        };
        let moved = world.travel(&end, Speed::Feed { mm_min: feed_mm_min });
        let contact = Contact { position: world.position(), t_s: world.time_s() };
        Probed {
            contact: (self == Sham::Early).then_some(contact),
            crashed: moved.crashed,
            duration_s: moved.duration_s,
        }
    }
}

/// A job under way.
pub(super) struct Active {
    job: Job,
    from: Position,
    begun: Duration,
    pub ends: Duration,
    /// Where it would end if nobody holds it.
    end: Position,
}

impl Active {
    /// Share of its time that has passed.
    fn fraction(&self, now: Duration) -> f64 {
        let whole = (self.ends - self.begun).as_secs_f64();
        if whole > 0.0 {
            (now.saturating_sub(self.begun).as_secs_f64() / whole).min(1.0)
        } else {
            1.0
        }
    }

    pub(super) fn position(&self, now: Duration) -> Position {
        let fraction = self.fraction(now);
        let between = |(axis, from): (_, f64)| {
            let to = self.end.get(axis).unwrap_or(from);
            (axis, from + fraction * (to - from))
        };
        self.from.iter().map(between).collect()
    }
}

enum Done {
    Moved { crashed: bool },
    Probed { contact: Option<Contact>, crashed: bool, strict: bool },
    Waited,
}

impl Job {
    pub(super) fn target(&self) -> Option<&Position> {
        match self {
            Job::Travel { to, .. } | Job::Probe { to, .. } => Some(to),
            Job::Orient { .. } | Job::Dwell { .. } => None,
        }
    }

    /// Travel is acknowledged when it is planned, all else when it is done.
    pub(super) fn is_waited_for(&self) -> bool {
        !matches!(self, Job::Travel { .. })
    }

    fn run(&self, world: &mut World, sham: Sham) -> Done {
        match self {
            Job::Travel { to, feed_mm_min } => {
                let speed = feed_mm_min.map_or(Speed::Rapid, |mm_min| Speed::Feed { mm_min });
                Done::Moved { crashed: world.travel(to, speed).crashed }
            }
            Job::Probe { to, feed_mm_min, strict, n } => {
                let probed = sham.probe(world, to, *feed_mm_min, *n);
                Done::Probed { contact: probed.contact, crashed: probed.crashed, strict: *strict }
            }
            Job::Orient { s } => {
                world.orient(*s);
                Done::Waited
            }
            Job::Dwell { seconds } => {
                world.dwell(*seconds);
                Done::Waited
            }
        }
    }

    /// The same job up to the share `fraction` of its time, when it has come to `at`.
    fn run_in_part(&self, world: &mut World, at: &Position, fraction: f64) {
        let part = |to: &Position| at.only(|axis| to.get(axis).is_some());
        match self {
            Job::Travel { to, feed_mm_min: None } => {
                world.travel(&part(to), Speed::Rapid);
            }
            Job::Travel { to, feed_mm_min: Some(mm_min) }
            | Job::Probe { to, feed_mm_min: mm_min, .. } => {
                world.travel(&part(to), Speed::Feed { mm_min: *mm_min });
            }
            Job::Orient { .. } => world.orient(at.at(Axis::S)),
            Job::Dwell { seconds } => world.dwell(seconds * fraction),
        }
    }
}

impl Firmware {
    pub(super) fn start_next(&mut self) {
        let Some(job) = self.queue.pop_front() else { return };
        if matches!(job, Job::Probe { .. }) && self.tripped() {
            self.say(&format!("ALARM:{PROBE_CLOSED}"));
            self.stop_here();
            self.alarm = Some(Lock::Light);
            return self.say_ok();
        }
        if self.sham == Sham::Brush && matches!(job, Job::Travel { feed_mm_min: None, .. }) {
            self.sham = Sham::Brushed(BRUSHED_REPORTS);
            self.happens(FaultKind::RapidContact);
        }
        let from = self.stand();
        let (end, duration) = self.rehearse(&job);
        self.active = Some(Active { job, from, begun: self.now, ends: self.now + duration, end });
    }

    /// Where and when the job ends; the world itself is touched when that time has come, so that a
    /// held move can stay half-way.
    fn rehearse(&self, job: &Job) -> (Position, Duration) {
        if self.options.pace == Pace::Fast {
            return (Position::new(), Duration::ZERO);
        }
        let mut copy = self.with_world(|world| world.clone());
        let begun_s = copy.time_s();
        job.run(&mut copy, self.sham);
        (copy.position(), Duration::from_secs_f64((copy.time_s() - begun_s).max(0.0)))
    }

    pub(super) fn finish_active(&mut self) {
        let Some(active) = self.active.take() else { return };
        let sham = self.sham;
        let done = self.with_world(|world| active.job.run(world, sham));
        let waited_for = active.job.is_waited_for();
        match done {
            Done::Waited => {}
            Done::Moved { crashed } => self.crash_if(crashed),
            Done::Probed { contact, crashed, strict } => {
                self.say_probed(contact, strict);
                self.planned = self.stand();
                self.crash_if(crashed);
            }
        }
        if waited_for {
            self.waiting = false;
            self.say_ok();
        }
    }

    fn say_probed(&mut self, contact: Option<Contact>, strict: bool) {
        if contact.is_none() && strict {
            self.say(&format!("ALARM:{NO_CONTACT}"));
            self.queue.clear();
            self.alarm = Some(Lock::Light);
        }
        let hit = contact.is_some();
        self.touches += u64::from(hit);
        if self.sham == Sham::Early {
            self.sham = Sham::No;
            self.happens(FaultKind::ForeignBody);
        }
        let t_s = contact.as_ref().map(|contact| contact.t_s);
        let position = contact.map_or_else(|| self.stand(), |contact| contact.position);
        self.last = Some(Last { position, hit, t_s });
        self.say_last();
    }

    /// The last probing move; a control that has not probed yet says zeros.
    pub(super) fn say_last(&mut self) {
        let last = self.last.clone().unwrap_or_default();
        self.say(&format!("[PRB:{}:{}]", self.list(&last.position), u8::from(last.hit)));
        if let Some(t_s) = last.t_s.filter(|_| self.options.stamps) {
            self.say(&format!("[T:{t_s}]"));
        }
    }

    /// What the probe's input reads.
    pub(super) fn tripped(&self) -> bool {
        match self.sham {
            Sham::Closed | Sham::Brushed(_) => true,
            Sham::Open => false,
            Sham::No | Sham::Early | Sham::Brush => self.with_world(|world| world.tripped()),
        }
    }

    /// A report has told how the probe reads.
    pub(super) fn probe_was_told(&mut self) {
        self.sham = match self.sham {
            Sham::Brushed(0..=1) => Sham::No,
            Sham::Brushed(left) => Sham::Brushed(left - 1),
            sham => sham,
        };
    }

    /// A drive that is pressed against something stalls; the control sees a hard limit.
    fn crash_if(&mut self, crashed: bool) {
        if crashed {
            self.say(&format!("ALARM:{HARD_LIMIT}"));
            self.stop_here();
            self.alarm = Some(Lock::Reset);
        }
    }

    /// `!`: stop where the machine is, keep what is left for `~`.
    pub(super) fn hold(&mut self) {
        if self.alarm.is_some() {
            return;
        }
        self.held = true;
        let Some(active) = self.active.take() else { return };
        let (at, fraction) = (active.position(self.now), active.fraction(self.now));
        self.with_world(|world| active.job.run_in_part(world, &at, fraction));
        let left = match active.job {
            Job::Dwell { seconds } => Job::Dwell { seconds: seconds * (1.0 - fraction) },
            job => job,
        };
        self.queue.push_front(left);
    }
}
