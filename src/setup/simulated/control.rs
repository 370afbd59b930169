//! Registry of simulated controls and of the wires between them and the daemon; `[controller]` of kind
//! `simulated` and `[[simulated.fault]]`.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

use devices::controllers::{Controller, ControllerError, Named as _, grbl, modbus};
use link::clock::HostClock;
use link::{HostPort, Link, LinkError};
use machine::record::machine::Machine;
use planning::proof::ProvenModes;
use simulator::World;
use simulator::controls;
use simulator::faulty_wire::{BadWire, Planned};
use simulator::interpreter::Pace;

/// `[controller]` of kind `simulated`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct SimulatedControl {
    speaks: Speaks,
    wire: Wire,
    /// Baud rate of the control. On a pseudo-terminal, a client with another baud rate is not understood.
    baud: Option<u32>,
    /// `$` settings that differ from those of the machine.
    settings: BTreeMap<u16, f64>,
}

impl Default for SimulatedControl {
    fn default() -> Self {
        let (speaks, wire) = (Speaks::Grbl, Wire::Memory);
        Self { speaks, wire, baud: None, settings: BTreeMap::new() }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    #[serde(default)]
    speaks: Speaks,
    wire: Option<Wire>,
    baud: Option<u32>,
    #[serde(default)]
    settings: BTreeMap<String, f64>,
}

/// Registry: a new simulated control is a line here and in the matches below.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Speaks {
    #[default]
    Grbl,
    Modbus,
    /// Modbus registers with a resident program.
    ModbusProgram,
}

/// Wire between the daemon and the simulated firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Wire {
    Memory,
    Pty,
    Tcp,
}

/// Faults of a simulated control, in its own terms.
#[derive(Debug, Clone)]
pub struct Faults(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Grbl(Vec<controls::grbl::Fault>),
    Modbus(Vec<controls::modbus::Fault>),
}

/// The simulated machine of the control.
pub struct Bench<'a> {
    pub machine: &'a Machine,
    pub world: Arc<Mutex<World>>,
    pub pace: Pace,
    pub faults: Faults,
}

/// A simulated control that is served on its wire until dropped.
pub struct Served {
    at: link::Named,
    speaks: Speaks,
    task: JoinHandle<()>,
}

impl Drop for Served {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Its location, as `[controller]` of a machine file states it.
impl fmt::Display for Served {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.at.fmt(f)
    }
}

impl Served {
    /// `[controller]` for a real control with the same connection.
    pub fn keys(&self) -> String {
        format!("kind = \"{}\"\n{}", self.kind(), self.driver_keys())
    }

    fn kind(&self) -> &'static str {
        match self.speaks {
            Speaks::Grbl => grbl::KIND,
            Speaks::Modbus | Speaks::ModbusProgram => modbus::KIND,
        }
    }

    /// Keys of the driver's own configuration, without the kind.
    fn driver_keys(&self) -> String {
        let mut keys = self.at.to_toml();
        let on_tcp = matches!(self.at, link::Named::Tcp(_));
        if self.kind() == modbus::KIND && !on_tcp {
            keys += "parity = \"none\"\n";
        }
        if self.speaks == Speaks::ModbusProgram {
            keys += "program = { number = 1 }\n";
        }
        keys
    }

    /// Description of the served control.
    pub fn what(&self) -> &'static str {
        match self.speaks {
            Speaks::Grbl => "grblHAL machine",
            Speaks::Modbus => "machine behind a window of Modbus registers",
            Speaks::ModbusProgram => "machine with a resident program behind Modbus registers",
        }
    }
}

/// Nominal baud rate: a pseudo-terminal has no speed, but the silent intervals between Modbus frames are
/// computed from one.
const BAUD: u32 = 115_200;
/// Unit that the driver addresses, on TCP as well.
const UNIT: &str = "unit = 1\n";
/// Size of the in-process wire, bytes.
const WIRE_BYTES: usize = 4096;

impl TryFrom<Keys> for SimulatedControl {
    type Error = String;

