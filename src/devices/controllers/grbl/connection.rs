//! Exchange of lines with a Grbl control: sends one line and waits for its answer, polls the status meanwhile,
//! reports silence, alarms and resets.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::fault::{
    foreign_device_error, not_ready_error, override_finding, refusal_error, state_text, unexpected_reply_error,
};
use super::message::{GrblMessage, GrblStatus, Overrides, alarm_meaning};
use super::timeouts::{GrblTimeouts, MAX_POSITIONING_POLL_INTERVAL};
use crate::controllers::stall_detector::StallDetector;
use crate::controllers::{ControllerError, HaltHandle, ReadinessFinding};
use link::{LineEvent, LineLink, LinkError, UrgentSender};

/// Request for a report with all fields: CMD_STATUS_REPORT_ALL (grblHAL `grbl.h`).
const FULL_REPORT_REQUEST: &[u8] = &[0x87];

/// Link to a Grbl control: sends one line at a time, and requests the status until the line is answered.
pub(super) struct GrblConnection {
    link: LineLink,
    urgent_sender: UrgentSender,
    halt: HaltHandle,
    /// Whether the answer to the last line has not come yet.
    is_reply_pending: bool,
    /// Whether no status report has come since the last answer to a line.
    is_status_due_after_reply: bool,
    /// Overrides last reported since [`GrblConnection::new`].
    pub(super) last_overrides: Option<Overrides>,
    /// Step whose positioning move is running, at rapid or at feed: the stylus should touch nothing.
    pub(super) positioning_step: Option<u32>,
    /// Whether a block is running: its feeds are valid at overrides of 100 % only.
    pub(super) is_block_running: bool,
    pub(super) timeouts: GrblTimeouts,
}

impl GrblConnection {
    /// Creates the connection on `link`, and the halt handle that holds the machine.
    pub(super) fn new(link: LineLink) -> (Self, HaltHandle) {
        let urgent = link.urgent_sender();
        let hold = urgent.clone();
        let halt = HaltHandle::new(move || hold.send_and_drop_non_urgent(b"!"));
        let connection = Self {
            link,
            urgent_sender: urgent,
            halt: halt.clone(),
            is_reply_pending: false,
            is_status_due_after_reply: false,
            last_overrides: None,
            positioning_step: None,
            is_block_running: false,
            timeouts: GrblTimeouts::default(),
        };
        (connection, halt)
    }

    pub(super) fn is_halt_requested(&self) -> bool {
        self.halt.is_halt_requested()
    }

    /// Holds the machine after a fault, whatever it is executing and whatever is still in transit.
    pub(super) fn send_hold(&self) {
        self.urgent_sender.send_and_drop_non_urgent(b"!");
    }

    /// Sends `line` and waits for its `ok`; returns the messages received before the `ok`.
    ///
    /// # Errors
    /// A refusal, an alarm, a reset, silence, a surplus answer; `Halted` once a halt was requested.
    pub(super) async fn send_line(&mut self, line: &str) -> Result<Vec<GrblMessage>, ControllerError> {
        self.send_line_with_standstill(line, Duration::ZERO).await
    }

