//! Opens what the machine file names and puts it together. One simulated world is shared by
//! everything that is simulated.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::task::JoinHandle;

use super::machine_file::{Control, MachineFile, Wire};
use super::{Pace, SetupError};
use crate::base::Clock;
use crate::base::clock::HostClock;
use crate::controllers::Controller;
use crate::controllers::grbl::Grbl;
use crate::controllers::grbl::firmware::{Firmware, Options};
use crate::gcode::Dialect;
use crate::link::faults::{BadWire, Planned};
use crate::link::{self, Address, Link};
use crate::record::reading::Reading;
use crate::world::{Truth, World};

/// The machine as a run needs it.
pub struct Devices {
    pub controller: Controller,
    /// The language the control is spoken to; every stage is rendered and read back before it moves.
    pub dialect: Dialect,
    /// Used where the control does not stamp its readings.
    pub clock: Arc<dyn Clock>,
    /// The other end of a pseudo-terminal, if this program serves it; dropped after the controller.
    _simulator: Option<Simulator>,
}

impl Devices {
    /// A control that is open already, timed by the host's clock where it does not stamp.
    pub fn new(controller: Controller, dialect: Dialect) -> Self {
        Self { controller, dialect, clock: Arc::new(HostClock::start()), _simulator: None }
    }
}

/// A simulated control on a pseudo-terminal, alive until dropped.
pub struct Simulator {
    pub path: PathBuf,
    task: JoinHandle<()>,
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Size of the in-process wire, bytes.
const WIRE_BYTES: usize = 4096;

/// What a run has seen of its machine in earlier sessions: a simulated one lives on from there.
#[derive(Debug, Clone, Copy, Default)]
pub struct Past<'a> {
    pub readings: &'a [Reading],
    /// Since the last of them.
    pub elapsed_s: f64,
}

/// Open the machine's control. Call inside a tokio runtime.
pub async fn devices(
    file: &MachineFile,
    pace: Pace,
    past: Past<'_>,
) -> Result<Devices, SetupError> {
    match &file.controller.control {
        Control::Simulated { wire: Wire::Memory } => {
            let (near, far) = tokio::io::duplex(WIRE_BYTES);
            let mut firmware = firmware(file, pace, past)?;
            tokio::spawn(async move { drop(firmware.serve(far).await) });
            grbl(file, Link::over("the simulated machine", near), file.controller.control.dialect())
        }
        Control::Simulated { wire: Wire::Pty } => {
            let simulator = simulator_after(file, pace, past)?;
            let path = simulator.path.display().to_string();
            let link = link::open(&Address::Serial { path, baud: 115_200 }).await?;
            Ok(Devices {
                _simulator: Some(simulator),
                ..grbl(file, link, file.controller.control.dialect())?
            })
        }
        Control::Real(control) => {
            let dialect = Dialect::named(control.dialect())?.with(&file.machine, &file.probe)?;
            let controller = control.open(&file.machine, dialect.clone()).await?;
            Ok(Devices::new(controller, dialect))
        }
    }
}

/// Serve the simulated control on a new pseudo-terminal.
pub fn simulator(file: &MachineFile, pace: Pace) -> Result<Simulator, SetupError> {
    simulator_after(file, pace, Past::default())
}

fn simulator_after(
    file: &MachineFile,
    pace: Pace,
    past: Past<'_>,
) -> Result<Simulator, SetupError> {
    let pty = link::pty()?;
    let mut firmware = firmware(file, pace, past)?;
    let path = PathBuf::from(pty.path.clone());
    let task = tokio::spawn(async move {
        let _client_side = pty.client_side;
        drop(firmware.serve(pty.device).await);
    });
    Ok(Simulator { path, task })
}

/// As [`simulator`], behind a bad wire; `tell` hears what it does, and when. Once the wire is cut
/// the pseudo-terminal is gone.
pub fn bad_simulator(
    file: &MachineFile,
    pace: Pace,
    wire: BadWire,
    tell: fn(Duration, Planned),
) -> Result<Simulator, SetupError> {
    let pty = link::pty()?;
    let mut firmware = firmware(file, pace, Past::default())?;
    let path = PathBuf::from(pty.path.clone());
    let task = tokio::spawn(async move {
        let _client_side = pty.client_side;
        let (near, far) = tokio::io::duplex(WIRE_BYTES);
        let control = async move { drop(firmware.serve(far).await) };
        tokio::join!(control, async { drop(wire.join(pty.device, near, &tell).await) });
    });
    Ok(Simulator { path, task })
}

/// The simulated truth of a machine file.
pub fn world(file: &MachineFile) -> Result<World, SetupError> {
    let truth: Truth = file.simulated()?.unwrap_or_default();
    Ok(World::new(&file.machine, &file.probe, &file.artefact, &truth)?)
}

fn firmware(file: &MachineFile, pace: Pace, past: Past<'_>) -> Result<Firmware, SetupError> {
    let mut world = world(file)?;
    if let Some(last) = past.readings.last() {
        world.pass(last.t_s + past.elapsed_s, past.readings.iter().map(|reading| reading.step));
    }
    let world = Arc::new(Mutex::new(world));
    let faults = file.simulated_faults()?;
    Ok(Firmware::new(world, Options { faults, ..Options::of(&file.machine, pace) }))
}

fn grbl(file: &MachineFile, link: Link, dialect: &str) -> Result<Devices, SetupError> {
    let dialect = Dialect::named(dialect)?.with(&file.machine, &file.probe)?;
    let (driver, halt) = Grbl::new(link, &file.machine, dialect.clone());
    Ok(Devices::new(Controller::spawn(driver, halt), dialect))
}
