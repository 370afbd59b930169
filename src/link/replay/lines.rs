//! Replay of a protocol in lines. Single bytes are sent outside of lines; `?` requests a status report, a line in
//! `<` and `>` that may arrive at any time. A line that begins with `get ` is a query too; its reply arrives before
//! any other line.

use std::collections::BTreeMap;

use super::read::{CapturedLink, Transfer};
use super::{CapturedReply, LinkScript};

const STATUS_POLL: &[u8] = b"?";
/// Requests the status report with all fields from grblHAL.
const FULL_STATUS_POLL: &[u8] = b"\x87";
const QUERY_PREFIX: &[u8] = b"get ";

/// A command, and the data received until the next command.
#[derive(Default)]
struct CommandExchange {
    command: Vec<u8>,
    replies: Vec<CapturedReply>,
    /// Replies to each query; for a poll, the status reports.
    query_replies: BTreeMap<Vec<u8>, Vec<Vec<CapturedReply>>>,
}

pub(super) struct LineScript {
    /// The first exchange has no command: it holds what the device sends without a request.
    exchanges: Vec<CommandExchange>,
    /// Index of the current exchange; `None` before the first.
    current: Option<usize>,
    /// Number of replies to each query in the current exchange.
    reply_counts: BTreeMap<Vec<u8>, usize>,
    splitter: CommandSplitter,
}

impl LineScript {
    pub(super) fn new(track: &CapturedLink) -> Self {
        let mut exchanges = vec![CommandExchange::default()];
        let (mut splitter, mut partial_line, mut query) = (CommandSplitter::default(), Vec::new(), None);
        let mut poll = STATUS_POLL.to_vec();
        for transfer in &track.transfers {
            match transfer {
                Transfer::Sent(bytes) => {
                    for command in splitter.split(bytes) {
                        if is_poll(&command) {
                            poll = command;
                        } else if let (true, Some(exchange)) = (is_query(&command), exchanges.last_mut()) {
                            exchange.query_replies.entry(command.clone()).or_default().push(Vec::new());
                            query = Some(command);
                        } else {
                            exchanges.push(CommandExchange { command, ..CommandExchange::default() });
                            query = None;
                        }
                    }
                }
                Transfer::Received(reply) => {
                    partial_line.extend(&reply.bytes);
                    let Some(exchange) = exchanges.last_mut() else { continue };
                    while let Some(end) = partial_line.iter().position(|byte| *byte == b'\n') {
                        let bytes: Vec<u8> = partial_line.drain(..=end).collect();
                        exchange.store_line(query.as_deref(), &poll, CapturedReply { time_s: reply.time_s, bytes });
                    }
                }
            }
        }
        Self { exchanges, current: None, reply_counts: BTreeMap::new(), splitter: CommandSplitter::default() }
    }

    fn reply_for(&mut self, command: &[u8]) -> Result<Vec<CapturedReply>, String> {
        let next = self.current.map_or(0, |at| at + 1);
        match self.exchanges.get(next) {
            Some(exchange) if exchange.command == command => {
                (self.current, self.reply_counts) = (Some(next), BTreeMap::new());
                Ok(exchange.replies.clone())
            }
            expected => {
                let expected_text = expected.map_or("nothing".to_owned(), |next| describe_command(&next.command));
                Err(format!(
                    "the capture has no {} at this point; its next command is {expected_text}",
                    describe_command(command)
                ))
            }
        }
    }

    /// Next captured reply of this exchange to `query`; if there is none left, the last reply.
    fn next_query_reply(&mut self, query: &[u8]) -> Option<Vec<CapturedReply>> {
        let at = self.current?;
        let reply_count = self.reply_counts.entry(query.to_owned()).or_default();
        let captured_replies = self.exchanges.get(at)?.query_replies.get(query);
        let reply = captured_replies.and_then(|answers| answers.get(*reply_count).or(answers.last()));
        *reply_count += 1;
        let earlier_reply = || {
            let earlier = self.exchanges.iter().take(at).rev();
            earlier.filter_map(|exchange| exchange.query_replies.get(query)?.last()).next()
        };
        reply.or_else(earlier_reply).cloned()
    }
}

impl CommandExchange {
    /// Stores a received line. `poll` is the last poll that was sent.
    fn store_line(&mut self, query: Option<&[u8]>, poll: &[u8], reply: CapturedReply) {
        let is_report = reply.bytes.starts_with(b"<") && reply.bytes.trim_ascii_end().ends_with(b">");
        if is_report {
            return self.query_replies.entry(poll.to_owned()).or_default().push(vec![reply]);
        }
        let answers = query.and_then(|query| self.query_replies.get_mut(query)?.last_mut());
        answers.unwrap_or(&mut self.replies).push(reply);
    }
}

fn is_poll(command: &[u8]) -> bool {
    command == STATUS_POLL || command == FULL_STATUS_POLL
}

fn is_query(command: &[u8]) -> bool {
    command.starts_with(QUERY_PREFIX)
}

impl LinkScript for LineScript {
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, String> {
        let mut replies = Vec::new();
        if self.current.is_none() {
            replies.extend(self.reply_for(&[])?);
        }
        for command in self.splitter.split(bytes) {
            replies.extend(match () {
                // The control has sent no status report so far.
                () if is_poll(&command) => self.next_query_reply(&command).unwrap_or_default(),
                () if is_query(&command) => self
                    .next_query_reply(&command)
                    .ok_or_else(|| format!("the capture has no {}", describe_command(&command)))?,
                () => self.reply_for(&command)?,
            });
        }
        Ok(replies)
    }
}

fn describe_command(command: &[u8]) -> String {
    format!("`{}`", command.trim_ascii_end().escape_ascii())
}

/// Splits sent bytes into lines and single bytes outside of lines.
#[derive(Default)]
struct CommandSplitter {
    line: Vec<u8>,
}

impl CommandSplitter {
    fn split(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut pieces = Vec::new();
        for byte in bytes {
            let is_single = matches!(byte, b'?' | b'!' | b'~' | 0..=0x08 | 0x0E..=0x1F | 0x80..);
            if self.line.is_empty() && is_single {
                pieces.push(vec![*byte]);
                continue;
            }
            self.line.push(*byte);
            if *byte == b'\n' {
                pieces.push(std::mem::take(&mut self.line));
            }
        }
        pieces
    }
}