    /// As `send_line`, for a line during which the control is at rest for up to `standstill_time`.
    pub(super) async fn send_line_with_standstill(
        &mut self,
        line: &str,
        standstill_time: Duration,
    ) -> Result<Vec<GrblMessage>, ControllerError> {
        self.process_unsolicited_messages().await?;
        if self.halt.is_halt_requested() {
            // Lines accepted before the halt may still move the machine.
            return Err(self.resend_hold_until_at_rest().await);
        }
        self.hold_unless_overrides_are_100_percent()?;
        self.link.send_line(line)?;
        self.is_reply_pending = true;
        let mut messages = Vec::new();
        let mut last_report = Instant::now();
        let mut stall_detector = StallDetector::new();
        let mut request_at = Instant::now() + self.poll_interval();
        loop {
            match self.receive_message(request_at).await? {
                Some(GrblMessage::Ok) => {
                    (self.is_reply_pending, self.is_status_due_after_reply) = (false, true);
                    return Ok(messages);
                }
                Some(GrblMessage::Error(code)) => {
                    self.is_reply_pending = false;
                    return Err(refusal_error(line, code));
                }
                Some(GrblMessage::Status(status)) => {
                    last_report = Instant::now();
                    if !self.halt.is_halt_requested() {
                        self.fail_on_uncommanded_state(&status).await?;
                        let limit = self.timeouts.max_unchanged_time(&status);
                        let state = (status.state, status.machine_position);
                        stall_detector.check_not_stalled(state, limit, standstill_time, line)?;
                    }
                }
                Some(GrblMessage::Unknown(_)) => {}
                Some(other) => messages.push(self.fail_on_alarm_or_reset(other).await?),
                None => {
                    self.urgent_sender.send(b"?");
                    request_at = Instant::now() + self.poll_interval();
                }
            }
            if self.halt.is_halt_requested() {
                return Err(self.resend_hold_until_at_rest().await);
            }
            if last_report.elapsed() > self.timeouts.reply_timeout {
                return Err(ControllerError::no_answer(line, self.timeouts.reply_timeout));
            }
        }
    }

    fn poll_interval(&self) -> Duration {
        match self.positioning_step {
            Some(_) => self.timeouts.poll_interval.min(MAX_POSITIONING_POLL_INTERVAL),
            None => self.timeouts.poll_interval,
        }
    }

    /// During a block: holds the machine if the last reported overrides are not 100 %. A touch at another
    /// feed has another latch delay and overtravel.
    fn hold_unless_overrides_are_100_percent(&self) -> Result<(), ControllerError> {
        let overrides = self.last_overrides.filter(|_| self.is_block_running);
        let Some(ReadinessFinding { description, .. }) = overrides.and_then(override_finding) else { return Ok(()) };
        self.send_hold();
        let remedy = "the machine was held: inspect it, reset the control, home the machine, and set both overrides \
                      to 100 %";
        Err(ControllerError::not_ready(description, remedy))
    }

    /// Reads the control's status now; requests it again if a byte is lost.
    pub(super) async fn read_status(&mut self) -> Result<GrblStatus, ControllerError> {
        self.query_report(b"?", |_| true).await
    }

    /// Reads the report with all its fields, or another report if no full one comes. The answer to an
    /// earlier request may come first. A control that does not support the request does not answer.
    pub(super) async fn read_full_status(&mut self) -> Result<GrblStatus, ControllerError> {
        self.query_report(FULL_REPORT_REQUEST, |status| status.has_all_fields).await
    }

    /// Repeats the real-time `request` until a report satisfies `is_reply`; at the timeout returns the last other
    /// report, or an error without any report.
    async fn query_report(
        &mut self,
        request: &'static [u8],
        is_reply: fn(&GrblStatus) -> bool,
    ) -> Result<GrblStatus, ControllerError> {
        let mut other = None;
        let deadline = Instant::now() + self.timeouts.reply_timeout;
        while Instant::now() < deadline {
            self.urgent_sender.send(request);
            let again = deadline.min(Instant::now() + self.poll_interval());
            while let Some(message) = self.receive_message(again).await? {
                match self.fail_on_alarm_or_reset(message).await? {
                    GrblMessage::Status(status) => {
                        self.is_status_due_after_reply = false;
                        if is_reply(&status) {
                            return Ok(status);
                        }
                        other = Some(status);
                    }
                    GrblMessage::Unknown(_) => {}
                    // A line may be outstanding when a halt comes.
                    GrblMessage::Ok | GrblMessage::Error(_) if self.is_reply_pending => self.is_reply_pending = false,
                    _ if self.is_reply_pending => {}
                    answer => return Err(unexpected_reply_error(&answer)),
                }
            }
        }
        let name = if request == b"?" { "?" } else { "0x87" };
        other.ok_or_else(|| ControllerError::no_answer(name, self.timeouts.reply_timeout))
    }

