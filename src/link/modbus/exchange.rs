//! One request and its reply, and the clearing of the line before the next request.

use std::time::Duration;

use tokio::time::{sleep, timeout};
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::{Response, Slave};

use super::drainable_stream::DrainableStream;
use super::register_access::{RegisterAccess, ReplyShape};
use super::urgent_queue::UrgentQueue;
use super::{DeviceSettings, Framing, ModbusError, ModbusLineConfig};
use crate::link_mode::LinkBackend;

/// Maximum time for which a hold waits for a pending TCP reply.
const MAX_HOLD_WAIT_FOR_TCP_REPLY: Duration = Duration::from_millis(20);
/// Maximum number of test reads that check whether the line is clear, before one request.
const MAX_TEST_READS: usize = 3;

/// Connection of one line, and the replies that may still arrive on it.
pub(super) struct ModbusExchange {
    line: ModbusLineConfig,
    backend: LinkBackend,
    /// Urgent writes. A queued urgent write shortens the wait for a TCP reply, and ends the clearing of an RTU line.
    pub(super) urgent_queue: UrgentQueue,
    /// Open stream; `None`: closed, and the next request opens the connection.
    stream: Option<DrainableStream>,
    /// Over TCP, the context lives as long as the connection, because it holds the transaction numbers. On RTU, each
    /// request gets a new one.
    context: Option<Context>,
    /// Replies that may still arrive (RTU).
    pending_replies: Vec<ReplyShape>,
    /// Shape of the reply to the last request that was sent, to any unit. On RTU, bytes that arrive without a request
    /// may be this reply, sent twice.
    last_expected_reply_shape: Option<ReplyShape>,
}

/// Result of one call.
enum CallOutcome {
    /// Result of tokio-modbus before the time limit: a reply, an exception, or an error of the transport.
    Ended(tokio_modbus::Result<Response>),
    /// No reply within this time: the time limit of the device, or the shorter one of a hold over TCP.
    NoReplyWithin(Duration),
}

impl ModbusExchange {
    pub(super) fn new(line: ModbusLineConfig, backend: LinkBackend, urgent_queue: UrgentQueue) -> Self {
        Self {
            line,
            backend,
            urgent_queue,
            stream: None,
            context: None,
            pending_replies: Vec::new(),
            last_expected_reply_shape: None,
        }
    }

    /// # Errors
    /// The connection cannot be opened.
    pub(super) async fn open(&mut self) -> Result<(), ModbusError> {
        self.stream = Some(self.line.open(&self.backend).await?);
        Ok(())
    }

    /// Clears the line, sends `access` once, and returns the register values of the reply; empty for a write.
    pub(super) async fn perform(
        &mut self,
        access: &RegisterAccess,
        settings: &DeviceSettings,
    ) -> Result<Vec<u16>, ModbusError> {
        self.prepare_connection().await?;
        self.clear_line(access, settings).await?;
        self.send_request(access, settings).await
    }

    /// Like `perform`, without the test reads that clear the line. RTU still waits for the silence between two frames.
    pub(super) async fn perform_urgent(&mut self, access: &RegisterAccess, settings: &DeviceSettings) {
        // A failure is not reported: only the device can show whether the write has arrived.
        if self.prepare_connection().await.is_ok() {
            let _ = self.send_request(access, settings).await;
        }
    }

    /// Opens the connection if it is closed. RTU: drops bytes until the line is silent; such bytes may be a repeated
    /// reply. TCP: does not wait; reopens the connection if bytes have arrived without a request.
    async fn prepare_connection(&mut self) -> Result<(), ModbusError> {
        if let Some(stream) = &mut self.stream {
            let drained = match self.line.framing {
                Framing::Rtu => stream.drain_until_silent(self.line.frame_silence()).await,
                Framing::Tcp => stream.discard_arrived_bytes().await,
            };
            match (drained, self.line.framing) {
                (Ok(0), _) => return Ok(()),
                (Ok(_), Framing::Rtu) => {
                    // Bytes arrived without a request: perhaps the last reply was sent twice.
                    self.pending_replies.extend(self.last_expected_reply_shape);
                    return Ok(());
                }
                // The idle connection was closed, or bytes arrived without a request.
                _ => self.close_connection(),
            }
        }
        self.open().await?;
        if let (Some(stream), Framing::Rtu) = (&mut self.stream, self.line.framing) {
            // Drops bytes that the port held before it was opened.
            let _ = stream.drain_until_silent(self.line.frame_silence()).await;
        }
        Ok(())
    }

