//! Execution of lines by the simulated control: one after the other, at once or in real time.

use std::time::Duration;

use super::chunk::ERROR_BAD_TEXT;
use super::layout::position_steps;
use super::{
    ALARM_HARD_LIMIT, ALARM_NO_CONTACT, ALARM_PROBE_CLOSED, ALARM_SOFT_LIMIT, ControlEvent, FaultKind, Firmware,
    HEARTBEAT_TIMEOUT, HOLD_REASON_HEARTBEAT_LOST, OperatingState,
};
use crate::LatchedContact;
use crate::interpreter::{Job, JobResult, LineAction};

impl Firmware {
    /// Advances the control to the time `now`: ends and starts jobs that are due, and holds if the heartbeat is lost
    /// during a job.
    pub(super) fn advance(&mut self, now: Duration) {
        loop {
            if let Some(end_time) = self.executor.active_job.as_ref().map(|active| active.end_time) {
                let heartbeat_deadline = self.last_heartbeat_change_time.unwrap_or_default() + HEARTBEAT_TIMEOUT;
                if heartbeat_deadline < end_time && heartbeat_deadline <= now {
                    self.time_since_start = heartbeat_deadline;
                    self.stop_and_hold(HOLD_REASON_HEARTBEAT_LOST);
                } else if end_time <= now {
                    self.time_since_start = end_time;
                    self.finish_active_job();
                } else {
                    break;
                }
            } else if self.operating_state != OperatingState::Ready || self.frozen_status_block.is_some() {
                break;
            } else if let Some(line) = self.unstarted_lines.pop_front() {
                self.execute_line(&line);
            } else if !self.start_current_row() {
                break;
            }
        }
        self.time_since_start = now;
        let done = self.operating_state == OperatingState::Ready && !self.is_running() && self.error_code == 0;
        if done && self.frozen_status_block.is_none() {
            self.executed_sequence = self.checked_sequence;
        }
    }

    /// Starts the job of a line; an error in the line discards the rest of the chunk.
    fn execute_line(&mut self, line: &str) {
        let here = self.executor.displayed_position();
        match self.options.interpreter.interpret_line(line, &here) {
            Ok(LineAction::NoMotion) => {}
            Ok(LineAction::OutOfTravel) => self.raise_alarm(ALARM_SOFT_LIMIT),
            Ok(LineAction::Execute(job)) => self.start_job(job),
            Err(_) => {
                self.error_code = ERROR_BAD_TEXT;
                self.unstarted_lines.clear();
            }
        }
    }

    /// Starts the job. A probing move whose probe is closed already raises an alarm instead.
    pub(super) fn start_job(&mut self, job: Job) {
        if matches!(job, Job::Probe { .. }) && self.executor.is_probe_closed() {
            return self.raise_alarm(ALARM_PROBE_CLOSED);
        }
        if self.executor.start_job_and_check_brush(job, self.time_since_start) {
            self.record_event(ControlEvent::FaultOccurred(FaultKind::RapidContact));
        }
    }

    /// Ends the active job with its effects: latched contact, alarms, and the end of the table's row.
    fn finish_active_job(&mut self) {
        let Some((_, result)) = self.executor.finish_job() else { return };
        match result {
            JobResult::DwellOrOrientFinished => self.finish_row(None),
            JobResult::Moved { has_crashed } => {
                self.finish_row(None);
                self.alarm_if_crashed(has_crashed);
            }
            JobResult::Probed { contact, has_crashed, alarms_on_miss } => {
                let has_contact = contact.is_some();
                if contact.is_none() && alarms_on_miss {
                    self.raise_alarm(ALARM_NO_CONTACT);
                }
                if let Some(contact) = contact {
                    self.latch_contact(contact);
                }
                if self.executor.remove_obstacle() {
                    self.record_event(ControlEvent::FaultOccurred(FaultKind::ForeignBody));
                }
                self.finish_row(Some(has_contact));
                self.alarm_if_crashed(has_crashed);
            }
        }
    }

    /// Stores the contact in the latch registers, counts it and adds it to the event log.
    fn latch_contact(&mut self, contact: LatchedContact) {
        self.latch_count = self.latch_count.wrapping_add(1);
        self.contact_count += 1;
        self.latched_position = contact.latched_position;
        self.latch_time_s = contact.latch_time_s;
        self.record_event(ControlEvent::ContactLatched {
            latch: position_steps(&self.latched_position),
            t_s: contact.latch_time_s,
        });
    }

    /// A drive that is pressed against an obstacle stalls: raises a hard-limit alarm.
    fn alarm_if_crashed(&mut self, has_crashed: bool) {
        if has_crashed {
            self.raise_alarm(ALARM_HARD_LIMIT);
        }
    }

    /// Stops the machine where it is, discards the remaining motion and enters the alarm state.
    pub(super) fn raise_alarm(&mut self, code: u16) {
        self.stop_at_current_position();
        self.operating_state = OperatingState::AlarmWithCode(code);
    }

    /// Stops the machine where it is and discards the remaining motion; only if the control is ready.
    pub(super) fn stop_and_hold(&mut self, reason: u16) {
        if self.operating_state == OperatingState::Ready {
            self.stop_at_current_position();
            self.operating_state = OperatingState::Held(reason);
        }
    }

    /// Stops the machine where it is and discards the remaining lines, table and job; the operating state stays.
    pub(super) fn stop_at_current_position(&mut self) {
        self.unstarted_lines.clear();
        if let Some(resident) = &mut self.resident_program {
            resident.stop();
        }
        self.executor.hold_job(self.time_since_start);
    }
}