    /// Waits until the machine is at rest: two idle reports in a row. The first may be older than the start
    /// of a motion that was just acknowledged.
    pub(super) async fn wait_idle(&mut self) -> Result<GrblStatus, ControllerError> {
        let mut idle_reports = 0;
        // No pause before the second request, which is always needed: a control may have accepted the line without
        // having executed it.
        let mut pause = Duration::ZERO;
        let mut stall_detector = StallDetector::new();
        loop {
            let status = self.read_status().await?;
            if self.halt.is_halt_requested() {
                return Err(self.resend_hold_until_at_rest().await);
            }
            self.fail_on_uncommanded_state(&status).await?;
            if status.state == "Idle" {
                if idle_reports > 0 {
                    return Ok(status);
                }
                idle_reports += 1;
                continue;
            }
            let limit = self.timeouts.max_unchanged_time(&status);
            stall_detector.check_not_stalled((status.state, status.machine_position), limit, Duration::ZERO, "?")?;
            idle_reports = 0;
            if !pause.is_zero() {
                sleep(pause).await;
            }
            // This wait ends every move: a long pause would cost more time than the request.
            pause = (pause * 2).max(Duration::from_millis(1)).min(self.timeouts.poll_interval / 10);
        }
    }

    /// Returns an error for a hold, a door, a tool change, an alarm or a sleep; for a contact during a positioning
    /// move; or, during a block, for overrides other than 100 %. The last two hold the machine.
    async fn fail_on_uncommanded_state(&mut self, status: &GrblStatus) -> Result<(), ControllerError> {
        match status.state.as_str() {
            "Hold" | "Door" | "Tool" => Err(ControllerError::HeldAtControl { state: state_text(status) }),
            "Alarm" | "Sleep" => {
                // The number of the alarm may follow, or may be lost.
                let deadline = Instant::now() + self.timeouts.follow_up_timeout;
                while let Some(message) = self.receive_message(deadline).await? {
                    self.fail_on_alarm_or_reset(message).await?;
                }
                Err(not_ready_error(status))
            }
            _ => match self.positioning_step.filter(|_| status.is_probe_closed) {
                Some(step) => {
                    // The machine may still be moving, and does not stop by itself.
                    self.send_hold();
                    Err(ControllerError::UnexpectedContact { step })
                }
                None => self.hold_unless_overrides_are_100_percent(),
            },
        }
    }

    /// Returns an error for an alarm or a reset, otherwise the message.
    async fn fail_on_alarm_or_reset(&mut self, message: GrblMessage) -> Result<GrblMessage, ControllerError> {
        match message {
            GrblMessage::Alarm(code) => Err(self.read_alarm_error(code).await?),
            GrblMessage::Banner(banner) => Err(ControllerError::ControlReset { banner }),
            other => Ok(other),
        }
    }

    /// Begins the exchange and returns the status: terminates a partial line in the control's buffer, and identifies
    /// the device. Waits for the answer to the blank line too: a late answer would be taken for the answer to the
    /// next line.
    pub(super) async fn synchronize_and_read_status(&mut self) -> Result<GrblStatus, ControllerError> {
        self.link.send(b"\n")?;
        self.urgent_sender.send(b"?");
        let deadline = Instant::now() + 2 * self.timeouts.reply_timeout;
        let (mut noise, mut foreign) = (false, None);
        let (mut status, mut answered) = (None, false);
        while Instant::now() < deadline && !(answered && status.is_some()) {
            match self.link.recv_deadline(Instant::now() + self.timeouts.follow_up_timeout).await? {
                Some(LineEvent::Noise { .. }) => noise = true,
                Some(LineEvent::Line(line)) => match GrblMessage::parse(&line) {
                    GrblMessage::Status(report) => status = Some(report),
                    GrblMessage::Ok | GrblMessage::Error(_) => answered = true,
                    GrblMessage::Unknown(text) if !text.is_empty() => {
                        foreign.get_or_insert(text);
                    }
                    _ => {}
                },
                None => self.urgent_sender.send(b"?"),
            }
        }
        let Some(status) = status else {
            return Err(foreign_device_error(noise, foreign, 2 * self.timeouts.reply_timeout));
        };
        self.drain_old_replies().await?;
        Ok(status)
    }

