//! Replay of shared files. A read is a query; a written text must equal the captured text. A read sends the name of
//! the file; the reply is the name and, after a line feed, the text of the file.

use super::capture_parser::{CapturedLink, Transfer};
use super::exchange_history::ExchangeHistory;
use super::{CapturedReply, LinkScript, ReplayError};

/// A command is a written file: its name, a line feed, its text.
pub(super) struct FileScript(ExchangeHistory);

/// Name of the file in an entry: the text before the first line feed.
fn file_name(entry: &[u8]) -> &[u8] {
    entry.split(|byte| *byte == b'\n').next().unwrap_or_default()
}

impl FileScript {
    pub(super) fn new(captured: &CapturedLink) -> Self {
        let mut history = ExchangeHistory::new();
        for transfer in &captured.transfers {
            match transfer {
                Transfer::Sent(written) => history.push_command(written.clone()),
                Transfer::Received(reply) => history.push_query_reply(file_name(&reply.bytes), vec![reply.clone()]),
            }
        }
        Self(history)
    }
}

impl LinkScript for FileScript {
    /// Bytes without a line feed are the name of a file that is read. Others are a written file, which must be the next
    /// captured one.
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, ReplayError> {
        if bytes.is_empty() {
            return Ok(Vec::new());
        }
        if !bytes.contains(&b'\n') {
            // Without captured content after the last written text, the file does not exist: the reply is its name.
            let missing = || vec![CapturedReply { time_s: 0.0, bytes: bytes.to_owned() }];
            return Ok(self.0.reply_since_current_command(bytes).unwrap_or_else(missing));
        }
        match self.0.following_exchanges().first() {
            Some(next) if next.command == bytes => Ok(self.0.advance_to_following(0)),
            next => {
                let captured = next.map_or("nothing".to_owned(), |next| first_differing_line(&next.command, bytes));
                Err(ReplayError::DifferentText { file: file_name(bytes).escape_ascii().to_string(), captured })
            }
        }
    }
}

/// First line of `captured` that differs from `written`; `shorter` if `captured` has no such line.
fn first_differing_line(captured: &[u8], written: &[u8]) -> String {
    let mut written = written.split(|byte| *byte == b'\n');
    let difference = captured.split(|byte| *byte == b'\n').find(|line| written.next() != Some(*line));
    difference.map_or("shorter".to_owned(), |line| format!("`{}`", line.escape_ascii()))
}
