//! Replay of a protocol in lines. Single bytes are sent outside of lines; `?` requests a status report, a line in
//! `<` and `>` that may arrive at any time. A line that begins with `get ` is a query too; its reply arrives before
//! any other line.

use std::collections::BTreeMap;

use super::read::{Track, Transfer};
use super::{Said, Script};

const POLL: &[u8] = b"?";
/// Requests the status report with all fields from grblHAL.
const FULL_POLL: &[u8] = b"\x87";
const QUESTION: &[u8] = b"get ";

/// A command, and the data received until the next command.
#[derive(Default)]
struct Exchange {
    command: Vec<u8>,
    replies: Vec<Said>,
    /// Replies to each query; for a poll, the status reports.
    asked: BTreeMap<Vec<u8>, Vec<Vec<Said>>>,
}

pub(super) struct Lines {
    /// The first exchange has no command: it holds what the device sends without a request.
    exchanges: Vec<Exchange>,
    /// Index of the current exchange; `None` before the first.
    at: Option<usize>,
    /// Number of replies to each query in the current exchange.
    given: BTreeMap<Vec<u8>, usize>,
    cutter: Cutter,
}

impl Lines {
    pub(super) fn new(track: &Track) -> Self {
        let mut exchanges = vec![Exchange::default()];
        let (mut cutter, mut coming, mut question) = (Cutter::default(), Vec::new(), None);
        let mut poll = POLL.to_vec();
        for passed in &track.passed {
            match passed {
                Transfer::Sent(bytes) => {
                    for command in cutter.cut(bytes) {
                        if is_poll(&command) {
                            poll = command;
                        } else if let (true, Some(exchange)) =
                            (only_asks(&command), exchanges.last_mut())
                        {
                            exchange.asked.entry(command.clone()).or_default().push(Vec::new());
                            question = Some(command);
                        } else {
                            exchanges.push(Exchange { command, ..Exchange::default() });
                            question = None;
                        }
                    }
                }
                Transfer::StreamRead(said) => {
                    coming.extend(&said.bytes);
                    let Some(exchange) = exchanges.last_mut() else { continue };
                    while let Some(end) = coming.iter().position(|byte| *byte == b'\n') {
                        let bytes: Vec<u8> = coming.drain(..=end).collect();
                        exchange.keep(question.as_deref(), &poll, Said { at_s: said.at_s, bytes });
                    }
                }
            }
        }
        Self { exchanges, at: None, given: BTreeMap::new(), cutter: Cutter::default() }
    }

    fn answer(&mut self, command: &[u8]) -> Result<Vec<Said>, String> {
        let next = self.at.map_or(0, |at| at + 1);
        match self.exchanges.get(next) {
            Some(exchange) if exchange.command == command => {
                (self.at, self.given) = (Some(next), BTreeMap::new());
                Ok(exchange.replies.clone())
            }
            expected => {
                let then = expected.map_or("nothing".to_owned(), |next| words(&next.command));
                Err(format!(
                    "the capture does not know {} here: then it was {then}",
                    words(command)
                ))
            }
        }
    }

    /// Next captured reply of this exchange to `question`; if there is none left, the last reply.
    fn told(&mut self, question: &[u8]) -> Option<Vec<Said>> {
        let at = self.at?;
        let given = self.given.entry(question.to_owned()).or_default();
        let here = self.exchanges.get(at)?.asked.get(question);
        let now = here.and_then(|answers| answers.get(*given).or(answers.last()));
        *given += 1;
        let before = || {
            let earlier = self.exchanges.iter().take(at).rev();
            earlier.filter_map(|exchange| exchange.asked.get(question)?.last()).next()
        };
        now.or_else(before).cloned()
    }
}

impl Exchange {
    /// Stores a received line. `poll` is the last poll that was sent.
    fn keep(&mut self, question: Option<&[u8]>, poll: &[u8], said: Said) {
        let is_report = said.bytes.starts_with(b"<") && said.bytes.trim_ascii_end().ends_with(b">");
        if is_report {
            return self.asked.entry(poll.to_owned()).or_default().push(vec![said]);
        }
        let answers = question.and_then(|question| self.asked.get_mut(question)?.last_mut());
        answers.unwrap_or(&mut self.replies).push(said);
    }
}

fn is_poll(command: &[u8]) -> bool {
    command == POLL || command == FULL_POLL
}

fn only_asks(command: &[u8]) -> bool {
    command.starts_with(QUESTION)
}

impl Script for Lines {
    fn hear(&mut self, bytes: &[u8]) -> Result<Vec<Said>, String> {
        let mut said = Vec::new();
        if self.at.is_none() {
            said.extend(self.answer(&[])?);
        }
        for command in self.cutter.cut(bytes) {
            said.extend(match () {
                // The control has sent no status report so far.
                () if is_poll(&command) => self.told(&command).unwrap_or_default(),
                () if only_asks(&command) => self
                    .told(&command)
                    .ok_or_else(|| format!("the capture does not know {}", words(&command)))?,
                () => self.answer(&command)?,
            });
        }
        Ok(said)
    }
}

fn words(command: &[u8]) -> String {
    format!("`{}`", command.trim_ascii_end().escape_ascii())
}

/// Splits sent bytes into lines and single bytes outside of lines.
#[derive(Default)]
struct Cutter {
    line: Vec<u8>,
}

impl Cutter {
    fn cut(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut cuts = Vec::new();
        for byte in bytes {
            let alone = matches!(byte, b'?' | b'!' | b'~' | 0..=0x08 | 0x0E..=0x1F | 0x80..);
            if self.line.is_empty() && alone {
                cuts.push(vec![*byte]);
                continue;
            }
            self.line.push(*byte);
            if *byte == b'\n' {
                cuts.push(std::mem::take(&mut self.line));
            }
        }
        cuts
    }
}
