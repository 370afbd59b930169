//! Exchange of lines: sends one line and waits for its answer, polls the status meanwhile, reports silence,
//! alarms and resets.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::fault::{not_ready, out_of_step, overridden, port_scan, refused, silent, state_of};
use super::message::{Message, Overrides, Status, alarm_meaning};
use super::watch::{FREE_MOVE_POLL, Patience, Watch};
use crate::controllers::{ControllerError, Halt, ReadinessFinding};
use link::{Link, LinkError, Received, Urgent};

/// Request for a report with all fields: CMD_STATUS_REPORT_ALL (grblHAL `grbl.h`).
const FULL_REPORT: &[u8] = &[0x87];

pub(super) struct Wire {
    link: Link,
    urgent: Urgent,
    halt: Halt,
    /// Whether a line was sent whose answer has not come.
    asked: bool,
    /// Whether no report has come since the last answer.
    unsure: bool,
    /// Overrides last reported since [`Wire::new`].
    pub(super) overrides: Option<Overrides>,
    /// Step whose positioning move is running, at rapid or at feed: the stylus should touch nothing.
    pub(super) free: Option<u32>,
    /// Whether a block is running: its feeds are valid at overrides of 100 % only.
    pub(super) in_block: bool,
    pub(super) patience: Patience,
}

impl Wire {
    /// Creates the wire on `link`, and the halt that holds the machine.
    pub(super) fn new(link: Link) -> (Self, Halt) {
        let urgent = link.urgent();
        let hold = urgent.clone();
        let halt = Halt::new(move || hold.send_and_close(b"!"));
        let patience = Patience::default();
        (
            Self {
                link,
                urgent,
                halt: halt.clone(),
                asked: false,
                unsure: false,
                overrides: None,
                free: None,
                in_block: false,
                patience,
            },
            halt,
        )
    }

    pub(super) fn is_halted(&self) -> bool {
        self.halt.is_halted()
    }

    /// Holds the machine after a fault, whatever it is executing and whatever is still in transit.
    pub(super) fn hold(&self) {
        self.urgent.send_and_close(b"!");
    }

    /// Sends `line` and waits for its `ok`; returns the messages received before the `ok`.
    ///
    /// # Errors
    /// A refusal, an alarm, a reset, silence, a surplus answer; `Halted` once a halt was requested.
    pub(super) async fn ask(&mut self, line: &str) -> Result<Vec<Message>, ControllerError> {
        self.ask_within(line, Duration::ZERO).await
    }

    /// As `ask`, for a line during which the control is at rest for up to `still`.
    pub(super) async fn ask_within(
        &mut self,
        line: &str,
        still: Duration,
    ) -> Result<Vec<Message>, ControllerError> {
        self.process_unsolicited().await?;
        if self.halt.is_halted() {
            // Lines accepted before the halt may still move the machine.
            return Err(self.halted().await);
        }
        self.require_planned_speed()?;
        self.link.send_line(line)?;
        self.asked = true;
        let mut said = Vec::new();
        let mut heard = Instant::now();
        let mut watch = Watch::default();
        let mut request_at = Instant::now() + self.poll();
        loop {
            match self.next(request_at).await? {
                Some(Message::Ok) => {
                    (self.asked, self.unsure) = (false, true);
                    return Ok(said);
                }
                Some(Message::Error(code)) => {
                    self.asked = false;
                    return Err(refused(line, code));
                }
                Some(Message::Status(status)) => {
                    heard = Instant::now();
                    if !self.halt.is_halted() {
                        self.check(&status).await?;
                        watch.look(&status, &self.patience, still, line)?;
                    }
                }
                Some(Message::Other(_)) => {}
                Some(other) => said.push(self.unless_it_ends_the_job(other).await?),
                None => {
                    self.urgent.send(b"?");
                    request_at = Instant::now() + self.poll();
                }
            }
            if self.halt.is_halted() {
                return Err(self.halted().await);
            }
            if heard.elapsed() > self.patience.answer {
                return Err(silent(line, self.patience.answer));
            }
        }
    }

    fn poll(&self) -> Duration {
        match self.free {
            Some(_) => self.patience.poll.min(FREE_MOVE_POLL),
            None => self.patience.poll,
        }
    }

    /// During a block: holds the machine if the last reported overrides are not 100 %. A touch at another
    /// feed has another latch delay and overtravel.
    fn require_planned_speed(&self) -> Result<(), ControllerError> {
        let overrides = self.overrides.filter(|_| self.in_block);
        let Some(ReadinessFinding { what, .. }) = overrides.and_then(overridden) else {
            return Ok(());
        };
        self.hold();
        let remedy = "set both overrides to 100 % at the control; it is held: look at the machine, reset it, \
                      home it";
        Err(ControllerError::NotReady { state: what, remedy: remedy.to_owned() })
    }

