//! Captured commands, with the replies to the queries between two commands; the same for all protocols.

use std::collections::BTreeMap;

use super::CapturedReply;

/// A command, and the data received until the next command.
#[derive(Default)]
pub(super) struct CommandExchange {
    /// Bytes of the command; empty in the first exchange of a link.
    pub(super) command: Vec<u8>,
    /// Data received until the next command, without the replies to queries.
    pub(super) replies: Vec<CapturedReply>,
    /// Replies to each query that was sent after this command: one entry per reply, in order.
    pub(super) query_replies: BTreeMap<Vec<u8>, Vec<Vec<CapturedReply>>>,
}

/// All exchanges of a link. The first one has no command: it holds the data received before the first command.
pub(super) struct ExchangeHistory {
    exchanges: Vec<CommandExchange>,
    /// Index of the exchange of the last replayed command.
    current_index: usize,
    /// Number of replies to each query that the replay has returned since the current command.
    returned_reply_counts: BTreeMap<Vec<u8>, usize>,
}

impl ExchangeHistory {
    pub(super) fn new() -> Self {
        Self { exchanges: vec![CommandExchange::default()], current_index: 0, returned_reply_counts: BTreeMap::new() }
    }

    /// Adds a captured command; the data added from now on follow it.
    pub(super) fn push_command(&mut self, command: Vec<u8>) {
        self.exchanges.push(CommandExchange { command, ..CommandExchange::default() });
    }

    /// Adds a captured reply to `query` to the exchange of the last captured command.
    pub(super) fn push_query_reply(&mut self, query: &[u8], reply: Vec<CapturedReply>) {
        if let Some(exchange) = self.exchanges.last_mut() {
            exchange.query_replies.entry(query.to_owned()).or_default().push(reply);
        }
    }

    /// The exchange of the last captured command.
    pub(super) fn last_exchange_mut(&mut self) -> Option<&mut CommandExchange> {
        self.exchanges.last_mut()
    }

    /// The exchange of the last captured command that meets `condition`.
    pub(super) fn rfind_exchange_mut(&mut self, condition: impl Fn(&[u8]) -> bool) -> Option<&mut CommandExchange> {
        self.exchanges.iter_mut().rfind(|exchange| condition(&exchange.command))
    }

    /// The exchanges after the current one.
    pub(super) fn following_exchanges(&self) -> &[CommandExchange] {
        self.exchanges.get(self.current_index + 1..).unwrap_or_default()
    }

    /// Makes the exchange at `index` of [`Self::following_exchanges`] the current one; returns the replies to its
    /// command.
    pub(super) fn advance_to_following(&mut self, index: usize) -> Vec<CapturedReply> {
        (self.current_index, self.returned_reply_counts) = (self.current_index + 1 + index, BTreeMap::new());
        self.current_replies()
    }

    /// Replies to the command of the current exchange.
    pub(super) fn current_replies(&self) -> Vec<CapturedReply> {
        self.exchanges.get(self.current_index).map(|exchange| exchange.replies.clone()).unwrap_or_default()
    }

    /// Next captured reply to `query` after the current command; if all are used, the last of them. `None`: the
    /// capture has no reply to `query` between the current and the next command.
    pub(super) fn reply_since_current_command(&mut self, query: &[u8]) -> Option<Vec<CapturedReply>> {
        let reply_count = self.returned_reply_counts.entry(query.to_owned()).or_default();
        let captured_replies = self.exchanges.get(self.current_index)?.query_replies.get(query);
        let reply = captured_replies.and_then(|replies| replies.get(*reply_count).or(replies.last()));
        *reply_count += 1;
        reply.cloned()
    }

    /// Like [`Self::reply_since_current_command`]; without a reply after the current command, the last earlier reply.
    pub(super) fn reply_to_query(&mut self, query: &[u8]) -> Option<Vec<CapturedReply>> {
        let reply = self.reply_since_current_command(query);
        let mut earlier = self.exchanges.iter().take(self.current_index).rev();
        reply.or_else(|| earlier.find_map(|exchange| exchange.query_replies.get(query)?.last().cloned()))
    }
}
