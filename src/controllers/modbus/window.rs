//! The conversation through the window: one line, taken and executed; the status while waiting.

use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use super::crc::crc;
use super::fault::{ends_it, may_pass, out_of_step, refused, reset, silent};
use super::map::{MOST_WRITTEN, Map};
use super::status::{State, Status};
use super::watch::Watch;
use crate::controllers::{ControllerError, Halt};
use crate::link::modbus::value::ValueError;
use crate::link::modbus::{Line, Modbus, ModbusError, Settings, Urgent};

/// A request that may be sent again without harm is sent so often.
const TRIES: usize = 4;
/// How often trued's own heartbeat goes out while nothing else does.
const BEAT: Duration = Duration::from_millis(500);

/// How long the driver waits, host time.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// A living control takes a chunk, and tells its state, within this time.
    pub answer: Duration,
    /// The longest pause between two questions.
    pub poll: Duration,
    /// A control that says it moves shows another position within this time.
    pub stall: Duration,
    /// The control's heartbeat changes within this time.
    pub heartbeat: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            answer: Duration::from_secs(4),
            poll: Duration::from_millis(20),
            stall: Duration::from_secs(10),
            heartbeat: Duration::from_secs(2),
        }
    }
}

pub(super) struct Window {
    link: Arc<Modbus>,
    pub(super) map: Map,
    hold: Urgent,
    halt: Halt,
    beat: Arc<AtomicU16>,
    /// It begins with the first word that is more than a look.
    beating: OnceLock<JoinHandle<()>>,
    /// Of the last chunk that the control has taken.
    pub(super) sequence: u16,
    /// The step whose positioning move is under way: the probe touches nothing meanwhile.
    pub(super) free: Option<u32>,
    pub(super) patience: Patience,
}

impl Drop for Window {
    /// The control stops by itself what still moves once this heart stands.
    fn drop(&mut self) {
        if let Some(beating) = self.beating.get() {
            beating.abort();
        }
    }
}

/// The sequence after `sequence`; 0 means that there was none.
fn next(sequence: u16) -> u16 {
    sequence.checked_add(1).unwrap_or(1)
}

fn unwritable(error: ValueError) -> ControllerError {
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
            free: None,
            patience,
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
            let done = status.accepted == self.sequence && status.executed == self.sequence;
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
        if self.halt.is_halted() {
            return Err(ControllerError::Halted);
        }
        let sequence = next(self.sequence);
        let sent = match self.lay_down(line.as_bytes()).await {
            Ok(()) => self.start(sequence).await,
            Err(error) => Err(error),
        };
        match sent {
            Ok(()) => self.executed(line, sequence, still).await,
            Err(_) if self.halt.is_halted() => Err(self.halted().await),
            Err(error) => Err(error),
        }
    }

    /// The text and all that goes with it. Nothing acts before the sequence is written: what was not
    /// answered is written again.
    async fn lay_down(&self, text: &[u8]) -> Result<(), ControllerError> {
        let command = &self.map.command;
        let length = u16::try_from(text.len()).unwrap_or(u16::MAX);
        let beat = next_beat(&self.beat);
        let items = [
            command.heartbeat.write(beat),
            command.acknowledge.write(self.sequence),
            command.crc.write(crc(text)),
            command.length.write(length),
            Ok(command.chunk.write(text)),
        ];
        let items: Result<Vec<_>, _> = items.into_iter().collect();
        for (address, words) in joined(items.map_err(unwritable)?) {
            let mut left = TRIES;
            while let Err(error) = self.link.write(address, &words).await {
                left -= 1;
                if left == 0 || !may_pass(&error) {
                    return Err(error.into());
                }
                sleep(self.patience.poll).await;
            }
        }
        Ok(())
    }

    /// The control acts when the sequence changes. It takes each but once, and only the one that
    /// follows: to write the same again is no second command. All the same `accepted` is read first.
    async fn start(&self, sequence: u16) -> Result<(), ControllerError> {
        let (at, words) = self.map.command.sequence.write(sequence).map_err(unwritable)?;
        let mut left = TRIES;
        while let Err(error) = self.link.write_without_echo(at, &words).await {
            left -= 1;
            if left == 0 || !may_pass(&error) {
                return Err(error.into());
            }
            let status = self.status().await?;
            if status.accepted != self.sequence {
                // Taken; or something that `executed` will name.
                return Ok(());
            }
        }
        Ok(())
    }

    async fn executed(
        &mut self,
        line: &str,
        sequence: u16,
        still: Duration,
    ) -> Result<Status, ControllerError> {
        let begun = Instant::now();
        let mut watch = Watch::default();
        // Asked again at once: what takes no time, as a modal word, is done by then.
        let mut pause = Duration::ZERO;
        loop {
            let status = self.status().await?;
            if self.halt.is_halted() {
                return Err(self.halted().await);
            }
            if status.accepted == sequence {
                self.sequence = sequence;
                if status.error != 0 {
                    return Err(refused(line, status.error));
                }
            }
            ends_it(&status)?;
            if let Some(step) = self.free.filter(|_| status.probe_closed) {
                // It may still be moving, and does not stop by itself.
                self.hold();
                return Err(ControllerError::UnexpectedContact { step });
            }
            match status.accepted {
                taken if taken == sequence => {
                    if status.executed == sequence && status.state == State::Idle {
                        return Ok(status);
                    }
                }
                before if before == self.sequence => {
                    if begun.elapsed() > self.patience.answer {
                        return Err(silent(line, self.patience.answer));
                    }
                }
                0 => return Err(reset()),
                _ => return Err(out_of_step(&status, sequence)),
            }
            watch.look(&status, &self.patience, still, line)?;
            if !pause.is_zero() {
                sleep(pause).await;
            }
            pause = (pause * 2).max(Duration::from_millis(1)).min(self.patience.poll);
        }
    }

    /// The hold is on its way; see the machine stand before saying so.
    async fn halted(&self) -> ControllerError {
        let deadline = Instant::now() + 5 * self.patience.answer;
        while Instant::now() < deadline {
            match self.status().await {
                Ok(status) if status.state != State::Running && status.state != State::Idle => {
                    break;
                }
                Ok(_) => sleep(self.patience.poll).await,
                Err(error) => return error,
            }
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

/// What lies side by side goes in one request.
fn joined(mut items: Vec<(u16, Vec<u16>)>) -> Vec<(u16, Vec<u16>)> {
    items.sort_by_key(|(address, _)| *address);
    let mut all: Vec<(u16, Vec<u16>)> = Vec::new();
    for (address, words) in items {
        match all.last_mut() {
            Some((first, before))
                if usize::from(*first) + before.len() == usize::from(address)
                    && before.len() + words.len() <= MOST_WRITTEN =>
            {
                before.extend(words);
            }
            _ => all.push((address, words)),
        }
    }
    all
}

fn next_beat(beat: &AtomicU16) -> u16 {
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