    /// Reads the control's status now; requests it again if a byte is lost.
    pub(super) async fn status(&mut self) -> Result<Status, ControllerError> {
        self.report(b"?", |_| true).await
    }

    /// Reads the report with all its fields, or another report if no full one comes. The answer to an
    /// earlier request may come first. A control that does not support the request does not answer.
    pub(super) async fn full_status(&mut self) -> Result<Status, ControllerError> {
        self.report(FULL_REPORT, |status| status.is_full).await
    }

    async fn report(
        &mut self,
        question: &'static [u8],
        is_answer: fn(&Status) -> bool,
    ) -> Result<Status, ControllerError> {
        let mut other = None;
        let deadline = Instant::now() + self.patience.answer;
        while Instant::now() < deadline {
            self.urgent.send(question);
            let again = deadline.min(Instant::now() + self.poll());
            while let Some(message) = self.next(again).await? {
                match self.unless_it_ends_the_job(message).await? {
                    Message::Status(status) => {
                        self.unsure = false;
                        if is_answer(&status) {
                            return Ok(status);
                        }
                        other = Some(status);
                    }
                    Message::Other(_) => {}
                    // A line may be outstanding when a halt comes.
                    Message::Ok | Message::Error(_) if self.asked => self.asked = false,
                    _ if self.asked => {}
                    answer => return Err(out_of_step(&answer)),
                }
            }
        }
        let name = if question == b"?" { "?" } else { "0x87" };
        other.ok_or_else(|| silent(name, self.patience.answer))
    }

    /// Waits until the machine is at rest: two idle reports in a row. The first may be older than the start
    /// of a motion that was just acknowledged.
    pub(super) async fn idle(&mut self) -> Result<Status, ControllerError> {
        let mut seen = 0;
        // No pause before the second request: even a control whose moves take no time may have accepted
        // the line without having executed it.
        let mut pause = Duration::ZERO;
        let mut watch = Watch::default();
        loop {
            let status = self.status().await?;
            if self.halt.is_halted() {
                return Err(self.halted().await);
            }
            self.check(&status).await?;
            if status.state == "Idle" {
                if seen > 0 {
                    return Ok(status);
                }
                seen += 1;
                continue;
            }
            watch.look(&status, &self.patience, Duration::ZERO, "?")?;
            seen = 0;
            if !pause.is_zero() {
                sleep(pause).await;
            }
            // Every move ends here: a long pause would cost more than the request.
            pause = (pause * 2).max(Duration::from_millis(1)).min(self.patience.poll / 10);
        }
    }

    /// Returns an error for a state that the run has not commanded.
    async fn check(&mut self, status: &Status) -> Result<(), ControllerError> {
        match status.state.as_str() {
            "Hold" | "Door" | "Tool" => Err(ControllerError::HeldThere { state: state_of(status) }),
            "Alarm" | "Sleep" => {
                // The number of the alarm may follow, or may be lost.
                let deadline = Instant::now() + self.patience.aftermath;
                while let Some(message) = self.next(deadline).await? {
                    self.unless_it_ends_the_job(message).await?;
                }
                Err(not_ready(status))
            }
            _ => match self.free.filter(|_| status.probe_closed) {
                Some(step) => {
                    // The machine may still be moving, and does not stop by itself.
                    self.hold();
                    Err(ControllerError::UnexpectedContact { step })
                }
                None => self.require_planned_speed(),
            },
        }
    }

    /// Returns an error for an alarm or a reset.
    async fn unless_it_ends_the_job(
        &mut self,
        message: Message,
    ) -> Result<Message, ControllerError> {
        match message {
            Message::Alarm(code) => Err(self.aftermath(code).await?),
            Message::Banner(banner) => Err(ControllerError::Reset { banner }),
            other => Ok(other),
        }
    }

