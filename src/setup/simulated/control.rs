//! Registry of simulated controls and of the wires between them and the daemon; `[controller]` of kind
//! `simulated` and `[[simulated.fault]]`.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use tokio::task::JoinHandle;

use devices::controllers::{Controller, ControllerConfig as _, ControllerError, grbl, modbus};
use link::clock::HostClock;
use link::{LineLink, LinkError};
use machine::record::machine::Machine;
use planning::proof::ProvenModeText;
use simulator::SimulatedWorld;
use simulator::controls;
use simulator::faulty_wire::{FaultyWire, PlannedFault};
use simulator::interpreter::SimulationPace;
use simulator::sensor_devices::listen_locally;

/// `[controller]` of kind `simulated`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ControlKeys")]
pub struct SimulatedControlConfig {
    protocol: ControlProtocol,
    wire: ControlWire,
    /// Baud rate of the control. On a pseudo-terminal, a client with another baud rate is not understood. `None`: any
    /// baud rate is understood.
    baud: Option<u32>,
    /// Values of `$` settings, by number, that replace those derived from the machine; grblHAL only.
    grbl_setting_overrides_by_number: BTreeMap<u16, f64>,
}

impl Default for SimulatedControlConfig {
    fn default() -> Self {
        let (protocol, wire) = (ControlProtocol::Grbl, ControlWire::Memory);
        Self { protocol, wire, baud: None, grbl_setting_overrides_by_number: BTreeMap::new() }
    }
}

/// Keys of `[controller]` of kind `simulated`, before the check of their combination.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ControlKeys {
    #[serde(default, rename = "speaks")]
    protocol: ControlProtocol,
    /// `None`: in memory for grblHAL, TCP for Modbus.
    wire: Option<ControlWire>,
    baud: Option<u32>,
    /// Values of `$` settings, by number, with or without the `$`; grblHAL only.
    #[serde(default)]
    settings: BTreeMap<String, f64>,
}

/// Protocol of a simulated control. Registry: a new simulated control is a line here and in the matches below.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ControlProtocol {
    #[default]
    Grbl,
    /// Modbus registers that accept lines of G-code.
    Modbus,
    /// Modbus registers that accept a table for the resident program of the control.
    ModbusProgram,
}

/// Wire between the daemon and the simulated firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ControlWire {
    /// Stream inside the process; grblHAL only.
    Memory,
    /// A new pseudo-terminal.
    Pty,
    /// A TCP port of this computer; Modbus only.
    Tcp,
}

/// Faults of a simulated control; only the list of its own protocol is filled.
#[derive(Debug, Clone, Default)]
pub struct SimulatedFaults {
    grbl: Vec<controls::grbl::Fault>,
    modbus: Vec<controls::modbus::Fault>,
}

/// Inputs of a simulated control: its machine, the world that it moves, its pace and its faults.
pub struct SimulationSetup<'a> {
    pub machine: &'a Machine,
    pub world: Arc<Mutex<SimulatedWorld>>,
    pub pace: SimulationPace,
    pub faults: SimulatedFaults,
}

/// A simulated control that is served on its wire until dropped.
pub struct SimulatedControlServer {
    /// Address at which a client reaches the control: TCP, or the client side of a pseudo-terminal.
    address: link::LinkConfig,
    protocol: ControlProtocol,
    task: JoinHandle<()>,
}

impl Drop for SimulatedControlServer {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Displays the address of the server, as `[controller]` of a machine file states it.
impl fmt::Display for SimulatedControlServer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

impl SimulatedControlServer {
    /// Keys of `[controller]` for a machine file that connects to this server as to a real control.
    pub fn controller_toml(&self) -> String {
        format!("kind = \"{}\"\n{}", self.control_kind(), self.driver_keys_toml())
    }

    /// `kind` of the real control whose driver connects to this server.
    fn control_kind(&self) -> &'static str {
        match self.protocol {
            ControlProtocol::Grbl => grbl::CONTROL_KIND,
            ControlProtocol::Modbus | ControlProtocol::ModbusProgram => modbus::CONTROL_KIND,
        }
    }

    /// Keys of the driver's own configuration, without the kind.
    fn driver_keys_toml(&self) -> String {
        let mut keys = self.address.to_toml();
        let on_tcp = matches!(self.address, link::LinkConfig::Tcp(_));
        if self.control_kind() == modbus::CONTROL_KIND && !on_tcp {
            keys += "parity = \"none\"\n";
        }
        if self.protocol == ControlProtocol::ModbusProgram {
            keys += "program = { number = 1 }\n";
        }
        keys
    }

