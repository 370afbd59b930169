//! The machine of one file, which can be opened repeatedly. Its simulated parts share one world that persists
//! between the openings.

use std::sync::Arc;

use super::machine_file::{ControlConfig, MachineFile};
use super::{Devices, EarlierSessions, SetupError, SimulatedMachine, SimulationPace, machine_dialect, prove_mode_text};
use devices::controllers::ControllerConfig;
use link::Clock;
use link::clock::HostClock;
use simulator::SimulatedOperator;

/// Real or simulated machine of a machine file; its devices are open only in the `Devices` that `open` returns.
pub struct ReopenableMachine<'a> {
    file: &'a MachineFile,
    machine: MachineKind<'a>,
}

/// The part of a machine that persists between two openings.
enum MachineKind<'a> {
    /// Configuration of the control; each opening connects anew.
    Real(Arc<dyn ControllerConfig>),
    /// Simulated control and sensors, with one world that persists between the openings.
    Simulated(SimulatedMachine<'a>),
}

impl<'a> ReopenableMachine<'a> {
    /// A machine whose devices are not open.
    ///
    /// # Errors
    /// The simulated world cannot be built.
    pub fn new(file: &'a MachineFile) -> Result<Self, SetupError> {
        let machine = match &file.controller_section.control {
            ControlConfig::Simulated(_) => MachineKind::Simulated(SimulatedMachine::new(file)?),
            ControlConfig::Real(control) => MachineKind::Real(control.clone()),
        };
        Ok(Self { file, machine })
    }

    /// Opens the machine's control. Call inside a tokio runtime. A simulated control is switched off and on
    /// between two openings; its axes keep their positions.
    ///
    /// # Errors
    /// The dialect is invalid, or the control cannot be opened.
    pub async fn open(&self, pace: SimulationPace) -> Result<Devices, SetupError> {
        let dialect = machine_dialect(self.file)?;
        match &self.machine {
            MachineKind::Simulated(simulated) => simulated.open(dialect, pace).await,
            MachineKind::Real(control) => {
                let clock: Arc<dyn Clock> = Arc::new(HostClock::start());
                let machine = &self.file.machine;
                let modes = prove_mode_text(&dialect, machine, control.result_log_path())?;
                let opening = control.open(machine, modes, clock.clone());
                let devices = Devices::with_clock(opening.await?, dialect, clock);
                Ok(devices.with_sensors(self.file, None))
            }
        }
    }

    /// The simulated operator of a simulated machine; `None` for a real one.
    pub fn simulated_operator(&self) -> Option<SimulatedOperator> {
        match &self.machine {
            MachineKind::Simulated(simulated) => Some(simulated.simulated_operator()),
            MachineKind::Real(_) => None,
        }
    }
}

/// Opens the control of `file`; its sensors are opened when a run needs them. A simulated machine is first advanced
/// to the time after `history`. Call inside a tokio runtime.
pub async fn open_devices(
    file: &MachineFile,
    pace: SimulationPace,
    history: EarlierSessions<'_>,
) -> Result<Devices, SetupError> {
    let reopenable = ReopenableMachine::new(file)?;
    if let MachineKind::Simulated(simulated) = &reopenable.machine {
        simulated.advance_past_sessions(history);
    }
    reopenable.open(pace).await
}