    fn try_from(Keys { speaks, wire, baud, settings }: Keys) -> Result<Self, String> {
        let (usual, known) = match speaks {
            Speaks::Grbl => (Wire::Memory, [Wire::Memory, Wire::Pty]),
            Speaks::Modbus | Speaks::ModbusProgram => (Wire::Tcp, [Wire::Tcp, Wire::Pty]),
        };
        let wire = wire.unwrap_or(usual);
        if !known.contains(&wire) {
            let names = known.map(|wire| format!("`{wire:?}`").to_lowercase());
            return Err(format!("this control has the wires {}", names.join(" and ")));
        }
        if baud.is_some() && wire != Wire::Pty {
            return Err(
                "`baud` belongs to `wire = \"pty\"`: the other wires have no speed".to_owned()
            );
        }
        if !settings.is_empty() && speaks != Speaks::Grbl {
            return Err("`settings` are those of grblHAL: this control has none".to_owned());
        }
        let number = |(key, value): (String, f64)| match key.trim_start_matches('$').parse() {
            Ok(number) => Ok((number, value)),
            Err(_) => Err(format!("`settings` has `{key}`, which is no number of a setting")),
        };
        let settings = settings.into_iter().map(number).collect::<Result<_, _>>()?;
        Ok(Self { speaks, wire, baud, settings })
    }
}

