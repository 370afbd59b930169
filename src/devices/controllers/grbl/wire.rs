//! The conversation: one line, its answer; status while waiting; silence, alarms and resets told.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::fault::{not_ready, out_of_step, overridden, refused, silent, state_of, stranger};
use super::message::{Message, Overrides, Status, alarm_meaning};
use super::watch::{FREE_MOVE_POLL, Patience, Watch};
use crate::controllers::{ControllerError, Halt, Remark};
use link::{Link, LinkError, Received, Urgent};

/// CMD_STATUS_REPORT_ALL (grblHAL `grbl.h`).
const FULL_REPORT: &[u8] = &[0x87];

pub(super) struct Wire {
    link: Link,
    urgent: Urgent,
    halt: Halt,
    /// A line was sent whose answer has not come.
    asked: bool,
    /// No report has come since the last answer.
    unsure: bool,
    /// As last reported since [`Wire::new`].
    pub(super) overrides: Option<Overrides>,
    /// The step whose positioning move, at rapid or at feed, is under way: the stylus should meet nothing.
    pub(super) free: Option<u32>,
    /// A block is under way: its speeds are valid at overrides of 100 % only.
    pub(super) in_block: bool,
    pub(super) patience: Patience,
}

impl Wire {
    /// The wire over `link`, and the halt that holds the machine behind it.
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

    /// Hold the machine after a fault: whatever it is doing, and whatever is still on its way.
    pub(super) fn hold(&self) {
        self.urgent.send_and_close(b"!");
    }

    /// Send `line` and wait for its `ok`; what was said before the `ok` is the result.
    ///
    /// # Errors
    /// A refusal, an alarm, a reset, silence, an answer too many; `Halted` once a halt was asked for.
    pub(super) async fn ask(&mut self, line: &str) -> Result<Vec<Message>, ControllerError> {
        self.ask_within(line, Duration::ZERO).await
    }

    /// As `ask`, for a line during which the control stands for up to `still`.
    pub(super) async fn ask_within(
        &mut self,
        line: &str,
        still: Duration,
    ) -> Result<Vec<Message>, ControllerError> {
        self.catch_up().await?;
        if self.halt.is_halted() {
            // What was taken before may still move it.
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

    /// During a block: the machine is held if the last reported overrides are not 100 %. A touch at
    /// another feed has another latch delay and overtravel.
    fn require_planned_speed(&self) -> Result<(), ControllerError> {
        let overrides = self.overrides.filter(|_| self.in_block);
        let Some(Remark { what, .. }) = overrides.and_then(overridden) else { return Ok(()) };
        self.hold();
        let remedy = "set both overrides to 100 % at the control; it is held: look at the machine, reset it, \
                      home it";
        Err(ControllerError::NotReady { state: what, remedy: remedy.to_owned() })
    }

    /// The control's status, asked for now; asked again if a byte gets lost.
    pub(super) async fn status(&mut self) -> Result<Status, ControllerError> {
        self.report(b"?", |_| true).await
    }

    /// The report with all its fields; one that does not say so if no other comes. A report that was
    /// asked for before may come first. A control that does not know the question is silent.
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
                    // A line may be under way when a halt comes.
                    Message::Ok | Message::Error(_) if self.asked => self.asked = false,
                    _ if self.asked => {}
                    answer => return Err(out_of_step(&answer)),
                }
            }
        }
        let name = if question == b"?" { "?" } else { "0x87" };
        other.ok_or_else(|| silent(name, self.patience.answer))
    }

    /// Wait until the machine stands still. Two reports in a row: the first may be older than the
    /// start of a motion that was just acknowledged.
    pub(super) async fn idle(&mut self) -> Result<Status, ControllerError> {
        let mut seen = 0;
        // Asked again at once: a control that moves in no time has taken the line, but not done it.
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
            // Every move ends here: a long pause would cost more than the question.
            pause = (pause * 2).max(Duration::from_millis(1)).min(self.patience.poll / 10);
        }
    }

    /// A state that the run did not ask for ends it.
    async fn check(&mut self, status: &Status) -> Result<(), ControllerError> {
        match status.state.as_str() {
            "Hold" | "Door" | "Tool" => Err(ControllerError::HeldThere { state: state_of(status) }),
            "Alarm" | "Sleep" => {
                // Which alarm it is may follow, or have got lost.
                let deadline = Instant::now() + self.patience.aftermath;
                while let Some(message) = self.next(deadline).await? {
                    self.unless_it_ends_the_job(message).await?;
                }
                Err(not_ready(status))
            }
            _ => match self.free.filter(|_| status.probe_closed) {
                Some(step) => {
                    // It may still be moving, and does not stop by itself.
                    self.hold();
                    Err(ControllerError::UnexpectedContact { step })
                }
                None => self.require_planned_speed(),
            },
        }
    }

    /// An alarm or a reset does.
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

    /// The first word: end whatever half line stands in the control's buffer, and find out who is
    /// there. The blank line's answer is waited for too: come late, it would be the next line's.
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
            return Err(stranger(noise, foreign, 2 * self.patience.answer));
        };
        self.quiet().await?;
        Ok(status)
    }

    /// Let old answers run dry.
    async fn quiet(&mut self) -> Result<(), LinkError> {
        let deadline = Instant::now() + self.patience.answer;
        while Instant::now() < deadline {
            if self.link.recv_deadline(Instant::now() + self.patience.poll / 2).await?.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// What was said while nobody asked: a reset or an alarm ends the job, and so does an answer
    /// too many, which could be taken for the next line's. A report that is asked for comes after it.
    async fn catch_up(&mut self) -> Result<(), ControllerError> {
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

    /// As `check`; after a halt the hold that it shows is ours.
    async fn unless_halted(&mut self, status: &Status) -> Result<(), ControllerError> {
        if self.halt.is_halted() { Ok(()) } else { self.check(status).await }
    }

    async fn next(&mut self, deadline: Instant) -> Result<Option<Message>, LinkError> {
        let message = self.link.recv_deadline(deadline).await?.map(understood);
        self.note(message.as_ref());
        Ok(message)
    }

    /// A report carries overrides rarely: when they have changed, and now and then.
    fn note(&mut self, message: Option<&Message>) {
        if let Some(Message::Status(Status { overrides: Some(now), .. })) = message {
            self.overrides = Some(*now);
        }
    }

    /// An alarm is followed by the line's answer, or by a banner if the control was reset.
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

    /// The hold is on its way; see the machine stand before saying so. The wire may have lost it: it is
    /// sent again until a report shows it, one too many changes nothing.
    async fn halted(&mut self) -> ControllerError {
        let patience = 2 * self.patience.answer;
        let deadline = Instant::now() + patience;
        // One report of it may be older than the start of a motion.
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
        // If noise swallowed an answer, the silence that follows is told.
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
