//! Replay of Modbus frames. Reads are queries; writes are commands. A write of a single register may be a
//! heartbeat, which depends on time: it is confirmed even if it is more or less frequent than in the capture.

use std::collections::BTreeMap;

use super::frames::{FrameBody, ModbusFraming};
use super::read::{CapturedLink, Transfer};
use super::{CapturedReply, LinkScript};

/// A write, and the reads until the next write.
#[derive(Default)]
struct WriteExchange {
    write: FrameBody,
    reply: Option<CapturedReply>,
    reads: BTreeMap<FrameBody, Vec<CapturedReply>>,
}

pub(super) struct RegisterScript {
    frames: ModbusFraming,
    /// The first exchange has no write.
    exchanges: Vec<WriteExchange>,
    current: usize,
    /// Number of replies to each read in this exchange.
    read_counts: BTreeMap<FrameBody, usize>,
    sent_bytes: Vec<u8>,
}

fn function_code(body: &[u8]) -> u8 {
    body.get(1).map_or(0, |code| code & 0x7F)
}

fn is_read(body: &[u8]) -> bool {
    matches!(function_code(body), 1..=4)
}

/// Unit, function, address and count of a write of a single register.
fn single_register_write(body: &[u8]) -> Option<&[u8]> {
    let count = body.get(4..6)?;
    (function_code(body) == 16 && count == [0, 1]).then(|| body.get(..6)).flatten()
}

impl RegisterScript {
    pub(super) fn new(track: &CapturedLink, frames: ModbusFraming) -> Self {
        let mut exchanges = vec![WriteExchange::default()];
        // Requests without a reply so far.
        let mut open_requests: Vec<(u16, FrameBody)> = Vec::new();
        let (mut sent, mut received) = (Vec::new(), Vec::new());
        for transfer in &track.transfers {
            match transfer {
                Transfer::Sent(bytes) => {
                    sent.extend(bytes);
                    received.clear();
                    for (transaction, body) in frames.split_frames(&mut sent) {
                        if !is_read(&body) {
                            exchanges.push(WriteExchange { write: body.clone(), ..WriteExchange::default() });
                        }
                        open_requests.push((transaction, body));
                    }
                }
                Transfer::Received(reply) => {
                    received.extend(&reply.bytes);
                    for (transaction, bytes) in frames.split_frames(&mut received) {
                        let is_request_of = |request: &(u16, FrameBody)| {
                            request.0 == transaction && function_code(&request.1) == function_code(&bytes)
                        };
                        let Some(index) = open_requests.iter().rposition(is_request_of) else {
                            continue;
                        };
                        let (_, request) = open_requests.remove(index);
                        store_reply(&mut exchanges, request, CapturedReply { time_s: reply.time_s, bytes });
                    }
                }
            }
        }
        Self { frames, exchanges, current: 0, read_counts: BTreeMap::new(), sent_bytes: Vec::new() }
    }

    fn reply_for(&mut self, request: FrameBody) -> Result<Option<CapturedReply>, String> {
        if is_read(&request) {
            return self.read(request).map(Some);
        }
        let following = self.exchanges.iter().enumerate().skip(self.current + 1);
        for (index, exchange) in following {
            if exchange.write == request {
                (self.current, self.read_counts) = (index, BTreeMap::new());
                return Ok(exchange.reply.clone());
            }
            if single_register_write(&exchange.write).is_none() {
                break;
            }
        }
        let write_header = single_register_write(&request);
        let earlier_write =
            self.exchanges.iter().rfind(|exchange| single_register_write(&exchange.write) == write_header);
        if let (Some(write_header), Some(earlier_write)) = (write_header, earlier_write) {
            let time_s = earlier_write.reply.as_ref().map_or(0.0, |reply| reply.time_s);
            return Ok(Some(CapturedReply { time_s, bytes: write_header.to_vec() }));
        }
        let expected = self.exchanges.get(self.current + 1);
        let expected_text = expected.map_or("nothing".to_owned(), |next| describe_request(&next.write));
        Err(format!(
            "the capture has no {} at this point; its next write is {expected_text}",
            describe_request(&request)
        ))
    }

    fn read(&mut self, request: FrameBody) -> Result<CapturedReply, String> {
        let read_count = self.read_counts.entry(request.clone()).or_default();
        let count = *read_count;
        *read_count += 1;
        let captured_replies = self.exchanges.get(self.current).and_then(|exchange| exchange.reads.get(&request));
        let reply = captured_replies.and_then(|replies| replies.get(count).or(replies.last()));
        let earlier_reply = || {
            let earlier = self.exchanges.iter().take(self.current).rev();
            earlier.filter_map(|exchange| exchange.reads.get(&request)?.last()).next()
        };
        let unknown = || format!("the capture has no {}", describe_request(&request));
        reply.or_else(earlier_reply).cloned().ok_or_else(unknown)
    }
}

fn store_reply(exchanges: &mut [WriteExchange], request: FrameBody, reply: CapturedReply) {
    if is_read(&request) {
        if let Some(exchange) = exchanges.last_mut() {
            exchange.reads.entry(request).or_default().push(reply);
        }
    } else if let Some(exchange) = exchanges.iter_mut().rfind(|exchange| exchange.write == request) {
        exchange.reply = Some(reply);
    }
}

impl LinkScript for RegisterScript {
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, String> {
        self.sent_bytes.extend(bytes);
        let mut replies = Vec::new();
        for (transaction, request) in self.frames.split_frames(&mut self.sent_bytes) {
            let reply = self.reply_for(request)?;
            replies.extend(reply.map(|CapturedReply { time_s, bytes }| CapturedReply {
                time_s,
                bytes: self.frames.build_frame(transaction, &bytes),
            }));
        }
        Ok(replies)
    }
}

fn describe_request(body: &[u8]) -> String {
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