impl SimulatedControl {
    /// Dialect of the control, which orients its spindle.
    pub fn dialect(&self) -> &'static str {
        "grbl-m19"
    }

    /// Reads `[[simulated.fault]]`.
    ///
    /// # Errors
    /// The entries cannot be deserialized.
    pub fn faults<'de, D: Deserializer<'de>>(&self, list: D) -> Result<Faults, D::Error> {
        Ok(Faults(match self.speaks {
            Speaks::Grbl => Kind::Grbl(Deserialize::deserialize(list)?),
            Speaks::Modbus | Speaks::ModbusProgram => {
                let faults: Vec<controls::modbus::Fault> = Deserialize::deserialize(list)?;
                let lines = self.speaks == Speaks::Modbus;
                if let Some(fault) = faults.iter().find(|fault| lines && fault.kind.of_program()) {
                    let kind = fault.kind;
                    let why = format!("{kind:?} happens to a resident program (`modbus-program`)");
                    return Err(D::Error::custom(why));
                }
                Kind::Modbus(faults)
            }
        }))
    }

    /// An empty list of faults.
    pub fn no_faults(&self) -> Faults {
        Faults(match self.speaks {
            Speaks::Grbl => Kind::Grbl(Vec::new()),
            Speaks::Modbus | Speaks::ModbusProgram => Kind::Modbus(Vec::new()),
        })
    }

    /// Starts the control and opens its driver. Call inside a tokio runtime. The served control outlives the
    /// driver.
    ///
    /// # Errors
    /// The wire or the driver cannot be opened.
    pub async fn open(
        &self,
        bench: Bench<'_>,
        modes: ProvenModes,
    ) -> Result<(Controller, Option<Served>), ControllerError> {
        let machine = bench.machine;
        if let (Wire::Memory, Kind::Grbl(faults)) = (self.wire, &bench.faults.0) {
            let (near, far) = tokio::io::duplex(WIRE_BYTES);
            let mut firmware = self.grbl_firmware(&bench, faults);
            tokio::spawn(async move { drop(firmware.serve(far).await) });
            let link = Link::over("the simulated machine", near);
            let (driver, halt) = grbl::Grbl::new(link, machine, modes);
            return Ok((Controller::spawn(driver, halt), None));
        }
        let served = self.serve(bench)?;
        let controller = match self.speaks {
            Speaks::Grbl => {
                let link = link::open(&served.at.address()?).await?;
                let (driver, halt) = grbl::Grbl::new(link, machine, modes);
                Controller::spawn(driver, halt)
            }
            Speaks::Modbus | Speaks::ModbusProgram => {
                let keys = format!("{UNIT}{}", served.driver_keys());
                let config: modbus::Config = toml::from_str(&keys)
                    .map_err(|error| ControllerError::Garbled { text: error.to_string() })?;
                config.open(machine, modes, Arc::new(HostClock::start())).await?
            }
        };
        Ok((controller, Some(served)))
    }

    /// Serves the control on a wire of its own: a TCP port of this computer, or a new pseudo-terminal.
    ///
    /// # Errors
    /// The wire cannot be opened.
    pub fn serve(&self, bench: Bench<'_>) -> Result<Served, ControllerError> {
        let speaks = self.speaks;
        match &bench.faults.0 {
            Kind::Grbl(faults) => {
                let mut firmware = self.grbl_firmware(&bench, faults);
                self.on_pty(|pty| {
                    tokio::spawn(async move {
                        let _client_side = pty.client_side;
                        drop(firmware.serve(pty.device).await);
                    })
                })
            }
            Kind::Modbus(faults) => {
                let resident = speaks == Speaks::ModbusProgram;
                let firmware = modbus_firmware(&bench, faults, resident);
                if self.wire != Wire::Pty {
                    return on_tcp(speaks, firmware);
                }
                self.on_pty(|pty| {
                    tokio::spawn(async move {
                        let _client_side = pty.client_side;
                        drop(controls::modbus::serve_rtu(firmware, pty.device).await);
                    })
                })
            }
        }
    }

    /// As [`Self::serve`], with a faulty wire; `tell` is called with each fault and its time. When the wire is
    /// cut, the pseudo-terminal is closed.
    ///
    /// # Errors
    /// The wire cannot be opened, or the control does not use a line protocol.
    pub fn serve_badly(
        &self,
        bench: Bench<'_>,
        wire: BadWire,
        tell: fn(Duration, Planned),
    ) -> Result<Served, ControllerError> {
        let Kind::Grbl(faults) = &bench.faults.0 else {
            return Err(ControllerError::Unsupported {
                what: "the bad wire counts lines, and Modbus has none".to_owned(),
                remedy: "write [[simulated.fault]] instead (late, lost, torn, cut ...)".to_owned(),
            });
        };
        let mut firmware = self.grbl_firmware(&bench, faults);
        self.on_pty(|pty| {
            tokio::spawn(async move {
                let _client_side = pty.client_side;
                let (near, far) = tokio::io::duplex(WIRE_BYTES);
                let control = async move { drop(firmware.serve(far).await) };
                tokio::join!(control, async {
                    drop(wire.join(pty.device, near, &tell).await);
                });
            })
        })
    }

    fn on_pty(
        &self,
        serve: impl FnOnce(link::Pty) -> JoinHandle<()>,
    ) -> Result<Served, ControllerError> {
        let pty = self.baud.map_or_else(link::pty, link::pty_at)?;
        let baud = self.baud.unwrap_or(BAUD);
        let at = link::Named::Serial { path: pty.path.clone().into(), baud };
        Ok(Served { at, speaks: self.speaks, task: serve(pty) })
    }

    fn grbl_firmware(
        &self,
        bench: &Bench<'_>,
        faults: &[controls::grbl::Fault],
    ) -> controls::grbl::Firmware {
        use controls::grbl::{Firmware, Options};
        let mut options = Options::of(bench.machine, bench.pace);
        options.faults = faults.to_vec();
        options.settings.extend(&self.settings);
        Firmware::new(bench.world.clone(), options)
    }
}

fn on_tcp(speaks: Speaks, firmware: controls::modbus::Firmware) -> Result<Served, ControllerError> {
    let listen = || {
        let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        Ok((TcpListener::from_std(listener)?, port))
    };
    let fault =
        |source: io::Error| LinkError::Open { address: "a port of its own".to_owned(), source };
    let (listener, port) = listen().map_err(fault)?;
    let at = link::Named::Tcp(HostPort::local(port));
    let serve = async move { drop(controls::modbus::serve_tcp(firmware, listener).await) };
    Ok(Served { at, speaks, task: tokio::spawn(serve) })
}

fn modbus_firmware(
    bench: &Bench<'_>,
    faults: &[controls::modbus::Fault],
    resident: bool,
) -> controls::modbus::Firmware {
    use controls::modbus::{Firmware, Options};
    let options =
        Options { faults: faults.to_vec(), resident, ..Options::of(bench.machine, bench.pace) };
    Firmware::new(bench.world.clone(), options)
}
