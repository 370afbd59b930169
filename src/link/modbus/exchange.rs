//! One request and its reply, and what has to happen before the next one.

use std::time::Duration;

use tokio::time::{sleep, timeout};
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::{Response, Slave};

use super::ask::{Ask, Shape};
use super::inbox::Inbox;
use super::wire::Wire;
use super::{Framing, Line, ModbusError, Settings};
use crate::wiring::Wired;

/// How long a hold waits for a reply under way over TCP.
const GRACE: Duration = Duration::from_millis(20);
/// How often the line is asked whether it is clear, before one request.
const CLEARINGS: usize = 3;

/// The connection, and what it still owes.
pub(super) struct Exchange {
    line: Line,
    wired: Wired,
    wire: Option<Wire>,
    /// Over TCP it lives as long as the connection, for its transaction numbers.
    context: Option<Context>,
    /// Replies that may still come (RTU).
    owed: Vec<Shape>,
    latest: Option<Shape>,
}

/// How one call ended.
enum End {
    Replied(tokio_modbus::Result<Response>),
    Late(Duration),
}

impl Exchange {
    pub(super) fn new(line: Line, wired: Wired) -> Self {
        Self { line, wired, wire: None, context: None, owed: Vec::new(), latest: None }
    }

    /// # Errors
    /// What opening says.
    pub(super) async fn open(&mut self) -> Result<(), ModbusError> {
        self.wire = Some(self.line.open(&self.wired).await?);
        Ok(())
    }

    /// Send `ask` once, on a line that owes nothing, and return the words of its reply.
    pub(super) async fn perform(
        &mut self,
        ask: &Ask,
        settings: &Settings,
        inbox: &mut Inbox,
    ) -> Result<Vec<u16>, ModbusError> {
        self.quieten().await?;
        self.clear(ask, settings, inbox).await?;
        self.send(ask, settings, inbox).await
    }

    /// As `perform`, without asking first whether the line owes something: a hold does not wait.
    pub(super) async fn perform_now(&mut self, ask: &Ask, settings: &Settings, inbox: &mut Inbox) {
        // Whether it arrived shows at the device alone.
        if self.quieten().await.is_ok() {
            let _ = self.send(ask, settings, inbox).await;
        }
    }

    /// Open the connection if need be, and let the line fall silent.
    async fn quieten(&mut self) -> Result<(), ModbusError> {
        if let Some(wire) = &mut self.wire {
            let drained = match self.line.framing {
                Framing::Rtu => wire.drain(self.line.silence()).await,
                Framing::Tcp => wire.skim().await,
            };
            match (drained, self.line.framing) {
                (Ok(0), _) => return Ok(()),
                (Ok(_), Framing::Rtu) => {
                    // Somebody spoke unasked: perhaps the last reply came twice.
                    self.owed.extend(self.latest);
                    return Ok(());
                }
                // An idle connection was closed, or something came on it unasked.
                _ => self.close(),
            }
        }
        self.open().await?;
        if let (Some(wire), Framing::Rtu) = (&mut self.wire, self.line.framing) {
            // What the port held from before.
            let _ = wire.drain(self.line.silence()).await;
        }
        Ok(())
    }

    fn close(&mut self) {
        self.context = None;
        self.wire = None;
    }

    /// A read whose reply nothing that is owed can be taken for.
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

    /// RTU: a reply of a shape that is not owed proves that all owed ones of its unit are gone.
    async fn clear(
        &mut self,
        ask: &Ask,
        settings: &Settings,
        inbox: &mut Inbox,
    ) -> Result<(), ModbusError> {
        let unit = settings.unit;
        let mut why = String::new();
        for _ in 0..CLEARINGS {
            if !self.is_owed_by(unit) {
                return Ok(());
            }
            let Some(probe) = self.probe(settings) else {
                self.wait_out(settings, inbox).await;
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

    /// Nothing tells the owed replies apart: a long quiet has to do, unless a hold wants to go out.
    async fn wait_out(&mut self, settings: &Settings, inbox: &mut Inbox) {
        self.wire.iter().for_each(Wire::hush);
        self.wait_quietly(settings.timeout, inbox).await;
        if !inbox.has_come() {
            self.forget_owed_by(settings.unit);
        }
    }

    /// One question of `clear`; what went wrong with it, if it did.
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
                    // That was an old one; its own may be on its way.
                    self.wait_quietly(settings.timeout, inbox).await;
                }
                return Some(error);
            }
        }
        None
    }

    /// Throw away what comes until nothing has come for `silence`, or a hold wants to go out.
    async fn wait_quietly(&mut self, silence: Duration, inbox: &mut Inbox) {
        let Some(wire) = &mut self.wire else { return };
        // Both can be given up without harm: what was read is thrown away in any case.
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
            // Each request gets a decoder that has seen nothing else.
            Framing::Rtu => self.context.insert(rtu::attach_slave(wire.clone(), unit)),
            Framing::Tcp => {
                self.context.get_or_insert_with(|| tcp::attach_slave(wire.clone(), unit))
            }
        };
        let hurry = async {
            inbox.come().await;
            sleep(GRACE).await;
        };
        // A call that is given up here takes its context with it.
        tokio::select! {
            biased;
            replied = timeout(settings.timeout, context.call(ask.request())) => {
                replied.map_or(End::Late(settings.timeout), End::Replied)
            }
            () = hurry, if framing == Framing::Tcp => End::Late(GRACE),
        }
    }

    /// tokio-modbus says of a closed stream what the system happened to say last.
    async fn why_lost(&mut self, error: std::io::Error) -> String {
        let Some(wire) = &mut self.wire else { return error.to_string() };
        match wire.skim().await {
            Err(closed) => closed.to_string(),
            Ok(_) => error.to_string(),
        }
    }
}
