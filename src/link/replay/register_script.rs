//! Replay of Modbus frames. Reads are queries; writes are commands. A write of a single register may be a
//! heartbeat, which depends on time: it is confirmed even if it is more or less frequent than in the capture.

use super::capture_parser::{CapturedLink, Transfer};
use super::exchange_history::ExchangeHistory;
use super::modbus_frames::FrameBody;
use super::{CapturedReply, LinkScript, ReplayError};
use crate::modbus::Framing;

/// The commands are the bodies of writes, the queries the bodies of reads.
pub(super) struct RegisterScript {
    framing: Framing,
    history: ExchangeHistory,
    /// Sent bytes that do not yet form a complete frame.
    sent_bytes: Vec<u8>,
}

/// Function code without the exception bit; 0 if the body has none.
fn function_code(body: &[u8]) -> u8 {
    body.get(1).map_or(0, |code| code & 0x7F)
}

fn is_read_request(body: &[u8]) -> bool {
    matches!(function_code(body), 1..=4)
}

/// Unit, function, address and count of a write (function 16) of a single register; `None`: another request.
fn single_register_write_header(body: &[u8]) -> Option<&[u8]> {
    let count = body.get(4..6)?;
    (function_code(body) == 16 && count == [0, 1]).then(|| body.get(..6)).flatten()
}

impl RegisterScript {
    pub(super) fn new(captured: &CapturedLink, framing: Framing) -> Self {
        let mut history = ExchangeHistory::new();
        // Requests without a reply so far.
        let mut open_requests: Vec<(u16, FrameBody)> = Vec::new();
        let (mut sent, mut received) = (Vec::new(), Vec::new());
        for transfer in &captured.transfers {
            match transfer {
                Transfer::Sent(bytes) => {
                    sent.extend(bytes);
                    received.clear();
                    for (transaction, body) in framing.take_complete_frames(&mut sent) {
                        if !is_read_request(&body) {
                            history.push_command(body.clone());
                        }
                        open_requests.push((transaction, body));
                    }
                }
                Transfer::Received(reply) => {
                    received.extend(&reply.bytes);
                    for (transaction, bytes) in framing.take_complete_frames(&mut received) {
                        let is_request_of = |request: &(u16, FrameBody)| {
                            request.0 == transaction && function_code(&request.1) == function_code(&bytes)
                        };
                        let Some(index) = open_requests.iter().rposition(is_request_of) else { continue };
                        let (_, request) = open_requests.remove(index);
                        store_reply(&mut history, &request, CapturedReply { time_s: reply.time_s, bytes });
                    }
                }
            }
        }
        Self { framing, history, sent_bytes: Vec::new() }
    }

    /// Replies to one request. A write must be the next captured write, after any captured writes of a single
    /// register; another write of a single register is confirmed if the capture contains a write of this register.
    fn reply_to_request(&mut self, request: &[u8]) -> Result<Vec<CapturedReply>, ReplayError> {
        if is_read_request(request) {
            let unknown = || ReplayError::UnknownRequest { request: describe_request(request) };
            return self.history.reply_to_query(request).ok_or_else(unknown);
        }
        for (index, exchange) in self.history.following_exchanges().iter().enumerate() {
            if exchange.command == request {
                return Ok(self.history.advance_to_following(index));
            }
            if single_register_write_header(&exchange.command).is_none() {
                break;
            }
        }
        if let Some(header) = single_register_write_header(request)
            && let Some(captured) =
                self.history.rfind_exchange_mut(|write| single_register_write_header(write) == Some(header))
        {
            let time_s = captured.replies.first().map_or(0.0, |reply| reply.time_s);
            return Ok(vec![CapturedReply { time_s, bytes: header.to_vec() }]);
        }
        let next = self.history.following_exchanges().first();
        let next = next.map_or("nothing".to_owned(), |next| describe_request(&next.command));
        Err(ReplayError::UnexpectedWrite { write: describe_request(request), next })
    }
}

/// Stores a captured reply. The reply to a write belongs to the last captured write that equals `request`.
fn store_reply(history: &mut ExchangeHistory, request: &[u8], reply: CapturedReply) {
    if is_read_request(request) {
        history.push_query_reply(request, vec![reply]);
    } else if let Some(exchange) = history.rfind_exchange_mut(|write| write == request) {
        exchange.replies = vec![reply];
    }
}

impl LinkScript for RegisterScript {
    /// Replies to all requests that `bytes` completes, with the transaction numbers of these requests.
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, ReplayError> {
        self.sent_bytes.extend(bytes);
        let mut replies = Vec::new();
        for (transaction, sample_request) in self.framing.take_complete_frames(&mut self.sent_bytes) {
            for CapturedReply { time_s, bytes } in self.reply_to_request(&sample_request)? {
                replies.push(CapturedReply { time_s, bytes: self.framing.build_frame(transaction, &bytes) });
            }
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
