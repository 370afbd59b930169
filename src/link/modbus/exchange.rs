//! One request and its reply, and the clearing of the line before the next request.

use std::time::Duration;

use tokio::time::{sleep, timeout};
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::{Response, Slave};

use super::ask::{Ask, Shape};
use super::inbox::Inbox;
use super::wire::Wire;
use super::{Framing, Line, ModbusError, Settings};
use crate::wiring::Wired;

/// Maximum time for which a hold waits for a pending TCP reply.
const HOLD_REPLY_WAIT: Duration = Duration::from_millis(20);
/// Maximum number of test reads that check whether the line is clear, before one request.
const MAX_CLEAR_READS: usize = 3;

/// The connection, and the replies that it still owes.
pub(super) struct Exchange {
    line: Line,
    wired: Wired,
    wire: Option<Wire>,
    /// Over TCP, the context lives as long as the connection, because it holds the transaction numbers.
    context: Option<Context>,
    /// Requests whose replies may still arrive (RTU).
    owed: Vec<Shape>,
    latest: Option<Shape>,
}

/// Result of one call.
enum End {
    Replied(tokio_modbus::Result<Response>),
    Late(Duration),
}

impl Exchange {
    pub(super) fn new(line: Line, wired: Wired) -> Self {
        Self { line, wired, wire: None, context: None, owed: Vec::new(), latest: None }
    }

    /// # Errors
    /// The connection cannot be opened.
    pub(super) async fn open(&mut self) -> Result<(), ModbusError> {
        self.wire = Some(self.line.open(&self.wired).await?);
        Ok(())
    }

    /// Clears the line, sends `ask` once, and returns the register values of the reply.
    pub(super) async fn perform(
        &mut self,
        ask: &Ask,
        settings: &Settings,
        inbox: &mut Inbox,
    ) -> Result<Vec<u16>, ModbusError> {
        self.wait_for_silence().await?;
        self.clear(ask, settings, inbox).await?;
        self.send(ask, settings, inbox).await
    }

    /// Like `perform`, without clearing the line first: a hold does not wait.
    pub(super) async fn perform_now(&mut self, ask: &Ask, settings: &Settings, inbox: &mut Inbox) {
        // Only the device can show whether the write has arrived.
        if self.wait_for_silence().await.is_ok() {
            let _ = self.send(ask, settings, inbox).await;
        }
    }

    /// Opens the connection if necessary, and waits until the line is silent.
    async fn wait_for_silence(&mut self) -> Result<(), ModbusError> {
        if let Some(wire) = &mut self.wire {
            let drained = match self.line.framing {
                Framing::Rtu => wire.drain(self.line.silence()).await,
                Framing::Tcp => wire.skim().await,
            };
            match (drained, self.line.framing) {
                (Ok(0), _) => return Ok(()),
                (Ok(_), Framing::Rtu) => {
                    // Bytes arrived without a request: perhaps the last reply was sent twice.
                    self.owed.extend(self.latest);
                    return Ok(());
                }
                // The idle connection was closed, or bytes arrived without a request.
                _ => self.close(),
            }
        }
        self.open().await?;
        if let (Some(wire), Framing::Rtu) = (&mut self.wire, self.line.framing) {
            // Drops bytes that the port held before it was opened.
            let _ = wire.drain(self.line.silence()).await;
        }
        Ok(())
    }

    fn close(&mut self) {
        self.context = None;
        self.wire = None;
    }

    /// A read whose reply cannot be confused with any reply that is owed.
    fn probe(&self, settings: &Settings) -> Option<Ask> {
        let mut probes = settings.allowed.small_reads();
        probes.find(|probe| !self.owed.contains(&probe.shape(settings.unit)))
    }

    fn is_owed_by(&self, unit: u8) -> bool {
        self.owed.iter().any(|owed| owed.unit == unit)
    }

    fn forget_owed_by(&mut self, unit: u8) {
        self.owed.retain(|owed| owed.unit != unit);
    }

    /// RTU: sends a read of a shape that is not owed. Its reply proves that no owed reply of this unit can follow.
    async fn clear(
        &mut self,
        ask: &Ask,
        settings: &Settings,
        inbox: &mut Inbox,
    ) -> Result<(), ModbusError> {
        let unit = settings.unit;
        let mut why = String::new();
        for _ in 0..MAX_CLEAR_READS {
            if !self.is_owed_by(unit) {
                return Ok(());
            }
            let Some(probe) = self.probe(settings) else {
                self.wait_for_owed_replies(settings, inbox).await;
                if inbox.has_come() {
                    why = "a hold goes first".to_owned();
                    break;
                }
                return Ok(());
            };
            if let Some(error) = self.ask_whether_clear(&probe, settings, inbox).await {
                why = error.to_string();
                if !matches!(error, ModbusError::Misfit { .. }) {
                    break;
                }
            }
            self.wait_quietly(self.line.silence(), inbox).await;
            if inbox.has_come() {
                why = "a hold goes first".to_owned();
                break;
            }
        }
        if !self.is_owed_by(unit) {
            return Ok(());
        }
        Err(ModbusError::Unclear { request: ask.to_string(), why })
    }

