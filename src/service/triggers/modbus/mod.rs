//! The daemon's own Modbus TCP server, on its own thread, so that its clients do not delay a run. Only listed
//! addresses may connect; requests for every unit identifier are answered.

mod connection_slots;
mod control_inputs;
pub mod register_map;

use std::future::{Ready, ready};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::net::{TcpListener, TcpStream};
use tokio_modbus::prelude::{ExceptionCode, Request, Response};
use tokio_modbus::server::Service;
use tokio_modbus::server::tcp::Server;

use self::connection_slots::{ConnectionSlots, GuardedStream};
use self::control_inputs::{CoilCommand, ControlInputs};
use self::register_map::{COIL_COUNT, HOLDING_REGISTER_COUNT, INPUT_REGISTER_COUNT};
use crate::service::command_gate::CommandGate;
use crate::service::config::ModbusServerConfig;
use crate::service::machine_state::Refusal;
use crate::service::worker_command::Inspection;
use crate::service::{Log, ServeError, lock, spawn_thread};

/// Period with which the counter in the heartbeat register is incremented, also while the worker hangs.
const HEARTBEAT_PERIOD: Duration = Duration::from_millis(250);
/// Maximum number of connections.
const MAX_CONNECTIONS: usize = 16;
/// Pause before the server listens again after an error.
const LISTEN_RETRY_PAUSE: Duration = Duration::from_millis(100);
/// Maximum number of registers in one request, by the protocol.
const MAX_REGISTERS_PER_REQUEST: u16 = 125;
/// Maximum number of coils in one request, by the protocol.
const MAX_COILS_PER_REQUEST: u16 = 2000;

/// Starts the daemon's own Modbus TCP server on its own thread.
///
/// # Errors
/// The address cannot be listened on, or the thread cannot be started.
pub fn start_modbus_server(config: &ModbusServerConfig, gate: &CommandGate, log: &Log) -> Result<(), ServeError> {
    let failed = |source| ServeError::Listen { server: "the Modbus server", listen: config.listen, source };
    let listener = std::net::TcpListener::bind(config.listen).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    log.info(&format!("Modbus TCP on {}", listener.local_addr().map_err(failed)?));
    let inputs = Arc::new(Mutex::new(ControlInputs::new(Duration::from_secs_f64(config.fresh_s))));
    let shared =
        Arc::new(ModbusServerState { gate: gate.clone(), inputs: Arc::clone(&inputs), started_at: Instant::now() });
    gate.add_readiness_source(move || lock(&inputs).readiness(Instant::now()));
    let filter = ConnectionFilter {
        allowed_addresses: config.allow.clone().into(),
        slots: ConnectionSlots::new(MAX_CONNECTIONS),
        server_state: shared,
        log: log.clone(),
        last_refused_address: Mutex::new(None),
    };
    spawn_thread("modbus server", move || {
        if let Err(error) = run_modbus_server(listener, &filter) {
            filter.log.error(&format!("the Modbus server stopped: {error}"));
        }
    })
}

fn run_modbus_server(listener: std::net::TcpListener, filter: &ConnectionFilter) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let server = Server::new(TcpListener::from_std(listener)?);
        let connected = |stream, from| ready(Ok(filter.accept(stream, from)));
        loop {
            if let Err(error) = server.serve(&connected, drop).await {
                filter.log.error(&format!("the Modbus server: {error}"));
            }
            tokio::time::sleep(LISTEN_RETRY_PAUSE).await;
        }
    })
}

/// Decides which connections are served.
struct ConnectionFilter {
    allowed_addresses: Arc<[IpAddr]>,
    slots: ConnectionSlots,
    server_state: Arc<ModbusServerState>,
    log: Log,
    /// The last refused address: it is logged again only after another address was refused.
    last_refused_address: Mutex<Option<IpAddr>>,
}

impl ConnectionFilter {
    /// `None`: the address is not allowed, or no connection slot is free.
    fn accept(&self, stream: TcpStream, from: SocketAddr) -> Option<(ModbusConnectionHandler, GuardedStream)> {
        let by = from.ip().to_canonical();
        if !self.allowed_addresses.contains(&by) {
            let mut last = lock(&self.last_refused_address);
            if last.replace(by) != Some(by) {
                self.log.info(&format!(
                    "the connection from {by} is refused: the address is not in `allow` of [serve.modbus]"
                ));
            }
            return None;
        }
        // Responses are small and are sent at once; if the option cannot be set, they are only delayed.
        let _ = stream.set_nodelay(true);
        let client = ModbusConnectionHandler {
            server_state: self.server_state.clone(),
            client_name: format!("Modbus client {by}"),
        };
        Some((client, self.slots.admit(stream)?))
    }
}

/// State that all connections of the server share.
struct ModbusServerState {
    gate: CommandGate,
    inputs: Arc<Mutex<ControlInputs>>,
    started_at: Instant,
}

