//! Opens what the machine file names and puts it together. One simulated world is shared by
//! everything that is simulated.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::machine_file::{Control, MachineFile};
use super::{Pace, SetupError};
use crate::base::Clock;
use crate::base::clock::HostClock;
use crate::controllers::{Bench, Controller, Served, Simulated};
use crate::gcode::Dialect;
use crate::link::faults::{BadWire, Planned};
use crate::record::reading::Reading;
use crate::world::{Truth, World};

/// The machine as a run needs it.
pub struct Devices {
    pub controller: Controller,
    /// The language the control is spoken to; every stage is rendered and read back before it moves.
    pub dialect: Dialect,
    /// Used where the control does not stamp its readings.
    pub clock: Arc<dyn Clock>,
    /// The other end of the wire, if this program serves it; dropped after the controller.
    _served: Option<Served>,
}

impl Devices {
    /// A control that is open already, timed by the host's clock where it does not stamp.
    pub fn new(controller: Controller, dialect: Dialect) -> Self {
        Self { controller, dialect, clock: Arc::new(HostClock::start()), _served: None }
    }
}

/// What a run has seen of its machine in earlier sessions: a simulated one lives on from there.
#[derive(Debug, Clone, Copy, Default)]
pub struct Past<'a> {
    pub readings: &'a [Reading],
    /// Since the last of them.
    pub elapsed_s: f64,
}

/// The language of the machine's control, with what the machine file adds to it.
pub fn dialect(file: &MachineFile) -> Result<Dialect, SetupError> {
    let named = Dialect::named(file.controller.control.dialect())?;
    Ok(named.with(&file.machine, &file.probe)?)
}

/// Open the machine's control. Call inside a tokio runtime.
pub async fn devices(
    file: &MachineFile,
    pace: Pace,
    past: Past<'_>,
) -> Result<Devices, SetupError> {
    let dialect = dialect(file)?;
    match &file.controller.control {
        Control::Simulated(simulated) => {
            let bench = bench(file, simulated, pace, past)?;
            let (controller, served) = simulated.open(bench, dialect.clone()).await?;
            Ok(Devices { _served: served, ..Devices::new(controller, dialect) })
        }
        Control::Real(control) => {
            let controller = control.open(&file.machine, dialect.clone()).await?;
            Ok(Devices::new(controller, dialect))
        }
    }
}

/// Serve the simulated machine of `file` to whoever opens its wire; of a file with a real control, a
/// simulated one in its place.
pub fn simulator(file: &MachineFile, pace: Pace) -> Result<Served, SetupError> {
    let simulated = simulated(file);
    Ok(simulated.serve(bench(file, &simulated, pace, Past::default())?)?)
}

/// As [`simulator`], behind a bad wire; `tell` hears what it does, and when.
pub fn bad_simulator(
    file: &MachineFile,
    pace: Pace,
    wire: BadWire,
    tell: fn(Duration, Planned),
) -> Result<Served, SetupError> {
    let simulated = simulated(file);
    Ok(simulated.serve_badly(bench(file, &simulated, pace, Past::default())?, wire, tell)?)
}

fn simulated(file: &MachineFile) -> Simulated {
    match &file.controller.control {
        Control::Simulated(simulated) => *simulated,
        Control::Real(_) => Simulated::default(),
    }
}

/// The simulated truth of a machine file.
pub fn world(file: &MachineFile) -> Result<World, SetupError> {
    let truth: Truth = file.simulated()?.unwrap_or_default();
    Ok(World::new(&file.machine, &file.probe, &file.artefact, &truth)?)
}

fn bench<'a>(
    file: &'a MachineFile,
    simulated: &Simulated,
    pace: Pace,
    past: Past<'_>,
) -> Result<Bench<'a>, SetupError> {
    let mut world = world(file)?;
    if let Some(last) = past.readings.last() {
        world.pass(last.t_s + past.elapsed_s, past.readings.iter().map(|reading| reading.step));
    }
    let world = Arc::new(Mutex::new(world));
    let faults = file.simulated_faults(simulated)?;
    Ok(Bench { machine: &file.machine, world, pace, faults })
}