    /// Waits for a long silence, because no test read can distinguish the owed replies. An urgent write ends the
    /// wait.
    async fn wait_for_owed_replies(&mut self, settings: &Settings, inbox: &mut Inbox) {
        self.wire.iter().for_each(Wire::hush);
        self.wait_quietly(settings.timeout, inbox).await;
        if !inbox.has_come() {
            self.forget_owed_by(settings.unit);
        }
    }

    /// Sends one test read of `clear`; returns its error, if any.
    async fn ask_whether_clear(
        &mut self,
        probe: &Ask,
        settings: &Settings,
        inbox: &mut Inbox,
    ) -> Option<ModbusError> {
        let shape = probe.shape(settings.unit);
        let ambiguous = self.owed.iter().any(|owed| owed.has_function_of(shape));
        match self.send(probe, settings, inbox).await {
            Err(ModbusError::Refused { .. }) if ambiguous => self.owed.push(shape),
            Ok(_) | Err(ModbusError::Refused { .. }) => self.forget_owed_by(settings.unit),
            Err(error) => {
                if matches!(error, ModbusError::Misfit { .. }) {
                    // The reply belongs to an older request; the reply to the test read may still arrive.
                    self.wait_quietly(settings.timeout, inbox).await;
                }
                return Some(error);
            }
        }
        None
    }

    /// Drops incoming bytes until `silence` has passed without a byte, or until an urgent write is queued.
    async fn wait_quietly(&mut self, silence: Duration, inbox: &mut Inbox) {
        let Some(wire) = &mut self.wire else { return };
        // Both futures can be dropped: the bytes read are discarded in any case.
        let ended = tokio::select! {
            biased;
            () = inbox.come() => return,
            ended = wire.drain(silence) => ended,
        };
        if ended.is_err() {
            self.close();
        }
    }

    async fn send(
        &mut self,
        ask: &Ask,
        settings: &Settings,
        inbox: &mut Inbox,
    ) -> Result<Vec<u16>, ModbusError> {
        let shape = ask.shape(settings.unit);
        let request = ask.to_string();
        self.latest = Some(shape);
        let misfit = |why| ModbusError::Misfit { request: request.clone(), why };
        let error = match self.call(ask, settings, inbox).await {
            End::Replied(Ok(Ok(reply))) => match ask.words(reply) {
                Ok(words) => return Ok(words),
                Err(why) => misfit(why),
            },
            End::Replied(Ok(Err(exception))) => {
                let function = ask.request().function_code().value();
                return Err(ModbusError::Refused { request, function, code: exception.into() });
            }
            End::Replied(Err(tokio_modbus::Error::Protocol(error))) => misfit(error.to_string()),
            End::Replied(Err(tokio_modbus::Error::Transport(error)))
                if error.kind() == std::io::ErrorKind::InvalidData =>
            {
                misfit(error.to_string())
            }
            End::Replied(Err(tokio_modbus::Error::Transport(error))) => {
                let why = self.why_lost(error).await;
                self.wire = None;
                ModbusError::Lost { request, why }
            }
            End::Late(within) => ModbusError::Late { request, within },
        };
        self.context = None;
        match self.line.framing {
            Framing::Rtu => self.owed.push(shape),
            Framing::Tcp => self.wire = None,
        }
        Err(error)
    }

    async fn call(&mut self, ask: &Ask, settings: &Settings, inbox: &mut Inbox) -> End {
        let Some(wire) = &self.wire else {
            let closed = std::io::Error::from(std::io::ErrorKind::NotConnected);
            return End::Replied(Err(closed.into()));
        };
        let unit = Slave(settings.unit);
        let framing = self.line.framing;
        let context = match framing {
            // Each request gets a new decoder, without bytes of earlier requests.
            Framing::Rtu => self.context.insert(rtu::attach_slave(wire.clone(), unit)),
            Framing::Tcp => {
                self.context.get_or_insert_with(|| tcp::attach_slave(wire.clone(), unit))
            }
        };
        let hurry = async {
            inbox.come().await;
            sleep(HOLD_REPLY_WAIT).await;
        };
        // Dropping a call here drops its context too.
        tokio::select! {
            biased;
            replied = timeout(settings.timeout, context.call(ask.request())) => {
                replied.map_or(End::Late(settings.timeout), End::Replied)
            }
            () = hurry, if framing == Framing::Tcp => End::Late(HOLD_REPLY_WAIT),
        }
    }

    /// Reason for the lost connection. tokio-modbus reports a closed stream by the last error of the operating
    /// system.
    async fn why_lost(&mut self, error: std::io::Error) -> String {
        let Some(wire) = &mut self.wire else { return error.to_string() };
        match wire.skim().await {
            Err(closed) => closed.to_string(),
            Ok(_) => error.to_string(),
        }
    }
}
