//! Jobs of the simulated control: executed one after the other, at once or in real time.

use super::{FaultKind, Firmware, HARD_LIMIT, Lock, NO_CONTACT, PROBE_CLOSED};
use crate::Contact;
use crate::interpreter::{Active, Done, Job, ProbeInputFault};
use machine::Position;

/// Reports that show a brushed stylus: two, because one may get lost on a bad wire.
const BRUSHED_REPORTS: u8 = 2;

/// The result of a probing move.
#[derive(Debug, Clone, Default)]
pub(super) struct Last {
    position: Position,
    hit: bool,
    t_s: Option<f64>,
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
        if self.sham == ProbeInputFault::Brush && job.is_free_move() {
            self.sham = ProbeInputFault::Brushed(BRUSHED_REPORTS);
            self.happens(FaultKind::RapidContact);
        }
        let (sham, pace, now) = (self.sham, self.options.pace, self.now);
        let active = self.with_world(|world| Active::begin(job, world, sham, pace, now));
        self.active = Some(active);
    }

    pub(super) fn finish_active(&mut self) {
        let Some(active) = self.active.take() else { return };
        let sham = self.sham;
        let done = self.with_world(|world| active.finish(world, sham));
        let waited_for = active.is_waited_for();
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
        if self.sham == ProbeInputFault::Early {
            self.sham = ProbeInputFault::No;
            self.happens(FaultKind::ForeignBody);
        }
        let t_s = contact.as_ref().map(|contact| contact.t_s);
        let position = contact.map_or_else(|| self.stand(), |contact| contact.position);
        self.last = Some(Last { position, hit, t_s });
        self.say_last();
    }

    /// Reports the last probing move; zeros before the first one.
    pub(super) fn say_last(&mut self) {
        let last = self.last.clone().unwrap_or_default();
        self.say(&format!("[PRB:{}:{}]", self.list(&last.position), u8::from(last.hit)));
        if let Some(t_s) = last.t_s.filter(|_| self.options.stamps) {
            self.say(&format!("[TIME:{t_s}]"));
        }
    }

    /// Whether the probe input reads closed.
    pub(super) fn tripped(&self) -> bool {
        self.with_world(|world| self.sham.tripped(world))
    }

    /// Registers that a report has shown the probe state.
    pub(super) fn on_probe_state_reported(&mut self) {
        self.sham = self.sham.told();
    }

    /// A drive that is pressed against an obstacle stalls; the control reports a hard limit.
    fn crash_if(&mut self, crashed: bool) {
        if crashed {
            self.say(&format!("ALARM:{HARD_LIMIT}"));
            self.stop_here();
            self.alarm = Some(Lock::Reset);
        }
    }

    /// `!`: stops the machine where it is and keeps the remaining motion for `~`.
    pub(super) fn hold(&mut self) {
        if self.alarm.is_some() {
            return;
        }
        self.held = true;
        let Some(active) = self.active.take() else { return };
        let now = self.now;
        let left = self.with_world(|world| active.hold(world, now));
        self.queue.push_front(left);
    }
}