    /// Begins the exchange: terminates a partial line in the control's buffer, and identifies the device. Waits
    /// for the answer to the blank line too: a late one would be taken for the answer to the next line.
    pub(super) async fn wake(&mut self) -> Result<Status, ControllerError> {
        self.link.send(b"\n")?;
        self.urgent.send(b"?");
        let deadline = Instant::now() + 2 * self.patience.answer;
        let (mut noise, mut foreign) = (false, None);
        let (mut status, mut answered) = (None, false);
        while Instant::now() < deadline && !(answered && status.is_some()) {
            match self.link.recv_deadline(Instant::now() + self.patience.aftermath).await? {
                Some(Received::Noise { .. }) => noise = true,
                Some(Received::Line(line)) => match Message::parse(&line) {
                    Message::Status(seen) => status = Some(seen),
                    Message::Ok | Message::Error(_) => answered = true,
                    Message::Other(text) if !text.is_empty() => {
                        foreign.get_or_insert(text);
                    }
                    _ => {}
                },
                None => self.urgent.send(b"?"),
            }
        }
        let Some(status) = status else {
            return Err(port_scan(noise, foreign, 2 * self.patience.answer));
        };
        self.quiet().await?;
        Ok(status)
    }

    /// Waits until no more old answers come.
    async fn quiet(&mut self) -> Result<(), LinkError> {
        let deadline = Instant::now() + self.patience.answer;
        while Instant::now() < deadline {
            if self.link.recv_deadline(Instant::now() + self.patience.poll / 2).await?.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// Processes messages that came without a request. A reset or an alarm ends the job; so does a surplus
    /// answer, which could be taken for the answer to the next line. The requested status report comes
    /// after a surplus answer.
    async fn process_unsolicited(&mut self) -> Result<(), ControllerError> {
        if self.unsure && !self.halt.is_halted() {
            let status = self.status().await?;
            self.unless_halted(&status).await?;
        }
        while let Some(received) = self.link.received()? {
            let message = understood(received);
            self.note(Some(&message));
            match self.unless_it_ends_the_job(message).await? {
                Message::Status(status) => self.unless_halted(&status).await?,
                Message::Other(_) => {}
                other => return Err(out_of_step(&other)),
            }
        }
        Ok(())
    }

    /// As `check`, but after a halt a reported hold is the driver's own.
    async fn unless_halted(&mut self, status: &Status) -> Result<(), ControllerError> {
        if self.halt.is_halted() { Ok(()) } else { self.check(status).await }
    }

    async fn next(&mut self, deadline: Instant) -> Result<Option<Message>, LinkError> {
        let message = self.link.recv_deadline(deadline).await?.map(understood);
        self.note(message.as_ref());
        Ok(message)
    }

    /// Stores reported overrides. A report carries them rarely: after a change, and from time to time.
    fn note(&mut self, message: Option<&Message>) {
        if let Some(Message::Status(Status { overrides: Some(now), .. })) = message {
            self.overrides = Some(*now);
        }
    }

    /// Waits for what follows an alarm: the line's answer, or a banner if the control was reset.
    async fn aftermath(&mut self, code: u32) -> Result<ControllerError, LinkError> {
        let deadline = Instant::now() + self.patience.aftermath;
        loop {
            match self.next(deadline).await? {
                Some(Message::Banner(banner)) => return Ok(ControllerError::Reset { banner }),
                Some(Message::Ok | Message::Error(_)) | None => {
                    let meaning = alarm_meaning(code).to_owned();
                    return Ok(ControllerError::Alarm { code, meaning });
                }
                Some(_) => {}
            }
        }
    }

    /// Waits, after a hold was sent, until the machine is at rest. The hold may be lost: it is sent again
    /// until a report shows it; a surplus hold changes nothing.
    async fn halted(&mut self) -> ControllerError {
        let patience = 2 * self.patience.answer;
        let deadline = Instant::now() + patience;
        // One idle report may be older than the start of a motion.
        let mut idle = false;
        while Instant::now() < deadline {
            let status = match self.status().await {
                Ok(status) => status,
                Err(error) => return error,
            };
            let was_idle = std::mem::replace(&mut idle, status.state == "Idle");
            if stands(&status) && (was_idle || !idle) {
                return ControllerError::Halted;
            }
            if !matches!(status.state.as_str(), "Hold" | "Door") {
                self.hold();
            }
            sleep(self.patience.poll / 4).await;
        }
        ControllerError::NotHeld { seconds: patience.as_secs_f64() }
    }
}

fn understood(received: Received) -> Message {
    match received {
        Received::Line(line) => Message::parse(&line),
        // If noise has replaced an answer, the silence that follows is reported.
        Received::Noise { bytes } => Message::Other(format!("{bytes} bytes")),
    }
}

fn stands(status: &Status) -> bool {
    match status.state.as_str() {
        "Hold" => status.substate.as_deref() == Some("0"),
        "Door" => matches!(status.substate.as_deref(), Some("0" | "1")),
        "Run" | "Jog" | "Home" => false,
        _ => true,
    }
}
