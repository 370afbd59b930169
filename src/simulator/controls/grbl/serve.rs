//! Serves the simulated control on a byte stream.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::sleep_until;

use super::Firmware;

impl Firmware {
    /// Serves one client until it closes the stream. The control keeps its state for the next client, and
    /// motion continues meanwhile.
    ///
    /// # Errors
    /// The stream fails; the control remains usable.
    pub async fn serve(&mut self, stream: impl AsyncRead + AsyncWrite) -> io::Result<()> {
        let (mut reader, mut writer) = tokio::io::split(stream);
        let mut buffer = [0; 1024];
        if !self.has_booted {
            self.has_booted = true;
            self.send_banner();
        }
        loop {
            let next = self.advance_and_return_wake_time(self.start_instant.elapsed());
            let wake = self.start_instant + next.unwrap_or(Duration::ZERO);
            // `read` and `write` are cancel safe: a branch that is not taken has transferred no byte.
            tokio::select! {
                read = reader.read(&mut buffer) => match read? {
                    0 => return Ok(()),
                    count => self.receive_bytes(&buffer[..count], self.start_instant.elapsed()),
                },
                written = writer.write(&self.send_buffer), if !self.send_buffer.is_empty() => {
                    self.send_buffer.drain(..written?);
                }
                () = sleep_until(wake), if next.is_some() => {}
            }
        }
    }
}
