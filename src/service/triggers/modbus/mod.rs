//! The daemon's own Modbus TCP server, on its own thread, so that its clients do not delay a run. Only listed
//! addresses may connect; requests for every unit identifier are answered.

mod guard;
mod inputs;
pub mod map;

use std::future::{Ready, ready};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::net::{TcpListener, TcpStream};
use tokio_modbus::prelude::{ExceptionCode, Request, Response};
use tokio_modbus::server::Service;
use tokio_modbus::server::tcp::Server;

use self::guard::{Guarded, Places};
use self::inputs::{CoilCommand, Inputs};
use self::map::{COILS, HOLDINGS, INPUTS};
use crate::service::command_gate::CommandGate;
use crate::service::config::Modbus;
use crate::service::machine_state::Refusal;
use crate::service::worker_command::Inspection;
use crate::service::{Log, ServeError};

/// Period of the heartbeat counter.
const BEAT: Duration = Duration::from_millis(250);
/// Maximum number of connections.
const PLACES: usize = 16;
/// Pause before the server listens again after an error.
const PAUSE: Duration = Duration::from_millis(100);
/// Maximum number of registers in one request, by the protocol; [`MOST_COILS`] is that of coils.
const MOST_REGISTERS: u16 = 125;
const MOST_COILS: u16 = 2000;

/// Starts the server.
///
/// # Errors
/// The address cannot be listened on, or the thread cannot be started.
pub fn start(config: &Modbus, gate: &CommandGate, log: &Log) -> Result<(), ServeError> {
    let failed =
        |source| ServeError::Listen { what: "the Modbus server", listen: config.listen, source };
    let listener = std::net::TcpListener::bind(config.listen).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    log.say(&format!("Modbus TCP on {}", listener.local_addr().map_err(failed)?));
    let fresh = Duration::from_secs_f64(config.fresh_s);
    let inputs = Arc::new(Mutex::new(Inputs::new(fresh)));
    let shared = Arc::new(Shared { gate: gate.clone(), inputs, since: Instant::now() });
    let told = Arc::clone(&shared.inputs);
    gate.add_readiness_source(move || {
        told.lock().unwrap_or_else(PoisonError::into_inner).readiness(Instant::now())
    });
    let door = Door {
        allow: config.allow.clone().into(),
        places: Places::new(PLACES),
        shared,
        log: log.clone(),
        stranger: Mutex::new(None),
    };
    std::thread::Builder::new()
        .name("modbus server".to_owned())
        .spawn(move || {
            if let Err(error) = serve(listener, &door) {
                door.log.fault(&format!("the Modbus server has ended: {error}"));
            }
        })
        .map(drop)
        .map_err(ServeError::Thread)
}

fn serve(listener: std::net::TcpListener, door: &Door) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let server = Server::new(TcpListener::from_std(listener)?);
        let connected = |stream, from| ready(Ok(door.let_in(stream, from)));
        loop {
            if let Err(error) = server.serve(&connected, drop).await {
                door.log.fault(&format!("the Modbus server: {error}"));
            }
            tokio::time::sleep(PAUSE).await;
        }
    })
}

struct Door {
    allow: Arc<[IpAddr]>,
    places: Places,
    shared: Arc<Shared>,
    log: Log,
    /// The last refused address: it is logged only once.
    stranger: Mutex<Option<IpAddr>>,
}

impl Door {
    fn let_in(&self, stream: TcpStream, from: SocketAddr) -> Option<(Client, Guarded)> {
        let by = from.ip().to_canonical();
        if !self.allow.contains(&by) {
            let mut last = self.stranger.lock().unwrap_or_else(PoisonError::into_inner);
            if last.replace(by) != Some(by) {
                self.log.say(&format!("{by} may not connect: it is not in [serve.modbus] allow"));
            }
            return None;
        }
        // Responses are small and sent at once; on an error they are only delayed.
        let _ = stream.set_nodelay(true);
        let client = Client { shared: self.shared.clone(), by: format!("Modbus client {by}") };
        Some((client, self.places.seat(stream)?))
    }
}

