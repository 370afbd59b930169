//! Writes the chunk before the control acts, and the sequence number that makes it act.

use tokio::time::sleep;

use super::crc::crc;
use super::fault::may_pass;
use super::map::MOST_WRITTEN;
use super::window::{Window, next_beat, unwritable};
use crate::controllers::ControllerError;
use link::modbus::{ModbusError, Space};

/// Maximum number of attempts for a request that may be repeated without harm.
const TRIES: usize = 4;

impl Window {
    /// Writes the chunk and all that belongs to it, and reads each item back. The control does not act
    /// before the sequence number is written: an unanswered write is repeated.
    pub(super) async fn write_chunk(&self, chunk: &[u8]) -> Result<(), ControllerError> {
        let command = &self.map.command;
        let length = u16::try_from(chunk.len()).unwrap_or(u16::MAX);
        let beat = next_beat(&self.beat);
        let items = [
            command.heartbeat.write(beat),
            command.acknowledge.write(self.taken.unwrap_or(self.sequence)),
            command.crc.write(crc(chunk)),
            command.length.write(length),
            Ok(command.chunk.write(chunk)),
        ];
        let items: Result<Vec<_>, _> = items.into_iter().collect();
        for (address, words) in joined(items.map_err(unwritable)?) {
            self.write_with_retry(address, &words).await?;
        }
        Ok(())
    }

    /// Writes registers that have no effect by themselves, and checks that they keep the values.
    async fn write_with_retry(&self, address: u16, words: &[u16]) -> Result<(), ControllerError> {
        let mut left = TRIES;
        while let Err(error) = self.link.write(address, words).await {
            left -= 1;
            let lost = matches!(error, ModbusError::NotAsWritten { .. });
            if left == 0 || !(lost || may_pass(&error)) {
                return Err(error.into());
            }
            sleep(self.patience.poll).await;
        }
        Ok(())
    }

    /// Acknowledges a result that was read. A repeated acknowledgement does no harm.
    pub(super) async fn acknowledge(&self, number: u16) -> Result<(), ControllerError> {
        let (at, words) = self.map.command.acknowledge.write(number).map_err(unwritable)?;
        self.write_with_retry(at, &words).await
    }

    /// Writes the sequence number: the control acts when it changes. The control accepts each number only
    /// once, and only the next one, so that a repeated write is no second command. Still, the write is
    /// repeated only if the control reports that it has accepted nothing and holds no such number.
    pub(super) async fn start(&self, sequence: u16) -> Result<(), ControllerError> {
        let (at, words) = self.map.command.sequence.write(sequence).map_err(unwritable)?;
        let mut left = TRIES;
        while let Err(error) = self.link.write_without_echo(at, &words).await {
            left -= 1;
            if left == 0 || !may_pass(&error) {
                return Err(error.into());
            }
            if self.status().await?.accepted != self.sequence || self.holds(at, &words).await? {
                // The chunk was accepted, or is about to be; the next poll reports any other state.
                return Ok(());
            }
        }
        Ok(())
    }

    async fn holds(&self, at: u16, words: &[u16]) -> Result<bool, ControllerError> {
        let count = u16::try_from(words.len()).unwrap_or(u16::MAX);
        let mut left = TRIES;
        loop {
            match self.link.read(Space::Holding, at, count).await {
                Ok(read) => return Ok(read == words),
                Err(error) => {
                    left -= 1;
                    if left == 0 || !may_pass(&error) {
                        return Err(error.into());
                    }
                }
            }
        }
    }
}

/// Joins adjacent items into one request, as far as one request holds them.
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
    let pieces = all.into_iter().flat_map(|(first, words)| {
        let places = (first..).step_by(MOST_WRITTEN);
        let pieces: Vec<_> = words.chunks(MOST_WRITTEN).map(<[u16]>::to_vec).collect();
        places.zip(pieces)
    });
    pieces.collect()
}
