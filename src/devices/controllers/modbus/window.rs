//! Exchange through the window: one line is accepted and executed; the status is polled meanwhile.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use super::fault::{ends_it, may_pass, out_of_step, refused, reset, silent};
use super::map::Map;
use super::patience::Patience;
use super::status::{State, Status};
use super::watch::{Heart, Watch};
use crate::controllers::{ControllerError, Halt};
use link::modbus::value::ValueError;
use link::modbus::{Line, Modbus, ModbusError, Settings, Urgent};

/// Interval of trued's own heartbeat while nothing else is written.
const BEAT: Duration = Duration::from_millis(500);

/// A chunk whose execution was started.
pub(super) struct Pending {
    name: String,
    pub(super) sequence: u16,
    still: Duration,
    begun: Instant,
    watch: Watch,
    /// Pause before the next request; `None`: there was no request yet.
    pause: Option<Duration>,
}

impl Pending {
    fn of(name: &str, sequence: u16, still: Duration) -> Self {
        let (begun, watch) = (Instant::now(), Watch::default());
        Self { name: name.to_owned(), sequence, still, begun, watch, pause: None }
    }

    /// Waits before the next request. The pause grows with each request, up to `most`. The second request
    /// follows at once: a line that takes no time, such as a modal word, is complete by then.
    async fn wait(&mut self, most: Duration) {
        let pause = self.pause.unwrap_or_default();
        if !pause.is_zero() {
            sleep(pause).await;
        }
        self.pause = Some(match self.pause {
            None => Duration::ZERO,
            Some(pause) => (pause * 2).max(Duration::from_millis(1)).min(most),
        });
    }
}

pub(super) struct Window {
    pub(super) link: Arc<Modbus>,
    pub(super) map: Map,
    hold: Urgent,
    halt: Halt,
    pub(super) beat: Arc<AtomicU16>,
    /// Task that writes the heartbeat; [`Window::living`] starts it.
    beating: OnceLock<JoinHandle<()>>,
    /// Sequence number of the last chunk that the control has accepted.
    pub(super) sequence: u16,
    /// Whether that chunk was sent by this driver. The outcome of another one, perhaps held or refused,
    /// does not matter.
    pub(super) ours: bool,
    /// Number of the last result that was read from a resident program.
    pub(super) taken: Option<u16>,
    /// Step whose positioning move is running, at rapid or at feed: the stylus should touch nothing.
    pub(super) free: Option<u32>,
    pub(super) patience: Patience,
    heart: Heart,
}

impl Drop for Window {
    /// Stops the heartbeat: the control then stops by itself what still moves.
    fn drop(&mut self) {
        if let Some(beating) = self.beating.get() {
            beating.abort();
        }
    }
}

/// Sequence number after `sequence`; 0 means that there was none.
pub(super) fn next(sequence: u16) -> u16 {
    sequence.checked_add(1).unwrap_or(1)
}

pub(super) fn unwritable(error: ValueError) -> ControllerError {
    ControllerError::Unsupported {
        what: error.to_string(),
        remedy: "compare [controller.registers.command] with docs/line-window.md".to_owned(),
    }
}

impl Window {
    /// Opens the line; the halt writes `hold`, and nothing is written after it.
    pub(super) async fn open(
        line: Line,
        unit: u8,
        timeout: Duration,
        map: Map,
    ) -> Result<(Self, Halt), ControllerError> {
        let settings = Settings { unit, timeout, allowed: map.allowed() };
        let (at, words) = map.command.hold.write(1).map_err(unwritable)?;
        let link = Arc::new(Modbus::open(line, settings).await?);
        let hold = link.urgent(at, &words)?;
        let urgent = hold.clone();
        let halt = Halt::new(move || urgent.send_and_close());
        let beat = Arc::new(AtomicU16::new(0));
        let patience = Patience::default();
        let window = Self {
            link,
            map,
            hold,
            halt: halt.clone(),
            beat,
            beating: OnceLock::new(),
            sequence: 0,
            ours: false,
            taken: None,
            free: None,
            patience,
            heart: Heart::default(),
        };
        Ok((window, halt))
    }

    pub(super) fn is_halted(&self) -> bool {
        self.halt.is_halted()
    }

    /// Holds the machine after a fault, whatever it is executing.
    pub(super) fn hold(&self) {
        self.hold.send_and_close();
    }

    /// Reads the control's present status: consistent, though perhaps older than the last chunk.
    pub(super) async fn status(&self) -> Result<Status, ControllerError> {
        let deadline = Instant::now() + self.patience.answer;
        let (first, count) = self.map.status.block();
        let mut pause = Duration::from_millis(1);
        loop {
            let error = match self.link.read(self.map.status.space, first, count).await {
                Ok(block) => match Status::read(&self.map, &block)? {
                    Some(status) => return Ok(status),
                    None => ControllerError::Garbled { text: "a status torn in two".to_owned() },
                },
                Err(error) if may_pass(&error) => error.into(),
                Err(error) => return Err(error.into()),
            };
            if Instant::now() > deadline {
                return Err(error);
            }
            sleep(pause).await;
            pause = (pause * 2).min(self.patience.poll);
        }
    }

    /// Waits until the machine is at rest and all chunks are complete.
    pub(super) async fn idle(&mut self) -> Result<Status, ControllerError> {
        let deadline = Instant::now() + self.patience.answer;
        loop {
            let status = self.status().await?;
            if self.halt.is_halted() {
                return Err(self.halted().await);
            }
            ends_it(&status)?;
            self.heart.look(status.heartbeat, &self.patience)?;
            let over = !self.ours || status.executed == self.sequence;
            let done = status.accepted == self.sequence && over;
            if done && status.state == State::Idle {
                return Ok(status);
            }
            if Instant::now() > deadline {
                return Err(match status.accepted {
                    0 if self.sequence != 0 => reset(),
                    _ => out_of_step(&status, self.sequence),
                });
            }
            sleep(self.patience.poll).await;
        }
    }