struct Shared {
    gate: CommandGate,
    inputs: Arc<Mutex<Inputs>>,
    since: Instant,
}

impl Shared {
    fn inputs(&self) -> MutexGuard<'_, Inputs> {
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn image(&self) -> [u16; INPUTS] {
        let interlocks = self.inputs().interlocks(Instant::now());
        let beats = self.since.elapsed().as_millis() / BEAT.as_millis();
        map::image(&self.gate.machine_state(), interlocks, beats as u16)
    }

    fn write_coils(&self, first: u16, values: &[bool], by: &str) -> Result<(), ExceptionCode> {
        let range = range(first, values.len() as u16, MOST_COILS, COILS)?;
        let now = Instant::now();
        let (coil_commands, interlocks) = {
            let mut inputs = self.inputs();
            (inputs.write(range.start, values, now), inputs.interlocks(now))
        };
        for wish in coil_commands {
            match wish {
                // The reason of a refusal is in the machine state.
                CoilCommand::Start(cycle) => drop(self.gate.start(cycle, interlocks, by)),
                CoilCommand::Several => self.gate.refuse(Refusal::Several, by),
                CoilCommand::Stop => drop(self.gate.stop(by)),
                // The reason of a refusal is in the machine state.
                CoilCommand::Acknowledge => {
                    drop(self.gate.acknowledge(Inspection { who: by, ..Inspection::default() }));
                }
            }
        }
        Ok(())
    }

    fn write_registers(&self, first: u16, values: &[u16]) -> Result<(), ExceptionCode> {
        range(first, values.len() as u16, MOST_REGISTERS, HOLDINGS)?;
        if let [alive] = values {
            self.inputs().write_alive(*alive, Instant::now());
        }
        Ok(())
    }
}

/// Indexes of `count` registers from `first` on, out of `size`; at most `most` in one request.
fn range(first: u16, count: u16, most: u16, size: usize) -> Result<Range<usize>, ExceptionCode> {
    if count == 0 || count > most {
        return Err(ExceptionCode::IllegalDataValue);
    }
    let (first, count) = (usize::from(first), usize::from(count));
    match first + count <= size {
        true => Ok(first..first + count),
        false => Err(ExceptionCode::IllegalDataAddress),
    }
}

/// Handler of one connection.
struct Client {
    shared: Arc<Shared>,
    by: String,
}

impl Service for Client {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Request<'static>) -> Self::Future {
        ready(self.answer(request))
    }
}

impl Client {
    fn answer(&self, request: Request<'static>) -> Result<Response, ExceptionCode> {
        let shared = &self.shared;
        let of = |all: &[u16], range: Range<usize>| all.get(range).unwrap_or_default().to_vec();
        match request {
            Request::ReadCoils(first, count) => {
                let range = range(first, count, MOST_COILS, COILS)?;
                let coils = shared.inputs().coils().get(range).unwrap_or_default().to_vec();
                Ok(Response::ReadCoils(coils))
            }
            Request::ReadInputRegisters(first, count) => {
                let range = range(first, count, MOST_REGISTERS, INPUTS)?;
                Ok(Response::ReadInputRegisters(of(&shared.image(), range)))
            }
            Request::ReadHoldingRegisters(first, count) => {
                let range = range(first, count, MOST_REGISTERS, HOLDINGS)?;
                Ok(Response::ReadHoldingRegisters(of(&[shared.inputs().alive()], range)))
            }
            Request::WriteSingleCoil(at, value) => {
                shared.write_coils(at, &[value], &self.by)?;
                Ok(Response::WriteSingleCoil(at, value))
            }
            Request::WriteMultipleCoils(first, values) => {
                shared.write_coils(first, &values, &self.by)?;
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