    /// Description of the served control.
    pub fn control_description(&self) -> &'static str {
        match self.protocol {
            ControlProtocol::Grbl => "grblHAL machine",
            ControlProtocol::Modbus => "machine with a Modbus register window",
            ControlProtocol::ModbusProgram => "machine with a resident program and Modbus registers",
        }
    }
}

/// Nominal baud rate: a pseudo-terminal has no speed, but the silent intervals between Modbus frames are
/// computed from one.
const DEFAULT_BAUD: u32 = 115_200;
/// Line of a machine file with the unit that the driver addresses, on TCP as well.
const UNIT_ADDRESS_TOML: &str = "unit = 1\n";
/// Size of the in-process wire, bytes.
const WIRE_BUFFER_BYTES: usize = 4096;

impl TryFrom<ControlKeys> for SimulatedControlConfig {
    type Error = String;

    fn try_from(ControlKeys { protocol, wire, baud, settings }: ControlKeys) -> Result<Self, String> {
        let (usual, known) = match protocol {
            ControlProtocol::Grbl => (ControlWire::Memory, [ControlWire::Memory, ControlWire::Pty]),
            ControlProtocol::Modbus | ControlProtocol::ModbusProgram => {
                (ControlWire::Tcp, [ControlWire::Tcp, ControlWire::Pty])
            }
        };
        let wire = wire.unwrap_or(usual);
        if !known.contains(&wire) {
            let names = known.map(|wire| format!("`{wire:?}`").to_lowercase());
            return Err(format!("this simulated control supports only the wires {}", names.join(" and ")));
        }
        if baud.is_some() && wire != ControlWire::Pty {
            return Err("`baud` is allowed with `wire = \"pty\"` only: the other wires have no baud rate".to_owned());
        }
        if !settings.is_empty() && protocol != ControlProtocol::Grbl {
            return Err("`settings` is allowed for a simulated grblHAL only".to_owned());
        }
        let number = |(key, value): (String, f64)| match key.trim_start_matches('$').parse() {
            Ok(number) => Ok((number, value)),
            Err(_) => Err(format!("`settings` contains `{key}`, which is not the number of a setting")),
        };
        let settings = settings.into_iter().map(number).collect::<Result<_, _>>()?;
        Ok(Self { protocol, wire, baud, grbl_setting_overrides_by_number: settings })
    }
}

