//! Jobs of the simulated control: executed one after the other, at once or in real time.

use super::{ALARM_HARD_LIMIT, ALARM_NO_CONTACT, ALARM_PROBE_CLOSED, AlarmLock, FaultKind, Firmware};
use crate::LatchedContact;
use crate::interpreter::{Job, JobResult};
use machine::Position;

/// The result of a probing move.
#[derive(Debug, Clone, Default)]
pub(super) struct LastProbeResult {
    /// Latched position of the contact; without a contact, the displayed position at the end of the move.
    position: Position,
    has_contact: bool,
    /// Simulated time of the latch, s; `None`: no contact.
    contact_time_s: Option<f64>,
}

impl Firmware {
    /// Starts the next job of the queue. A probing move whose probe is closed already raises an alarm instead.
    pub(super) fn start_next_job(&mut self) {
        let Some(job) = self.job_queue.pop_front() else { return };
        if matches!(job, Job::Probe { .. }) && self.executor.is_probe_closed() {
            self.raise_alarm(ALARM_PROBE_CLOSED, AlarmLock::Unlockable);
            return self.send_ok();
        }
        if self.executor.start_job_and_check_brush(job, self.time_since_start) {
            self.record_fault(FaultKind::RapidContact);
        }
    }

    /// Ends the active job, and sends its result and the answer that waits for it.
    pub(super) fn finish_active_job(&mut self) {
        let Some((job, result)) = self.executor.finish_job() else { return };
        match result {
            JobResult::DwellOrOrientFinished => {}
            JobResult::Moved { has_crashed } => self.alarm_if_crashed(has_crashed),
            JobResult::Probed { contact, has_crashed, alarms_on_miss } => {
                self.report_probe_result(contact, alarms_on_miss);
                self.planned_position = self.executor.displayed_position();
                self.alarm_if_crashed(has_crashed);
            }
        }
        if job.is_acknowledged_at_end() {
            self.is_answer_pending = false;
            self.send_ok();
        }
    }

    /// Sends the result of a probing move, and an alarm before it if a miss must raise one; the alarm discards the
    /// queue.
    fn report_probe_result(&mut self, contact: Option<LatchedContact>, alarms_on_miss: bool) {
        if contact.is_none() && alarms_on_miss {
            self.send_line(&format!("ALARM:{ALARM_NO_CONTACT}"));
            self.job_queue.clear();
            self.alarm_lock = Some(AlarmLock::Unlockable);
        }
        let has_contact = contact.is_some();
        self.contact_count += u64::from(has_contact);
        if self.executor.remove_obstacle() {
            self.record_fault(FaultKind::ForeignBody);
        }
        let t_s = contact.as_ref().map(|contact| contact.latch_time_s);
        let position = contact.map_or_else(|| self.executor.displayed_position(), |contact| contact.latched_position);
        self.last_probe = Some(LastProbeResult { position, has_contact, contact_time_s: t_s });
        self.send_last_probe();
    }

    /// Reports the last probing move; zeros before the first one.
    pub(super) fn send_last_probe(&mut self) {
        let last = self.last_probe.clone().unwrap_or_default();
        self.send_line(&format!("[PRB:{}:{}]", self.format_axis_values(&last.position), u8::from(last.has_contact)));
        if let Some(t_s) = last.contact_time_s.filter(|_| self.options.has_time_stamps) {
            self.send_line(&format!("[TIME:{t_s}]"));
        }
    }

    /// A drive that is pressed against an obstacle stalls; the control reports a hard limit.
    fn alarm_if_crashed(&mut self, has_crashed: bool) {
        if has_crashed {
            self.raise_alarm(ALARM_HARD_LIMIT, AlarmLock::NeedsReset);
        }
    }

    /// `!`: stops the machine where it is and keeps the remaining motion for `~`; no effect during an alarm.
    pub(super) fn hold(&mut self) {
        if self.alarm_lock.is_some() {
            return;
        }
        self.is_held = true;
        if let Some(remaining_job) = self.executor.hold_job(self.time_since_start) {
            self.job_queue.push_front(remaining_job);
        }
    }
}