    /// Waits until no more old answers come.
    async fn drain_old_replies(&mut self) -> Result<(), LinkError> {
        let deadline = Instant::now() + self.timeouts.reply_timeout;
        while Instant::now() < deadline {
            if self.link.recv_deadline(Instant::now() + self.timeouts.poll_interval / 2).await?.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// Processes messages that came without a request. A reset or an alarm ends the job; so does a surplus answer,
    /// which could be taken for the answer to the next line. The status is requested first, because its report comes
    /// after any surplus answer.
    async fn process_unsolicited_messages(&mut self) -> Result<(), ControllerError> {
        if self.is_status_due_after_reply && !self.halt.is_halt_requested() {
            let status = self.read_status().await?;
            self.fail_on_uncommanded_state_unless_halted(&status).await?;
        }
        while let Some(received) = self.link.try_recv()? {
            let message = parse_received(received);
            self.store_overrides(Some(&message));
            match self.fail_on_alarm_or_reset(message).await? {
                GrblMessage::Status(status) => self.fail_on_uncommanded_state_unless_halted(&status).await?,
                GrblMessage::Unknown(_) => {}
                other => return Err(unexpected_reply_error(&other)),
            }
        }
        Ok(())
    }

    /// As `fail_on_uncommanded_state`, but without effect after a halt: a reported hold is then the driver's own.
    async fn fail_on_uncommanded_state_unless_halted(&mut self, status: &GrblStatus) -> Result<(), ControllerError> {
        if self.halt.is_halt_requested() { Ok(()) } else { self.fail_on_uncommanded_state(status).await }
    }

    /// The next message, or `None` at the deadline; stores reported overrides.
    async fn receive_message(&mut self, deadline: Instant) -> Result<Option<GrblMessage>, LinkError> {
        let message = self.link.recv_deadline(deadline).await?.map(parse_received);
        self.store_overrides(message.as_ref());
        Ok(message)
    }

    /// Stores reported overrides. Most reports omit them: they come after a change, and from time to time.
    fn store_overrides(&mut self, message: Option<&GrblMessage>) {
        if let Some(GrblMessage::Status(GrblStatus { overrides: Some(now), .. })) = message {
            self.last_overrides = Some(*now);
        }
    }

    /// Reads the message that follows an alarm; returns `ControlReset` if it is a banner, otherwise `Alarm`.
    async fn read_alarm_error(&mut self, code: u32) -> Result<ControllerError, LinkError> {
        let deadline = Instant::now() + self.timeouts.follow_up_timeout;
        loop {
            match self.receive_message(deadline).await? {
                Some(GrblMessage::Banner(banner)) => return Ok(ControllerError::ControlReset { banner }),
                Some(GrblMessage::Ok | GrblMessage::Error(_)) | None => {
                    let meaning = alarm_meaning(code).to_owned();
                    return Ok(ControllerError::Alarm { code, meaning });
                }
                Some(_) => {}
            }
        }
    }

    /// Waits, after a hold was sent, until the machine is at rest, and returns `Halted`, or `HoldFailed` if it still
    /// moves. The hold may be lost: it is sent again until a report shows it; a surplus hold changes nothing.
    async fn resend_hold_until_at_rest(&mut self) -> ControllerError {
        let timeouts = 2 * self.timeouts.reply_timeout;
        let deadline = Instant::now() + timeouts;
        // One idle report may be older than the start of a motion.
        let mut idle = false;
        while Instant::now() < deadline {
            let status = match self.read_status().await {
                Ok(status) => status,
                Err(error) => return error,
            };
            let was_idle = std::mem::replace(&mut idle, status.state == "Idle");
            if status.is_at_rest() && (was_idle || !idle) {
                return ControllerError::Halted;
            }
            if !matches!(status.state.as_str(), "Hold" | "Door") {
                self.send_hold();
            }
            sleep(self.timeouts.poll_interval / 4).await;
        }
        ControllerError::HoldFailed { seconds: timeouts.as_secs_f64() }
    }
}

fn parse_received(received: LineEvent) -> GrblMessage {
    match received {
        LineEvent::Line(line) => GrblMessage::parse(&line),
        // If noise has replaced an answer, the silence that follows is reported.
        LineEvent::Noise { bytes } => GrblMessage::Unknown(format!("{bytes} bytes")),
    }
}