    fn close_connection(&mut self) {
        self.context = None;
        self.stream = None;
    }

    /// A permitted read whose reply cannot be confused with any pending reply; `None`: there is none.
    fn choose_test_read(&self, settings: &DeviceSettings) -> Option<RegisterAccess> {
        let mut test_reads = settings.access_list.reads_of_distinct_reply_length();
        test_reads.find(|test_read| !self.pending_replies.contains(&test_read.reply_shape(settings.unit)))
    }

    fn has_pending_reply(&self, unit: u8) -> bool {
        self.pending_replies.iter().any(|reply| reply.unit == unit)
    }

    fn forget_pending_replies(&mut self, unit: u8) {
        self.pending_replies.retain(|reply| reply.unit != unit);
    }

    /// RTU: if replies of the unit are pending, sends test reads whose reply differs from all of them. None of them can
    /// follow that reply.
    ///
    /// # Errors
    /// `LineNotCleared`: replies may still arrive, after all test reads or because a hold interrupts.
    async fn clear_line(&mut self, access: &RegisterAccess, settings: &DeviceSettings) -> Result<(), ModbusError> {
        let unit = settings.unit;
        let mut why = String::new();
        for _ in 0..MAX_TEST_READS {
            if !self.has_pending_reply(unit) {
                return Ok(());
            }
            match self.choose_test_read(settings) {
                None => self.wait_for_pending_replies(settings).await,
                Some(test_read) => {
                    if let Some(error) = self.send_test_read(&test_read, settings).await {
                        why = error.to_string();
                        if !matches!(error, ModbusError::UnexpectedReply { .. }) {
                            break;
                        }
                    }
                    self.drain_until_silent_or_urgent(self.line.frame_silence()).await;
                }
            }
            if self.urgent_queue.has_write() {
                why = "a hold interrupts the request".to_owned();
                break;
            }
        }
        if !self.has_pending_reply(unit) {
            return Ok(());
        }
        Err(ModbusError::LineNotCleared { request: access.to_string(), why })
    }

    /// Waits for a silence as long as the device's time limit; then no reply of the unit counts as pending. For a
    /// device of which no test read has a distinguishable reply. An urgent write ends the wait, and the replies stay
    /// pending.
    async fn wait_for_pending_replies(&mut self, settings: &DeviceSettings) {
        self.stream.iter().for_each(DrainableStream::restart_silence_timer);
        self.drain_until_silent_or_urgent(settings.timeout).await;
        if !self.urgent_queue.has_write() {
            self.forget_pending_replies(settings.unit);
        }
    }

    /// Sends one test read of `clear_line`; returns its error, if any. An exception reply is an answer, not an error.
    async fn send_test_read(&mut self, test_read: &RegisterAccess, settings: &DeviceSettings) -> Option<ModbusError> {
        let shape = test_read.reply_shape(settings.unit);
        let ambiguous = self.pending_replies.iter().any(|reply| reply.has_same_unit_and_function(shape));
        match self.send_request(test_read, settings).await {
            Err(ModbusError::ExceptionReply { .. }) if ambiguous => self.pending_replies.push(shape),
            Ok(_) | Err(ModbusError::ExceptionReply { .. }) => self.forget_pending_replies(settings.unit),
            Err(error) => {
                if matches!(error, ModbusError::UnexpectedReply { .. }) {
                    // The reply belongs to an older request; the reply to the test read may still arrive.
                    self.drain_until_silent_or_urgent(settings.timeout).await;
                }
                return Some(error);
            }
        }
        None
    }

