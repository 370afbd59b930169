//! Execution of lines by the simulated control: one after the other, at once or in real time.

use std::time::Duration;

use super::chunk::BAD_TEXT;
use super::layout::steps;
use super::{
    Entry, FaultKind, Firmware, HARD_LIMIT, HEARTBEAT, HEARTBEAT_LOST, Mode, NO_CONTACT,
    PROBE_CLOSED, SOFT_LIMIT,
};
use crate::Contact;
use crate::interpreter::{Active, Done, Job, LineAction, ProbeInputFault};

/// Reports that show a brushed stylus: two, because one may get lost on a bad wire.
const BRUSHED_REPORTS: u8 = 2;

impl Firmware {
    /// Advances the control to the time `now`.
    pub(super) fn live(&mut self, now: Duration) {
        loop {
            if let Some(ends) = self.active.as_ref().map(|active| active.ends) {
                let stops = self.beat.unwrap_or_default() + HEARTBEAT;
                if stops < ends && stops <= now {
                    self.now = stops;
                    self.hold(HEARTBEAT_LOST);
                } else if ends <= now {
                    self.now = ends;
                    self.finish_active();
                } else {
                    break;
                }
            } else if self.mode != Mode::Ready || self.frozen.is_some() {
                break;
            } else if let Some(line) = self.lines.pop_front() {
                self.line(&line);
            } else if !self.next_row() {
                break;
            }
        }
        self.now = now;
        let done = self.mode == Mode::Ready && !self.is_moving() && self.error == 0;
        if done && self.frozen.is_none() {
            self.executed = self.accepted;
        }
    }

    fn line(&mut self, line: &str) {
        let here = self.stand();
        match self.options.reader.line(line, &here) {
            Ok(LineAction::Nothing) => {}
            Ok(LineAction::OutOfTravel) => self.alarm(SOFT_LIMIT),
            Ok(LineAction::Do(job)) => self.start(job),
            Err(_) => {
                self.error = BAD_TEXT;
                self.lines.clear();
            }
        }
    }

    pub(super) fn start(&mut self, job: Job) {
        if matches!(job, Job::Probe { .. }) && self.tripped() {
            return self.alarm(PROBE_CLOSED);
        }
        if self.sham == ProbeInputFault::Brush && job.is_free_move() {
            self.sham = ProbeInputFault::Brushed(BRUSHED_REPORTS);
            self.note(Entry::Wrong(FaultKind::RapidContact));
        }
        let (sham, pace, now) = (self.sham, self.options.pace, self.now);
        let active = self.with_world(|world| Active::begin(job, world, sham, pace, now));
        self.active = Some(active);
    }

    fn finish_active(&mut self) {
        let Some(active) = self.active.take() else { return };
        let sham = self.sham;
        match self.with_world(|world| active.finish(world, sham)) {
            Done::Waited => self.row_done(None),
            Done::Moved { crashed } => {
                self.row_done(None);
                self.crash_if(crashed);
            }
            Done::Probed { contact, crashed, strict } => {
                let met = contact.is_some();
                if contact.is_none() && strict {
                    self.alarm(NO_CONTACT);
                }
                if let Some(contact) = contact {
                    self.latch(contact);
                }
                if self.sham == ProbeInputFault::Early {
                    self.sham = ProbeInputFault::No;
                    self.note(Entry::Wrong(FaultKind::ForeignBody));
                }
                self.row_done(Some(met));
                self.crash_if(crashed);
            }
        }
    }

    fn latch(&mut self, contact: Contact) {
        self.latches = self.latches.wrapping_add(1);
        self.touches += 1;
        self.latch = contact.position;
        self.latch_time_s = contact.t_s;
        self.note(Entry::Contact { latch: steps(&self.latch), t_s: contact.t_s });
    }

    /// Whether the probe input reads closed.
    pub(super) fn tripped(&self) -> bool {
        self.with_world(|world| self.sham.tripped(world))
    }

    /// Registers that a status has shown the probe state.
    pub(super) fn on_probe_state_reported(&mut self) {
        self.sham = self.sham.told();
    }

    /// A drive that is pressed against an obstacle stalls.
    fn crash_if(&mut self, crashed: bool) {
        if crashed {
            self.alarm(HARD_LIMIT);
        }
    }

    pub(super) fn alarm(&mut self, code: u16) {
        self.stop_here();
        self.mode = Mode::Alarm(code);
    }

    /// Stops the machine where it is and discards the remaining motion.
    pub(super) fn hold(&mut self, reason: u16) {
        if self.mode == Mode::Ready {
            self.stop_here();
            self.mode = Mode::Held(reason);
        }
    }

    pub(super) fn stop_here(&mut self) {
        self.lines.clear();
        if let Some(resident) = &mut self.resident {
            resident.stop();
        }
        let now = self.now;
        if let Some(active) = self.active.take() {
            self.with_world(|world| drop(active.hold(world, now)));
        }
    }
}
