//! The daemon's own Modbus TCP server, on a thread of its own: what a client does, or a thousand, the
//! run does not notice. Only who is on the list is listened to; every unit identifier is ours.

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
use self::inputs::{Inputs, Wish};
use self::map::{COILS, HOLDINGS, INPUTS};
use crate::service::ask::Looked;
use crate::service::board::Refusal;
use crate::service::config::Modbus;
use crate::service::desk::Desk;
use crate::service::{Log, ServeError};

/// The heartbeat counts these.
const BEAT: Duration = Duration::from_millis(250);
/// Connections at a time.
const PLACES: usize = 16;
/// Before listening again when the system had no room for a connection.
const PAUSE: Duration = Duration::from_millis(100);
/// Of registers and of coils in one request, by the protocol.
const MOST_REGISTERS: u16 = 125;
const MOST_COILS: u16 = 2000;

/// Listen, and answer from then on.
///
/// # Errors
/// The address cannot be listened on.
pub fn start(config: &Modbus, desk: &Desk, log: &Log) -> Result<(), ServeError> {
    let failed =
        |source| ServeError::Listen { what: "the Modbus server", listen: config.listen, source };
    let listener = std::net::TcpListener::bind(config.listen).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    log.say(&format!("Modbus TCP on {}", listener.local_addr().map_err(failed)?));
    let fresh = Duration::from_secs_f64(config.fresh_s);
    let inputs = Arc::new(Mutex::new(Inputs::new(fresh)));
    let shared = Arc::new(Shared { desk: desk.clone(), inputs, since: Instant::now() });
    let told = Arc::clone(&shared.inputs);
    desk.rota()
        .tells(move || told.lock().unwrap_or_else(PoisonError::into_inner).told(Instant::now()));
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
    /// The last one that was turned away: it is told once.
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
        // Small answers, at once. Where it cannot be had they come a little later.
        let _ = stream.set_nodelay(true);
        let client = Client { shared: self.shared.clone(), by: format!("Modbus client {by}") };
        Some((client, self.places.seat(stream)?))
    }
}

struct Shared {
    desk: Desk,
    inputs: Arc<Mutex<Inputs>>,
    since: Instant,
}

impl Shared {
    fn inputs(&self) -> MutexGuard<'_, Inputs> {
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn image(&self) -> [u16; INPUTS] {
        let said = self.inputs().said(Instant::now());
        let beats = self.since.elapsed().as_millis() / BEAT.as_millis();
        map::image(&self.desk.board(), said, beats as u16)
    }

    fn write_coils(&self, first: u16, values: &[bool], by: &str) -> Result<(), ExceptionCode> {
        let range = range(first, values.len() as u16, MOST_COILS, COILS)?;
        let now = Instant::now();
        let (wishes, said) = {
            let mut inputs = self.inputs();
            (inputs.write(range.start, values, now), inputs.said(now))
        };
        for wish in wishes {
            match wish {
                // Refused: the board says why.
                Wish::Start(cycle) => drop(self.desk.start(cycle, said, by)),
                Wish::Several => self.desk.refuse(Refusal::Several, by),
                Wish::Stop => drop(self.desk.stop(by)),
                // Why not stands on the board.
                Wish::Acknowledge => {
                    drop(self.desk.acknowledge(Looked { who: by, ..Looked::default() }));
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

/// Where `count` from `first` on lie, of `size` that there are.
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

/// One connection.
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