impl SimulatedControlConfig {
    /// Dialect of the simulated control, whatever its protocol: grbl with spindle orientation (M19).
    pub fn dialect(&self) -> &'static str {
        "grbl-m19"
    }

    /// Reads `[[simulated.fault]]`.
    ///
    /// # Errors
    /// The entries cannot be deserialized.
    pub fn read_faults<'de, D: Deserializer<'de>>(&self, list: D) -> Result<SimulatedFaults, D::Error> {
        if self.protocol == ControlProtocol::Grbl {
            return Ok(SimulatedFaults { grbl: Deserialize::deserialize(list)?, ..SimulatedFaults::default() });
        }
        let modbus: Vec<controls::modbus::Fault> = Deserialize::deserialize(list)?;
        let executes_lines = self.protocol == ControlProtocol::Modbus;
        if let Some(fault) = modbus.iter().find(|fault| executes_lines && fault.kind.is_program_only()) {
            let why = format!("the fault {:?} is available for a resident program (`modbus-program`) only", fault.kind);
            return Err(D::Error::custom(why));
        }
        Ok(SimulatedFaults { modbus, ..SimulatedFaults::default() })
    }

    /// Starts the control and opens its driver. Call inside a tokio runtime. The server is returned because it must
    /// outlive the driver; `None`: a control in memory, which ends with its driver.
    ///
    /// # Errors
    /// The wire or the driver cannot be opened.
    pub async fn start_and_open_driver(
        &self,
        setup: SimulationSetup<'_>,
        modes: ProvenModeText,
    ) -> Result<(Controller, Option<SimulatedControlServer>), ControllerError> {
        let machine = setup.machine;
        if self.protocol != ControlProtocol::Grbl {
            let served = self.serve(setup)?;
            let keys = format!("{UNIT_ADDRESS_TOML}{}", served.driver_keys_toml());
            let config: modbus::ModbusConfig =
                toml::from_str(&keys).map_err(|error| ControllerError::UnreadableReply { text: error.to_string() })?;
            return Ok((config.open(machine, modes, Arc::new(HostClock::start())).await?, Some(served)));
        }
        let (link, served) = if self.wire == ControlWire::Memory {
            let (near, far) = tokio::io::duplex(WIRE_BUFFER_BYTES);
            let mut firmware = self.grbl_firmware(setup);
            tokio::spawn(async move { drop(firmware.serve(far).await) });
            (LineLink::from_stream("the simulated machine", near), None)
        } else {
            let served = self.serve(setup)?;
            (link::open_line_link(&served.address.resolve_address()?).await?, Some(served))
        };
        let (driver, halt) = grbl::GrblDriver::new(link, machine, modes);
        Ok((Controller::spawn(driver, halt), served))
    }

    /// Serves the control on a wire of its own: grblHAL on a new pseudo-terminal, Modbus on a new TCP port of this
    /// computer or a new pseudo-terminal.
    ///
    /// # Errors
    /// The wire cannot be opened.
    pub fn serve(&self, setup: SimulationSetup<'_>) -> Result<SimulatedControlServer, ControllerError> {
        if self.protocol == ControlProtocol::Grbl {
            let mut firmware = self.grbl_firmware(setup);
            return self.serve_on_pty(|pty| async move { drop(firmware.serve(pty.device).await) });
        }
        let firmware = self.modbus_firmware(setup);
        if self.wire == ControlWire::Pty {
            return self
                .serve_on_pty(|pty| async move { drop(controls::modbus::serve_rtu(firmware, pty.device).await) });
        }
        let fault = |source: io::Error| LinkError::OpenFailed { address: "a new local TCP port".to_owned(), source };
        let (listener, address) = listen_locally().map_err(fault)?;
        let serve = async move { drop(controls::modbus::serve_tcp(firmware, listener).await) };
        Ok(SimulatedControlServer { address, protocol: self.protocol, task: tokio::spawn(serve) })
    }

    /// As [`Self::serve`], with a faulty wire; grblHAL only. `on_fault` is called with each fault and the time since
    /// the wire was connected. When the wire is cut, the pseudo-terminal is closed.
    ///
    /// # Errors
    /// The wire cannot be opened, or the control does not use a line protocol.
    pub fn serve_with_faulty_wire(
        &self,
        setup: SimulationSetup<'_>,
        wire: FaultyWire,
        on_fault: fn(Duration, PlannedFault),
    ) -> Result<SimulatedControlServer, ControllerError> {
        if self.protocol != ControlProtocol::Grbl {
            return Err(ControllerError::UnsupportedByControl {
                reason: "a faulty link cannot be simulated for Modbus, because Modbus has no lines of text".to_owned(),
                remedy: "use [[simulated.fault]] instead (late, lost, torn, cut ...)".to_owned(),
            });
        }
        let mut firmware = self.grbl_firmware(setup);
        self.serve_on_pty(|pty| async move {
            let (near, far) = tokio::io::duplex(WIRE_BUFFER_BYTES);
            let control = async move { drop(firmware.serve(far).await) };
            tokio::join!(control, async {
                drop(wire.connect(pty.device, near, &on_fault).await);
            });
        })
    }

    /// Serves on a new pseudo-terminal, whose client side stays open meanwhile.
    fn serve_on_pty<F: Future<Output = ()> + Send + 'static>(
        &self,
        serve: impl FnOnce(link::Pty) -> F,
    ) -> Result<SimulatedControlServer, ControllerError> {
        let mut pty = self.baud.map_or_else(link::create_pty, link::create_pty_at_baud)?;
        let address =
            link::LinkConfig::Serial { path: pty.path.clone().into(), baud: self.baud.unwrap_or(DEFAULT_BAUD) };
        let client_side = pty.client_side.take();
        let serving = serve(pty);
        let task = tokio::spawn(async move {
            let _client_side = client_side;
            serving.await;
        });
        Ok(SimulatedControlServer { address, protocol: self.protocol, task })
    }

    fn grbl_firmware(&self, setup: SimulationSetup<'_>) -> controls::grbl::Firmware {
        use controls::grbl::{Firmware, SimulatedGrblOptions};
        let mut options = SimulatedGrblOptions::for_machine(setup.machine, setup.pace);
        options.faults = setup.faults.grbl;
        options.settings_by_number.extend(&self.grbl_setting_overrides_by_number);
        Firmware::new(setup.world, options)
    }

    fn modbus_firmware(&self, setup: SimulationSetup<'_>) -> controls::modbus::Firmware {
        use controls::modbus::{Firmware, SimulatedModbusOptions};
        let options = SimulatedModbusOptions {
            faults: setup.faults.modbus,
            has_resident_program: self.protocol == ControlProtocol::ModbusProgram,
            ..SimulatedModbusOptions::for_machine(setup.machine, setup.pace)
        };
        Firmware::new(setup.world, options)
    }
}
