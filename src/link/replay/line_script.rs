//! Replay of a protocol in lines. Single bytes are sent outside of lines; `?` requests a status report (a line enclosed
//! in `<` and `>`), which may arrive at any time. A line that begins with `get ` is a query too; its reply arrives
//! before any other line.

use super::capture_parser::{CapturedLink, Transfer};
use super::exchange_history::ExchangeHistory;
use super::{CapturedReply, LinkScript, ReplayError};

const STATUS_POLL: &[u8] = b"?";
/// Requests the status report with all fields from grblHAL.
const FULL_STATUS_POLL: &[u8] = b"\x87";
const QUERY_PREFIX: &[u8] = b"get ";

pub(super) struct LineScript {
    history: ExchangeHistory,
    /// Whether the lines that the device sent before the first command are already replayed.
    has_replayed_initial_lines: bool,
    splitter: CommandSplitter,
}

impl LineScript {
    pub(super) fn new(captured: &CapturedLink) -> Self {
        let mut history = ExchangeHistory::new();
        let (mut splitter, mut partial_line, mut query) = (CommandSplitter::default(), Vec::new(), None);
        let mut poll = STATUS_POLL.to_vec();
        for transfer in &captured.transfers {
            match transfer {
                Transfer::Sent(bytes) => {
                    for command in splitter.split_commands(bytes) {
                        if is_status_poll(&command) {
                            poll = command;
                        } else if is_query(&command) {
                            history.push_query_reply(&command, Vec::new());
                            query = Some(command);
                        } else {
                            history.push_command(command);
                            query = None;
                        }
                    }
                }
                Transfer::Received(reply) => {
                    partial_line.extend(&reply.bytes);
                    while let Some(end) = partial_line.iter().position(|byte| *byte == b'\n') {
                        let bytes: Vec<u8> = partial_line.drain(..=end).collect();
                        let line = CapturedReply { time_s: reply.time_s, bytes };
                        store_received_line(&mut history, query.as_deref(), &poll, line);
                    }
                }
            }
        }
        Self { history, has_replayed_initial_lines: false, splitter: CommandSplitter::default() }
    }

    /// Replies to a command that is neither poll nor query: it must be the next captured command.
    fn reply_to_command(&mut self, command: &[u8]) -> Result<Vec<CapturedReply>, ReplayError> {
        match self.history.following_exchanges().first() {
            Some(next) if next.command == command => Ok(self.history.advance_to_following(0)),
            next => {
                let next = next.map_or("nothing".to_owned(), |next| describe_command(&next.command));
                Err(ReplayError::UnexpectedCommand { command: describe_command(command), next })
            }
        }
    }
}

/// Stores a received line. `query` and `poll` are the last ones that were sent.
fn store_received_line(history: &mut ExchangeHistory, query: Option<&[u8]>, poll: &[u8], line: CapturedReply) {
    let is_report = line.bytes.starts_with(b"<") && line.bytes.trim_ascii_end().ends_with(b">");
    if is_report {
        return history.push_query_reply(poll, vec![line]);
    }
    let Some(exchange) = history.last_exchange_mut() else { return };
    let answers = query.and_then(|query| exchange.query_replies.get_mut(query)?.last_mut());
    answers.unwrap_or(&mut exchange.replies).push(line);
}

fn is_status_poll(command: &[u8]) -> bool {
    command == STATUS_POLL || command == FULL_STATUS_POLL
}

fn is_query(command: &[u8]) -> bool {
    command.starts_with(QUERY_PREFIX)
}

impl LinkScript for LineScript {
    /// Replies to all commands that `bytes` completes. The first call also returns the lines that the device sent
    /// before the first command.
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, ReplayError> {
        let mut replies = Vec::new();
        if !std::mem::replace(&mut self.has_replayed_initial_lines, true) {
            replies.extend(self.history.current_replies());
        }
        for command in self.splitter.split_commands(bytes) {
            replies.extend(match () {
                // Without a captured status report up to this command, nothing is returned.
                () if is_status_poll(&command) => self.history.reply_to_query(&command).unwrap_or_default(),
                () if is_query(&command) => self
                    .history
                    .reply_to_query(&command)
                    .ok_or_else(|| ReplayError::UnknownRequest { request: describe_command(&command) })?,
                () => self.reply_to_command(&command)?,
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
    partial_line: Vec<u8>,
}

impl CommandSplitter {
    /// Returns the complete lines (with line feed) and single bytes, in order; keeps an incomplete line.
    fn split_commands(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut pieces = Vec::new();
        for byte in bytes {
            let is_single = matches!(byte, b'?' | b'!' | b'~' | 0..=0x08 | 0x0E..=0x1F | 0x80..);
            if self.partial_line.is_empty() && is_single {
                pieces.push(vec![*byte]);
                continue;
            }
            self.partial_line.push(*byte);
            if *byte == b'\n' {
                pieces.push(std::mem::take(&mut self.partial_line));
            }
        }
        pieces
    }
}
