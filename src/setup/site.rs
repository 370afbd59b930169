//! The machine of one file, which can be opened repeatedly. Its simulated parts share one world that persists
//! between the openings.

use std::sync::Arc;

use super::machine_file::{Control, MachineFile};
use super::{Devices, Pace, Rehearsal, RunHistory, SetupError, dialect, modes};
use devices::controllers::Named;
use link::Clock;
use link::clock::HostClock;
use simulator::SimulatedOperator;

pub struct Site<'a> {
    file: &'a MachineFile,
    machine: Behind<'a>,
}

enum Behind<'a> {
    Real(Arc<dyn Named>),
    Simulated(Rehearsal<'a>),
}

impl<'a> Site<'a> {
    /// A site with nothing open.
    ///
    /// # Errors
    /// The simulated world cannot be built.
    pub fn new(file: &'a MachineFile) -> Result<Self, SetupError> {
        let machine = match &file.controller.control {
            Control::Simulated(_) => Behind::Simulated(Rehearsal::of(file)?),
            Control::Real(control) => Behind::Real(control.clone()),
        };
        Ok(Self { file, machine })
    }

    /// Advances a simulated machine to the time after `past`.
    pub(super) fn after(self, past: RunHistory<'_>) -> Self {
        if let Behind::Simulated(rehearsal) = &self.machine {
            rehearsal.after(past);
        }
        self
    }

    /// Opens the machine's control. Call inside a tokio runtime. A simulated control is switched off and on
    /// between two openings; its axes keep their positions.
    ///
    /// # Errors
    /// The dialect is invalid, or the control cannot be opened.
    pub async fn open(&self, pace: Pace) -> Result<Devices, SetupError> {
        let dialect = dialect(self.file)?;
        match &self.machine {
            Behind::Simulated(rehearsal) => rehearsal.open(dialect, pace).await,
            Behind::Real(control) => {
                let clock: Arc<dyn Clock> = Arc::new(HostClock::start());
                let machine = &self.file.machine;
                let modes = modes(&dialect, machine, control.log())?;
                let opening = control.open(machine, modes, clock.clone());
                let devices = Devices::timed(opening.await?, dialect, clock);
                Ok(devices.of(self.file, None))
            }
        }
    }

    /// The simulated operator of a simulated machine; `None` for a real one.
    pub fn bystander(&self) -> Option<SimulatedOperator> {
        match &self.machine {
            Behind::Simulated(rehearsal) => Some(rehearsal.bystander()),
            Behind::Real(_) => None,
        }
    }
}

/// Opens the devices of `file`. Call inside a tokio runtime.
pub async fn devices(
    file: &MachineFile,
    pace: Pace,
    past: RunHistory<'_>,
) -> Result<Devices, SetupError> {
    Site::new(file)?.after(past).open(pace).await
}
