//! A conversation in lines. What is sent outside of lines are single bytes; `?` asks for a status
//! report, a line in `<` and `>` that comes when it likes.

use super::read::{Passed, Track};
use super::{Said, Script};

const POLL: u8 = b'?';

/// A command, and what came until the next one.
#[derive(Default)]
struct Exchange {
    command: Vec<u8>,
    replies: Vec<Said>,
    reports: Vec<Said>,
}

pub(super) struct Lines {
    /// The first has no command: what the device says unasked.
    exchanges: Vec<Exchange>,
    /// The exchange under way; `None` before the first.
    at: Option<usize>,
    /// How many of its reports were given.
    given: usize,
    cutter: Cutter,
}

impl Lines {
    pub(super) fn new(track: &Track) -> Self {
        let mut exchanges = vec![Exchange::default()];
        let (mut cutter, mut coming) = (Cutter::default(), Vec::new());
        for passed in &track.passed {
            match passed {
                Passed::Sent(bytes) => {
                    let commands = cutter.cut(bytes).into_iter().filter(|cut| *cut != [POLL]);
                    exchanges.extend(
                        commands.map(|command| Exchange { command, ..Exchange::default() }),
                    );
                }
                Passed::Came(said) => {
                    coming.extend(&said.bytes);
                    let Some(exchange) = exchanges.last_mut() else { continue };
                    while let Some(end) = coming.iter().position(|byte| *byte == b'\n') {
                        let bytes: Vec<u8> = coming.drain(..=end).collect();
                        let is_report =
                            bytes.starts_with(b"<") && bytes.trim_ascii_end().ends_with(b">");
                        let kind =
                            if is_report { &mut exchange.reports } else { &mut exchange.replies };
                        kind.push(Said { at_s: said.at_s, bytes });
                    }
                }
            }
        }
        Self { exchanges, at: None, given: 0, cutter: Cutter::default() }
    }

    fn answer(&mut self, command: &[u8]) -> Result<Vec<Said>, String> {
        let next = self.at.map_or(0, |at| at + 1);
        match self.exchanges.get(next) {
            Some(exchange) if exchange.command == command => {
                (self.at, self.given) = (Some(next), 0);
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

    /// The next report of this exchange, or the last there was.
    fn report(&mut self) -> Option<Said> {
        let at = self.at?;
        let here = &self.exchanges.get(at)?.reports;
        let report = here.get(self.given).or(here.last()).or_else(|| {
            let before = self.exchanges.iter().take(at).rev();
            before.filter_map(|exchange| exchange.reports.last()).next()
        });
        self.given += 1;
        report.cloned()
    }
}

impl Script for Lines {
    fn hear(&mut self, bytes: &[u8]) -> Result<Vec<Said>, String> {
        let mut said = Vec::new();
        if self.at.is_none() {
            said.extend(self.answer(&[])?);
        }
        for command in self.cutter.cut(bytes) {
            if command == [POLL] {
                said.extend(self.report());
            } else {
                said.extend(self.answer(&command)?);
            }
        }
        Ok(said)
    }
}

fn words(command: &[u8]) -> String {
    format!("`{}`", command.trim_ascii_end().escape_ascii())
}

/// Cuts what is sent into lines, and bytes outside of lines.
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