    /// Drops incoming bytes until `silence` has passed without a byte, or until an urgent write is queued.
    async fn drain_until_silent_or_urgent(&mut self, silence: Duration) {
        let Some(stream) = &mut self.stream else { return };
        // Both futures can be dropped: the bytes read are discarded in any case.
        let ended = tokio::select! {
            biased;
            () = self.urgent_queue.wait_for_write() => return,
            ended = stream.drain_until_silent(silence) => ended,
        };
        if ended.is_err() {
            self.close_connection();
        }
    }

    /// Sends the request once. Without a valid reply, RTU counts the reply as pending, and TCP closes the connection.
    async fn send_request(
        &mut self,
        access: &RegisterAccess,
        settings: &DeviceSettings,
    ) -> Result<Vec<u16>, ModbusError> {
        let shape = access.reply_shape(settings.unit);
        let request = access.to_string();
        self.last_expected_reply_shape = Some(shape);
        let unexpected_reply = |why| ModbusError::UnexpectedReply { request: request.clone(), why };
        let error = match self.call_device(access, settings).await {
            CallOutcome::Ended(Ok(Ok(reply))) => match access.decode_reply(reply) {
                Ok(words) => return Ok(words),
                Err(error) => error,
            },
            CallOutcome::Ended(Ok(Err(exception))) => {
                let function = access.to_pdu().function_code().value();
                return Err(ModbusError::ExceptionReply { request, function, code: exception.into() });
            }
            CallOutcome::Ended(Err(tokio_modbus::Error::Protocol(error))) => unexpected_reply(error.to_string()),
            CallOutcome::Ended(Err(tokio_modbus::Error::Transport(error)))
                if error.kind() == std::io::ErrorKind::InvalidData =>
            {
                unexpected_reply(error.to_string())
            }
            CallOutcome::Ended(Err(tokio_modbus::Error::Transport(error))) => {
                let why = self.loss_reason(error).await;
                self.stream = None;
                ModbusError::ConnectionLost { request, why }
            }
            CallOutcome::NoReplyWithin(timeout) => ModbusError::Timeout { request, timeout },
        };
        self.context = None;
        match self.line.framing {
            Framing::Rtu => self.pending_replies.push(shape),
            Framing::Tcp => self.stream = None,
        }
        Err(error)
    }

    /// Calls the device once, within its time limit. Over TCP, a queued urgent write shortens the wait to 20 ms.
    async fn call_device(&mut self, access: &RegisterAccess, settings: &DeviceSettings) -> CallOutcome {
        let Some(stream) = &self.stream else {
            let closed = std::io::Error::from(std::io::ErrorKind::NotConnected);
            return CallOutcome::Ended(Err(closed.into()));
        };
        let unit = Slave(settings.unit);
        let framing = self.line.framing;
        let context = match framing {
            // Each request gets a new decoder, without bytes of earlier requests.
            Framing::Rtu => self.context.insert(rtu::attach_slave(stream.clone(), unit)),
            Framing::Tcp => self.context.get_or_insert_with(|| tcp::attach_slave(stream.clone(), unit)),
        };
        let hold_deadline = async {
            self.urgent_queue.wait_for_write().await;
            sleep(MAX_HOLD_WAIT_FOR_TCP_REPLY).await;
        };
        // After a dropped call, `send_request` also drops the context.
        tokio::select! {
            biased;
            replied = timeout(settings.timeout, context.call(access.to_pdu())) => {
                replied.map_or(CallOutcome::NoReplyWithin(settings.timeout), CallOutcome::Ended)
            }
            () = hold_deadline, if framing == Framing::Tcp => CallOutcome::NoReplyWithin(MAX_HOLD_WAIT_FOR_TCP_REPLY),
        }
    }

    /// Reason for the lost connection. tokio-modbus reports a closed stream by the last error of the operating
    /// system.
    async fn loss_reason(&mut self, error: std::io::Error) -> String {
        let Some(stream) = &mut self.stream else { return error.to_string() };
        match stream.discard_arrived_bytes().await {
            Err(closed) => closed.to_string(),
            Ok(_) => error.to_string(),
        }
    }
}
