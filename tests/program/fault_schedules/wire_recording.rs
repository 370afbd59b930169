//! Records the bytes that pass one point of the wire, line by line.

use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, ReadHalf, WriteHalf};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    ToControl,
    FromControl,
}

#[derive(Debug, Clone)]
pub struct RecordedLine {
    pub direction: Direction,
    pub line: String,
}

/// Recording to which other tasks may still add lines.
#[derive(Clone, Default)]
pub struct WireRecording(Arc<Mutex<Vec<RecordedLine>>>);

impl WireRecording {
    pub fn entries(&self) -> Vec<RecordedLine> {
        self.0.lock().unwrap().clone()
    }

    fn add_entry(&self, direction: Direction, line: Vec<u8>) {
        let line = String::from_utf8_lossy(&line).trim_end().to_owned();
        self.0.lock().unwrap().push(RecordedLine { direction, line });
    }

    /// Forwards everything between `near` and `far` until one of them ends.
    pub async fn record_between(self, near: DuplexStream, far: DuplexStream) {
        let (near_out, near_in) = tokio::io::split(near);
        let (far_out, far_in) = tokio::io::split(far);
        tokio::select! {
            () = self.forward_and_record(Direction::ToControl, near_out, far_in) => {}
            () = self.forward_and_record(Direction::FromControl, far_out, near_in) => {}
        }
    }

    /// Realtime bytes to the control act at once, at any place in the stream: `!`, `~` and a reset are recorded as
    /// separate lines, `?` is not.
    async fn forward_and_record(
        &self,
        way: Direction,
        mut from: ReadHalf<DuplexStream>,
        mut to: WriteHalf<DuplexStream>,
    ) {
        let mut line = Vec::new();
        while let Ok(byte) = from.read_u8().await {
            match byte {
                b'\n' => self.add_entry(way, std::mem::take(&mut line)),
                b'!' | b'~' | 0x18 if way == Direction::ToControl => self.add_entry(way, vec![byte]),
                b'?' | 0x80.. if way == Direction::ToControl => {}
                byte => line.push(byte),
            }
            if to.write_all(&[byte]).await.is_err() {
                return;
            }
        }
    }
}

/// Whether the line can move the machine.
pub fn is_motion_line(line: &str) -> bool {
    line.contains("G53") || line.contains("G38")
}

/// Number in the first N word of a line; `None`: the line has none.
pub fn n_word_of_line(line: &str) -> Option<u32> {
    let digits = line.split('N').nth(1)?;
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    digits[..end].parse().ok()
}
