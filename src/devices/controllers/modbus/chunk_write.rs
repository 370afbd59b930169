//! Writes a chunk to the control, and then the sequence number that makes the control act on it.

use crc::{CRC_16_MODBUS, Crc};
use tokio::time::sleep;

use super::fault::is_transient;
use super::map::MAX_WRITE_REGISTERS;
use super::window::{WindowConnection, encoding_error, next_heartbeat};
use crate::controllers::ControllerError;
use link::modbus::{ModbusError, RegisterSpace};

/// Maximum number of attempts, the first included, for a request that may be repeated without harm.
const MAX_REQUEST_ATTEMPTS: usize = 4;
const CHUNK_CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_MODBUS);

impl WindowConnection {
    /// Writes the chunk with its length, checksum, a heartbeat and the last acknowledgement, and reads each back. The
    /// control acts only on the sequence number, which is written later: an unanswered write is repeated.
    pub(super) async fn write_chunk(&self, chunk: &[u8]) -> Result<(), ControllerError> {
        let command = &self.map.command;
        let length = u16::try_from(chunk.len()).unwrap_or(u16::MAX);
        let beat = next_heartbeat(&self.own_heartbeat);
        let items = [
            command.heartbeat.encode_value(beat),
            command.result_acknowledge.encode_value(self.last_result_number.unwrap_or(self.checked_sequence)),
            command.chunk_crc.encode_value(CHUNK_CRC.checksum(chunk)),
            command.chunk_length.encode_value(length),
            Ok(command.chunk.encode_text(chunk)),
        ];
        let items: Result<Vec<_>, _> = items.into_iter().collect();
        for (address, words) in merge_adjacent_writes(items.map_err(encoding_error)?) {
            self.write_with_retry(address, &words).await?;
        }
        Ok(())
    }

    /// Writes registers that have no effect by themselves, and checks that they keep the values.
    async fn write_with_retry(&self, address: u16, words: &[u16]) -> Result<(), ControllerError> {
        let mut attempts_left = MAX_REQUEST_ATTEMPTS;
        while let Err(error) = self.link.write(address, words).await {
            attempts_left -= 1;
            let lost = matches!(error, ModbusError::ReadBackDiffers { .. });
            if attempts_left == 0 || !(lost || is_transient(&error)) {
                return Err(error.into());
            }
            sleep(self.timeouts.poll_interval).await;
        }
        Ok(())
    }

    /// Acknowledges a result that was read. A repeated acknowledgement does no harm.
    pub(super) async fn acknowledge_result(&self, number: u16) -> Result<(), ControllerError> {
        let (at, words) = self.map.command.result_acknowledge.encode_value(number).map_err(encoding_error)?;
        self.write_with_retry(at, &words).await
    }

    /// Writes the sequence number: the control acts when it changes. The control accepts each number only once, and
    /// only the next one, so that a repeated write is no second command. Still, the write is repeated only if the
    /// control has accepted no new number and the sequence register does not contain this number.
    pub(super) async fn write_sequence(&self, sequence: u16) -> Result<(), ControllerError> {
        let (at, words) = self.map.command.sequence.encode_value(sequence).map_err(encoding_error)?;
        let mut attempts_left = MAX_REQUEST_ATTEMPTS;
        while let Err(error) = self.link.write_without_read_back(at, &words).await {
            attempts_left -= 1;
            if attempts_left == 0 || !is_transient(&error) {
                return Err(error.into());
            }
            if self.read_status().await?.checked_sequence != self.checked_sequence
                || self.are_holding_registers_equal(at, &words).await?
            {
                // The chunk was accepted, or is about to be; the next poll reports any other state.
                return Ok(());
            }
        }
        Ok(())
    }

    /// Whether the holding registers from `at` on have the values `words`.
    async fn are_holding_registers_equal(&self, at: u16, words: &[u16]) -> Result<bool, ControllerError> {
        let count = u16::try_from(words.len()).unwrap_or(u16::MAX);
        let mut attempts_left = MAX_REQUEST_ATTEMPTS;
        loop {
            match self.link.read(RegisterSpace::Holding, at, count).await {
                Ok(read) => return Ok(read == words),
                Err(error) if attempts_left == 1 || !is_transient(&error) => return Err(error.into()),
                Err(_) => attempts_left -= 1,
            }
        }
    }
}

/// Groups items, each an address and its words, into write requests: sorts them by address, joins adjacent items, and
/// splits what exceeds [`MAX_WRITE_REGISTERS`].
fn merge_adjacent_writes(mut items: Vec<(u16, Vec<u16>)>) -> Vec<(u16, Vec<u16>)> {
    items.sort_by_key(|(address, _)| *address);
    let mut merged: Vec<(u16, Vec<u16>)> = Vec::new();
    for (address, words) in items {
        match merged.last_mut() {
            Some((first, before))
                if usize::from(*first) + before.len() == usize::from(address)
                    && before.len() + words.len() <= MAX_WRITE_REGISTERS =>
            {
                before.extend(words);
            }
            _ => merged.push((address, words)),
        }
    }
    let chunks = merged.into_iter().flat_map(|(first, words)| {
        let addresses = (first..).step_by(MAX_WRITE_REGISTERS);
        let chunks: Vec<_> = words.chunks(MAX_WRITE_REGISTERS).map(<[u16]>::to_vec).collect();
        addresses.zip(chunks)
    });
    chunks.collect()
}
