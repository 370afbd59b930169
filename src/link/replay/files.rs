//! Replay of shared files. A read is a query; a written text must equal the captured text. A read sends the name of
//! the file; the reply is the name and, after a line feed, the text of the file.

use std::collections::BTreeMap;

use super::read::{Track, Transfer};
use super::{Said, Script};

/// A written file (its name, a line feed, its text), and the reads until the next write.
#[derive(Default)]
struct Exchange {
    written: Vec<u8>,
    reads: BTreeMap<Vec<u8>, Vec<Said>>,
}

pub(super) struct Files {
    /// The first exchange has no written file.
    exchanges: Vec<Exchange>,
    at: usize,
    /// Number of reads of each file since the last write.
    given: BTreeMap<Vec<u8>, usize>,
}

fn name(told: &[u8]) -> &[u8] {
    told.split(|byte| *byte == b'\n').next().unwrap_or_default()
}

impl Files {
    pub(super) fn new(track: &Track) -> Self {
        let mut exchanges = vec![Exchange::default()];
        for passed in &track.passed {
            match passed {
                Transfer::Sent(written) => {
                    exchanges.push(Exchange { written: written.clone(), ..Exchange::default() });
                }
                Transfer::StreamRead(said) => {
                    let Some(exchange) = exchanges.last_mut() else { continue };
                    let reads = exchange.reads.entry(name(&said.bytes).to_owned()).or_default();
                    reads.push(said.clone());
                }
            }
        }
        Self { exchanges, at: 0, given: BTreeMap::new() }
    }

    fn read(&mut self, file: &[u8]) -> Said {
        let given = self.given.entry(file.to_owned()).or_default();
        let here = self.exchanges.get(self.at).and_then(|exchange| exchange.reads.get(file));
        let said = here.and_then(|reads| reads.get(*given).or(reads.last()));
        *given += 1;
        // A file that was not written since does not exist.
        said.cloned().unwrap_or_else(|| Said { at_s: 0.0, bytes: file.to_owned() })
    }
}

impl Script for Files {
    fn hear(&mut self, bytes: &[u8]) -> Result<Vec<Said>, String> {
        if bytes.is_empty() {
            return Ok(Vec::new());
        }
        if !bytes.contains(&b'\n') {
            return Ok(vec![self.read(bytes)]);
        }
        match self.exchanges.get(self.at + 1) {
            Some(next) if next.written == bytes => {
                (self.at, self.given) = (self.at + 1, BTreeMap::new());
                Ok(Vec::new())
            }
            next => {
                let then =
                    next.map_or("nothing".to_owned(), |next| first_unlike(&next.written, bytes));
                let file = name(bytes).escape_ascii();
                Err(format!("the capture does not know this {file} here: then it was {then}"))
            }
        }
    }
}

/// First line of `then` that differs from `now`.
fn first_unlike(then: &[u8], now: &[u8]) -> String {
    let lines = |text: &[u8]| -> Vec<Vec<u8>> {
        text.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect()
    };
    let now = lines(now);
    let unlike = lines(then).into_iter().enumerate().find(|(at, line)| now.get(*at) != Some(line));
    unlike.map_or("shorter".to_owned(), |(_, line)| format!("`{}`", line.escape_ascii()))
}
