//! The machine of one file, to be opened as often as it takes: what is simulated of it is one world
//! that goes on meanwhile.

use std::sync::Arc;

use super::machine_file::{Control, MachineFile};
use super::{Devices, Pace, Past, Rehearsal, SetupError, dialect, modes};
use devices::controllers::Named;
use link::Clock;
use link::clock::HostClock;
use simulator::Bystander;

pub struct Site<'a> {
    file: &'a MachineFile,
    machine: Behind<'a>,
}

enum Behind<'a> {
    Real(Arc<dyn Named>),
    Simulated(Rehearsal<'a>),
}

impl<'a> Site<'a> {
    /// Nothing is opened yet.
    ///
    /// # Errors
    /// A simulated world that cannot be built.
    pub fn new(file: &'a MachineFile) -> Result<Self, SetupError> {
        let machine = match &file.controller.control {
            Control::Simulated(_) => Behind::Simulated(Rehearsal::of(file)?),
            Control::Real(control) => Behind::Real(control.clone()),
        };
        Ok(Self { file, machine })
    }

    /// Later than it was, as a run has seen it.
    pub(super) fn after(self, past: Past<'_>) -> Self {
        if let Behind::Simulated(rehearsal) = &self.machine {
            rehearsal.after(past);
        }
        self
    }

    /// Open the machine's control. Call inside a tokio runtime. A simulated one was switched off and
    /// on meanwhile; its axes stay where they are.
    ///
    /// # Errors
    /// What the dialect or opening says.
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

    /// Somebody beside the simulated machine; `None` beside a real one.
    pub fn bystander(&self) -> Option<Bystander> {
        match &self.machine {
            Behind::Simulated(rehearsal) => Some(rehearsal.bystander()),
            Behind::Real(_) => None,
        }
    }
}

/// Open the machine's control. Call inside a tokio runtime.
pub async fn devices(
    file: &MachineFile,
    pace: Pace,
    past: Past<'_>,
) -> Result<Devices, SetupError> {
    Site::new(file)?.after(past).open(pace).await
}
