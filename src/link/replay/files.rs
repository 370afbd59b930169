//! Replay of shared files. A read is a query; a written text must equal the captured text. A read sends the name of
//! the file; the reply is the name and, after a line feed, the text of the file.

use std::collections::BTreeMap;

use super::read::{CapturedLink, Transfer};
use super::{CapturedReply, LinkScript};

/// A written file (its name, a line feed, its text), and the reads until the next write.
#[derive(Default)]
struct FileExchange {
    written: Vec<u8>,
    reads: BTreeMap<Vec<u8>, Vec<CapturedReply>>,
}

pub(super) struct FileScript {
    /// The first exchange has no written file.
    exchanges: Vec<FileExchange>,
    current: usize,
    /// Number of reads of each file since the last write.
    read_counts: BTreeMap<Vec<u8>, usize>,
}

fn file_name(entry: &[u8]) -> &[u8] {
    entry.split(|byte| *byte == b'\n').next().unwrap_or_default()
}

impl FileScript {
    pub(super) fn new(track: &CapturedLink) -> Self {
        let mut exchanges = vec![FileExchange::default()];
        for transfer in &track.transfers {
            match transfer {
                Transfer::Sent(written) => {
                    exchanges.push(FileExchange { written: written.clone(), ..FileExchange::default() });
                }
                Transfer::Received(reply) => {
                    let Some(exchange) = exchanges.last_mut() else { continue };
                    let reads = exchange.reads.entry(file_name(&reply.bytes).to_owned()).or_default();
                    reads.push(reply.clone());
                }
            }
        }
        Self { exchanges, current: 0, read_counts: BTreeMap::new() }
    }

    fn read(&mut self, file: &[u8]) -> CapturedReply {
        let read_counts = self.read_counts.entry(file.to_owned()).or_default();
        let reads = self.exchanges.get(self.current).and_then(|exchange| exchange.reads.get(file));
        let reply = reads.and_then(|reads| reads.get(*read_counts).or(reads.last()));
        *read_counts += 1;
        // A file that was not written since does not exist.
        reply.cloned().unwrap_or_else(|| CapturedReply { time_s: 0.0, bytes: file.to_owned() })
    }
}

impl LinkScript for FileScript {
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, String> {
        if bytes.is_empty() {
            return Ok(Vec::new());
        }
        if !bytes.contains(&b'\n') {
            return Ok(vec![self.read(bytes)]);
        }
        match self.exchanges.get(self.current + 1) {
            Some(next) if next.written == bytes => {
                (self.current, self.read_counts) = (self.current + 1, BTreeMap::new());
                Ok(Vec::new())
            }
            next => {
                let captured = next.map_or("nothing".to_owned(), |next| first_difference(&next.written, bytes));
                let file = file_name(bytes).escape_ascii();
                Err(format!("the text of {file} differs from the capture; captured text: {captured}"))
            }
        }
    }
}

/// First line of `captured` that differs from `written`.
fn first_difference(captured: &[u8], written: &[u8]) -> String {
    let lines = |text: &[u8]| -> Vec<Vec<u8>> { text.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect() };
    let written = lines(written);
    let difference =
        lines(captured).into_iter().enumerate().find(|(current, line)| written.get(*current) != Some(line));
    difference.map_or("shorter".to_owned(), |(_, line)| format!("`{}`", line.escape_ascii()))
}