impl ModbusServerState {
    fn input_registers(&self) -> [u16; INPUT_REGISTER_COUNT] {
        let interlocks = lock(&self.inputs).interlocks(Instant::now());
        let beats = self.started_at.elapsed().as_millis() / HEARTBEAT_PERIOD.as_millis();
        register_map::input_registers(&self.gate.machine_state(), interlocks, beats as u16)
    }

    /// Writes the coils and executes the commands of their rising edges. A refused command is no exception: its
    /// reason is in the input registers.
    fn write_coils_and_execute(&self, first: u16, values: &[bool], by: &str) -> Result<(), ExceptionCode> {
        let range = checked_address_range(first, values.len() as u16, MAX_COILS_PER_REQUEST, COIL_COUNT)?;
        let now = Instant::now();
        let (coil_commands, interlocks) = {
            let mut inputs = lock(&self.inputs);
            (inputs.write_coils(range.start, values, now), inputs.interlocks(now))
        };
        for command in coil_commands {
            match command {
                // The reason of a refusal is in the machine state.
                CoilCommand::StartCycleNumber(cycle) => drop(self.gate.start_cycle(cycle, interlocks, by)),
                CoilCommand::SeveralStarts => self.gate.record_refusal(Refusal::Several, &format!("request of {by}")),
                CoilCommand::HoldMachine => drop(self.gate.hold_machine(by)),
                // The reason of a refusal is in the machine state.
                CoilCommand::Acknowledge => {
                    drop(self.gate.acknowledge(Inspection { who: by, ..Inspection::default() }));
                }
            }
        }
        Ok(())
    }

    /// Writes the only holding register, `alive`.
    fn write_registers(&self, first: u16, values: &[u16]) -> Result<(), ExceptionCode> {
        checked_address_range(first, values.len() as u16, MAX_REGISTERS_PER_REQUEST, HOLDING_REGISTER_COUNT)?;
        if let [alive] = values {
            lock(&self.inputs).write_alive(*alive, Instant::now());
        }
        Ok(())
    }
}

/// Indexes of `count` registers or coils from `first` on, out of `size`; at least one and at most `max_count` in one
/// request.
fn checked_address_range(first: u16, count: u16, max_count: u16, size: usize) -> Result<Range<usize>, ExceptionCode> {
    if count == 0 || count > max_count {
        return Err(ExceptionCode::IllegalDataValue);
    }
    let (first, count) = (usize::from(first), usize::from(count));
    match first + count <= size {
        true => Ok(first..first + count),
        false => Err(ExceptionCode::IllegalDataAddress),
    }
}

/// Handles the requests of one connection.
struct ModbusConnectionHandler {
    server_state: Arc<ModbusServerState>,
    client_name: String,
}

impl Service for ModbusConnectionHandler {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Request<'static>) -> Self::Future {
        ready(self.handle_request(request))
    }
}

impl ModbusConnectionHandler {
    fn handle_request(&self, request: Request<'static>) -> Result<Response, ExceptionCode> {
        let shared = &self.server_state;
        let slice = |all: &[u16], range: Range<usize>| all.get(range).unwrap_or_default().to_vec();
        match request {
            Request::ReadCoils(first, count) => {
                let range = checked_address_range(first, count, MAX_COILS_PER_REQUEST, COIL_COUNT)?;
                let coils = lock(&shared.inputs).coils().get(range).unwrap_or_default().to_vec();
                Ok(Response::ReadCoils(coils))
            }
            Request::ReadInputRegisters(first, count) => {
                let range = checked_address_range(first, count, MAX_REGISTERS_PER_REQUEST, INPUT_REGISTER_COUNT)?;
                Ok(Response::ReadInputRegisters(slice(&shared.input_registers(), range)))
            }
            Request::ReadHoldingRegisters(first, count) => {
                let range = checked_address_range(first, count, MAX_REGISTERS_PER_REQUEST, HOLDING_REGISTER_COUNT)?;
                Ok(Response::ReadHoldingRegisters(slice(&[lock(&shared.inputs).alive_register()], range)))
            }
            Request::WriteSingleCoil(at, value) => {
                shared.write_coils_and_execute(at, &[value], &self.client_name)?;
                Ok(Response::WriteSingleCoil(at, value))
            }
            Request::WriteMultipleCoils(first, values) => {
                shared.write_coils_and_execute(first, &values, &self.client_name)?;
                Ok(Response::WriteMultipleCoils(first, values.len() as u16))
            }
            Request::WriteSingleRegister(at, value) => {
                shared.write_registers(at, &[value])?;
                Ok(Response::WriteSingleRegister(at, value))
            }
            Request::WriteMultipleRegisters(first, values) => {
                shared.write_registers(first, &values)?;
                Ok(Response::WriteMultipleRegisters(first, values.len() as u16))
            }
            _ => Err(ExceptionCode::IllegalFunction),
        }
    }
}
