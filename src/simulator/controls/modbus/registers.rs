//! Reads and writes of registers.

use tokio_modbus::{ExceptionCode, Request, Response};

use super::fault::WRONG_STAMP_S;
use super::layout::{ACKNOWLEDGE, HEARTBEAT, HOLD, SEQUENCE, steps};
use super::resident::Slot;
use super::{Entry, Firmware, Mode};
use machine::Position;

const VERSION: u16 = 1;
const PROGRAM_VERSION: u16 = 101;
/// Rate of the heartbeat counter, 1/s.
const BEATS_PER_S: f64 = 20.0;

fn words_of(position: &Position) -> Vec<u16> {
    steps(position).iter().flat_map(|steps| words(&steps.to_be_bytes())).collect()
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes
        .chunks(2)
        .map(|pair| pair.iter().fold(0, |word, byte| word << 8 | u16::from(*byte)))
        .collect()
}

impl Firmware {
    /// Input registers 0 to 44; 0 to 49 with a resident program.
    pub(super) fn status(&mut self) -> Vec<u16> {
        if let Some(frozen) = &self.frozen {
            return frozen.clone();
        }
        let (state, alarm) = match self.mode {
            Mode::NotReady => (0, 0),
            Mode::Ready if self.is_moving() => (2, 0),
            Mode::Ready => (1, 0),
            Mode::Held(reason) => (3, reason),
            Mode::Alarm(code) => (4, code),
        };
        let position = match &self.active {
            Some(active) => active.position(self.now),
            None => self.stand(),
        };
        self.blocks = self.blocks.wrapping_add(1);
        let probe = u16::from(self.tripped());
        self.on_probe_state_reported();
        let beat = self.heartbeat();
        let slot = self.slot();
        let version = if slot.is_some() { PROGRAM_VERSION } else { VERSION };
        let (number, t_s, latch) = match &slot {
            Some(slot) => (slot.number, slot.t_s, &slot.latch),
            None => (self.latches, self.latch_time_s, &self.latch),
        };
        let t_s = if self.wrong_stamp && t_s > 0.0 { WRONG_STAMP_S } else { t_s };
        let mut block = vec![self.blocks, version, state, alarm, self.accepted, self.executed];
        block.extend([self.error, probe, 0, 0, number, beat]);
        block.extend(words(&self.with_world(|world| world.time_s()).to_be_bytes()));
        block.extend(words(&t_s.to_be_bytes()));
        block.extend(words_of(latch));
        block.extend(words_of(&position));
        if let (Some(slot), Some(resident)) = (slot, &self.resident) {
            let at = u16::try_from(resident.at).unwrap_or(u16::MAX);
            block.extend([at, slot.sequence, slot.row]);
            block.extend([slot.contact, slot.valid].map(u16::from));
        }
        block.push(self.blocks);
        self.shown.clone_from(&block);
        block
    }

    pub(super) fn heartbeat(&self) -> u16 {
        let beat = (self.now.as_secs_f64() * BEATS_PER_S) as u64 as u16;
        self.standing_heartbeat.unwrap_or(beat)
    }

    /// Result shown by the resident program; the previous one for [`FaultKind::StaleResult`].
    fn slot(&mut self) -> Option<Slot> {
        let resident = self.resident.as_ref()?;
        match self.stale_result.then(|| resident.before.clone()).flatten() {
            Some(before) => Some(Slot { valid: true, ..before }),
            None => Some(resident.slot.clone()),
        }
    }

    /// Executes `request`.
    pub(super) fn answer(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let cut = |block: &[u16], first: u16, count: u16| {
            let first = usize::from(first);
            let words = block.get(first..first + usize::from(count));
            words.map(<[u16]>::to_vec).ok_or(ExceptionCode::IllegalDataAddress)
        };
        match request {
            Request::ReadInputRegisters(first, count) => {
                cut(&self.status(), *first, *count).map(Response::ReadInputRegisters)
            }
            Request::ReadHoldingRegisters(first, count) => {
                cut(&self.command, *first, *count).map(Response::ReadHoldingRegisters)
            }
            Request::WriteSingleRegister(at, word) => {
                self.write(*at, &[*word])?;
                Ok(Response::WriteSingleRegister(*at, *word))
            }
            Request::WriteMultipleRegisters(at, words) => {
                self.write(*at, words)?;
                let count =
                    u16::try_from(words.len()).map_err(|_| ExceptionCode::IllegalDataValue)?;
                Ok(Response::WriteMultipleRegisters(*at, count))
            }
            _ => Err(ExceptionCode::IllegalFunction),
        }
    }

    pub(super) fn write(&mut self, at: u16, words: &[u16]) -> Result<(), ExceptionCode> {
        let first = usize::from(at);
        let range = first..first + words.len();
        let before = [HOLD, HEARTBEAT].map(|place| self.command[place]);
        let place = self.command.get_mut(range.clone()).ok_or(ExceptionCode::IllegalDataAddress)?;
        place.copy_from_slice(words);
        if self.command[HEARTBEAT] != before[1] {
            self.beat = Some(self.now);
        }
        if let Some(resident) = self.resident.as_mut().filter(|_| range.contains(&ACKNOWLEDGE)) {
            resident.acknowledged(self.command[ACKNOWLEDGE]);
        }
        if range.contains(&SEQUENCE) {
            self.sequence_written();
        }
        if self.command[HOLD] != 0 && range.contains(&HOLD) {
            self.note(Entry::Hold);
            self.hold(0);
        }
        Ok(())
    }
}