    /// Sequence number that the control will accept next.
    pub(super) fn coming(&self) -> u16 {
        next(self.sequence)
    }

    /// Executes `line`; returns the status at its end. `still` is the time for which the machine may be at
    /// rest meanwhile.
    ///
    /// # Errors
    /// A refusal, an alarm, a hold, a reset, silence; `Halted` once a halt was requested.
    pub(super) async fn ask(
        &mut self,
        line: &str,
        still: Duration,
    ) -> Result<Status, ControllerError> {
        let mut pending = self.begin(line.as_bytes(), line, still).await?;
        loop {
            if let (status, true) = self.look(&mut pending).await? {
                return Ok(status);
            }
        }
    }

    /// Writes `chunk` and starts it; `name` identifies it in errors.
    pub(super) async fn begin(
        &mut self,
        chunk: &[u8],
        name: &str,
        still: Duration,
    ) -> Result<Pending, ControllerError> {
        if self.halt.is_halted() {
            return Err(ControllerError::Halted);
        }
        let sequence = self.coming();
        let sent = match self.write_chunk(chunk).await {
            Ok(()) => self.start(sequence).await,
            Err(error) => Err(error),
        };
        match sent {
            Ok(()) => Ok(Pending::of(name, sequence, still)),
            Err(_) if self.halt.is_halted() => Err(self.halted().await),
            Err(error) => Err(error),
        }
    }

    /// Reads the status, and whether the whole chunk is complete and the machine at rest.
    pub(super) async fn look(
        &mut self,
        pending: &mut Pending,
    ) -> Result<(Status, bool), ControllerError> {
        pending.wait(self.patience.poll).await;
        let status = self.status().await?;
        if self.halt.is_halted() {
            return Err(self.halted().await);
        }
        let (name, sequence) = (&pending.name, pending.sequence);
        if status.accepted == sequence {
            (self.sequence, self.ours) = (sequence, true);
            if status.error != 0 {
                return Err(refused(name, status.error));
            }
        }
        ends_it(&status)?;
        self.heart.look(status.heartbeat, &self.patience)?;
        if let Some(step) = self.free.filter(|_| status.probe_closed) {
            // The machine may still be moving, and does not stop by itself.
            self.hold();
            return Err(ControllerError::UnexpectedContact { step });
        }
        match status.accepted {
            taken if taken == sequence => {
                if status.executed == sequence && status.state == State::Idle {
                    return Ok((status, true));
                }
            }
            before if before == self.sequence => {
                if pending.begun.elapsed() > self.patience.answer {
                    return Err(silent(name, self.patience.answer));
                }
            }
            0 => return Err(reset()),
            _ => return Err(out_of_step(&status, sequence)),
        }
        pending.watch.look(&status, &self.patience, pending.still, name)?;
        Ok((status, false))
    }

    /// Waits, after a hold was sent, until the machine is at rest. The hold may be lost: it is sent again
    /// until the status shows it; a surplus hold changes nothing. A control may stay idle on a hold: its
    /// machine is at rest if the control's program is running and has nothing left to execute.
    async fn halted(&self) -> ControllerError {
        let begun = Instant::now();
        let (mut beats, mut beaten) = (BTreeSet::new(), begun);
        loop {
            let status = match self.status().await {
                Ok(status) => status,
                Err(error) => return error,
            };
            if beats.insert(status.heartbeat) {
                beaten = Instant::now();
            }
            match status.state {
                State::Idle if beats.len() > 2 && status.executed == status.accepted => break,
                State::Idle | State::Running => self.hold(),
                _ => break,
            }
            if beaten.elapsed() > self.patience.heartbeat {
                return ControllerError::Frozen;
            }
            if begun.elapsed() > self.patience.answer {
                return ControllerError::NotHeld { seconds: self.patience.answer.as_secs_f64() };
            }
            sleep(self.patience.poll).await;
        }
        ControllerError::Halted
    }

    /// Starts the heartbeat of `trued` and waits until the control's heartbeat changes; returns the status
    /// that shows it.
    pub(super) async fn living(&self) -> Result<Status, ControllerError> {
        let heart = || beats(self.link.clone(), self.map.clone(), self.beat.clone());
        self.beating.get_or_init(|| tokio::spawn(heart()));
        let (at, words) =
            self.map.command.heartbeat.write(next_beat(&self.beat)).map_err(unwritable)?;
        match self.link.write_without_echo(at, &words).await {
            Err(error) if !may_pass(&error) => return Err(error.into()),
            _ => {}
        }
        let first = self.status().await?;
        let deadline = Instant::now() + self.patience.heartbeat;
        loop {
            sleep(self.patience.poll).await;
            let status = self.status().await?;
            if status.heartbeat != first.heartbeat {
                return Ok(status);
            }
            if Instant::now() > deadline {
                return Err(ControllerError::Frozen);
            }
        }
    }
}

pub(super) fn next_beat(beat: &AtomicU16) -> u16 {
    beat.fetch_add(1, Ordering::SeqCst).wrapping_add(1)
}

/// Writes heartbeats until the task is aborted, or a hold closes the link. A lost beat is followed by
/// another.
async fn beats(link: Arc<Modbus>, map: Map, beat: Arc<AtomicU16>) {
    loop {
        sleep(BEAT).await;
        let Ok((at, words)) = map.command.heartbeat.write(next_beat(&beat)) else { return };
        if let Err(ModbusError::Held { .. } | ModbusError::Ended { .. }) =
            link.write_without_echo(at, &words).await
        {
            return;
        }
    }
}
