//! The conversation through the window: one line, taken and executed; the status while waiting.

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

/// How often trued's own heartbeat goes out while nothing else does.
const BEAT: Duration = Duration::from_millis(500);

/// A chunk that the control was told to take.
pub(super) struct Pending {
    name: String,
    pub(super) sequence: u16,
    still: Duration,
    begun: Instant,
    watch: Watch,
    /// Before the next question; `None`: nothing was asked yet.
    pause: Option<Duration>,
}

impl Pending {
    fn of(name: &str, sequence: u16, still: Duration) -> Self {
        let (begun, watch) = (Instant::now(), Watch::default());
        Self { name: name.to_owned(), sequence, still, begun, watch, pause: None }
    }

    /// The longer it takes the longer, up to `most`. The second question comes at once as well: what
    /// takes no time, as a modal word, is done by then.
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
    /// It begins with the first word that is more than a look.
    beating: OnceLock<JoinHandle<()>>,
    /// Of the last chunk that the control has taken.
    pub(super) sequence: u16,
    /// It was sent from here. What became of another one, held or refused perhaps, is no matter.
    pub(super) ours: bool,
    /// Of a resident program: the number of the last result that was read.
    pub(super) taken: Option<u16>,
    /// The step whose positioning move, at rapid or at feed, is under way: the stylus should meet nothing.
    pub(super) free: Option<u32>,
    pub(super) patience: Patience,
    heart: Heart,
}

impl Drop for Window {
    /// The control stops by itself what still moves once this heart stands.
    fn drop(&mut self) {
        if let Some(beating) = self.beating.get() {
            beating.abort();
        }
    }
}

/// The number after `sequence`; 0 means that there was none.
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
    /// Open the line; the halt writes `hold`, and nothing is written after it.
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

    /// Hold the machine after a fault: whatever it is doing.
    pub(super) fn hold(&self) {
        self.hold.send_and_close();
    }

    /// The control's status as it is now: whole, though perhaps older than the last chunk.
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

    /// Wait until the machine stands still and all that was sent is done.
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

    /// The sequence that the control will take next.
    pub(super) fn coming(&self) -> u16 {
        next(self.sequence)
    }

    /// Have `line` executed; the status when that is done. `still`: so long the machine may stand
    /// meanwhile.
    ///
    /// # Errors
    /// A refusal, an alarm, a hold, a reset, silence; `Halted` once a halt was asked for.
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

    /// Lay `chunk` down and have it begun; `name` is what errors call it.
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
        let sent = match self.lay_down(chunk).await {
            Ok(()) => self.start(sequence).await,
            Err(error) => Err(error),
        };
        match sent {
            Ok(()) => Ok(Pending::of(name, sequence, still)),
            Err(_) if self.halt.is_halted() => Err(self.halted().await),
            Err(error) => Err(error),
        }
    }

    /// The status, and whether it says that all of the chunk is done and the machine stands.
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
            // It may still be moving, and does not stop by itself.
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

    /// The hold is on its way; see the machine stand before saying so. The wire may have lost it: it is
    /// sent again until the status shows it, one too many changes nothing. A control may stay idle on a
    /// hold: it stands if its program lives and has nothing left to do.
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

    /// A heartbeat from here, and one that changes from there; the status that shows it.
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

/// Until it is aborted, or the link is closed by a hold. A beat that is lost is followed by another.
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
