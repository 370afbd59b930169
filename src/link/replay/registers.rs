//! Replay of Modbus frames. Reads are queries; writes are commands. A write of a single register may be a
//! heartbeat, which depends on time: it is confirmed even if it is more or less frequent than in the capture.

use std::collections::BTreeMap;

use super::frames::{Body, Frames};
use super::read::{Track, Transfer};
use super::{Said, Script};

/// A write, and the reads until the next write.
#[derive(Default)]
struct Exchange {
    write: Body,
    reply: Option<Said>,
    reads: BTreeMap<Body, Vec<Said>>,
}

pub(super) struct Registers {
    frames: Frames,
    /// The first exchange has no write.
    exchanges: Vec<Exchange>,
    at: usize,
    /// Number of replies to each read in this exchange.
    given: BTreeMap<Body, usize>,
    sent: Vec<u8>,
}

fn function(body: &[u8]) -> u8 {
    body.get(1).map_or(0, |code| code & 0x7F)
}

fn only_asks(body: &[u8]) -> bool {
    matches!(function(body), 1..=4)
}

/// Unit, function, address and count of a write of a single register.
fn single(body: &[u8]) -> Option<&[u8]> {
    let count = body.get(4..6)?;
    (function(body) == 16 && count == [0, 1]).then(|| body.get(..6)).flatten()
}

impl Registers {
    pub(super) fn new(track: &Track, frames: Frames) -> Self {
        let mut exchanges = vec![Exchange::default()];
        // Requests without a reply so far.
        let mut open: Vec<(u16, Body)> = Vec::new();
        let (mut sent, mut came) = (Vec::new(), Vec::new());
        for passed in &track.passed {
            match passed {
                Transfer::Sent(bytes) => {
                    sent.extend(bytes);
                    came.clear();
                    for (transaction, body) in frames.take(&mut sent) {
                        if !only_asks(&body) {
                            exchanges.push(Exchange { write: body.clone(), ..Exchange::default() });
                        }
                        open.push((transaction, body));
                    }
                }
                Transfer::StreamRead(said) => {
                    came.extend(&said.bytes);
                    for (transaction, bytes) in frames.take(&mut came) {
                        let fits = |asked: &(u16, Body)| {
                            asked.0 == transaction && function(&asked.1) == function(&bytes)
                        };
                        let Some(index) = open.iter().rposition(fits) else { continue };
                        let (_, asked) = open.remove(index);
                        keep(&mut exchanges, asked, Said { at_s: said.at_s, bytes });
                    }
                }
            }
        }
        Self { frames, exchanges, at: 0, given: BTreeMap::new(), sent: Vec::new() }
    }

    fn answer(&mut self, asked: Body) -> Result<Option<Said>, String> {
        if only_asks(&asked) {
            return self.read(asked).map(Some);
        }
        let following = self.exchanges.iter().enumerate().skip(self.at + 1);
        for (index, exchange) in following {
            if exchange.write == asked {
                (self.at, self.given) = (index, BTreeMap::new());
                return Ok(exchange.reply.clone());
            }
            if single(&exchange.write).is_none() {
                break;
            }
        }
        let place = single(&asked);
        let known = self.exchanges.iter().rfind(|exchange| single(&exchange.write) == place);
        if let (Some(place), Some(known)) = (place, known) {
            let at_s = known.reply.as_ref().map_or(0.0, |said| said.at_s);
            return Ok(Some(Said { at_s, bytes: place.to_vec() }));
        }
        let expected = self.exchanges.get(self.at + 1);
        let then = expected.map_or("nothing".to_owned(), |next| words(&next.write));
        Err(format!("the capture does not know {} here: then it was {then}", words(&asked)))
    }

    fn read(&mut self, asked: Body) -> Result<Said, String> {
        let given = self.given.entry(asked.clone()).or_default();
        let count = *given;
        *given += 1;
        let here = self.exchanges.get(self.at).and_then(|exchange| exchange.reads.get(&asked));
        let now = here.and_then(|replies| replies.get(count).or(replies.last()));
        let before = || {
            let earlier = self.exchanges.iter().take(self.at).rev();
            earlier.filter_map(|exchange| exchange.reads.get(&asked)?.last()).next()
        };
        let unknown = || format!("the capture does not know {}", words(&asked));
        now.or_else(before).cloned().ok_or_else(unknown)
    }
}

fn keep(exchanges: &mut [Exchange], asked: Body, said: Said) {
    if only_asks(&asked) {
        if let Some(exchange) = exchanges.last_mut() {
            exchange.reads.entry(asked).or_default().push(said);
        }
    } else if let Some(exchange) = exchanges.iter_mut().rfind(|exchange| exchange.write == asked) {
        exchange.reply = Some(said);
    }
}

impl Script for Registers {
    fn hear(&mut self, bytes: &[u8]) -> Result<Vec<Said>, String> {
        self.sent.extend(bytes);
        let mut said = Vec::new();
        for (transaction, asked) in self.frames.take(&mut self.sent) {
            let reply = self.answer(asked)?;
            said.extend(reply.map(|Said { at_s, bytes }| Said {
                at_s,
                bytes: self.frames.frame(transaction, &bytes),
            }));
        }
        Ok(said)
    }
}

fn words(body: &[u8]) -> String {
    match body {
        [unit, function, a1, a0, n1, n0, values @ ..] => {
            let (address, count) = (u16::from_be_bytes([*a1, *a0]), u16::from_be_bytes([*n1, *n0]));
            let bytes = values.get(1..).unwrap_or_default();
            format!(
                "`unit {unit}, function {function}, address {address}, count {count}, bytes {}`",
                bytes.escape_ascii()
            )
        }
        other => format!("`{}`", other.escape_ascii()),
    }
}
