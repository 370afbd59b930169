//! Keys of `[controller]` of kind `linuxcnc`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::files::log_name;
use super::{LinuxCnc, Sampler, Settings, sampler};
use crate::controllers::{Controller, ControllerError, Diagnosing, Leave, Named, Opening};
use link::Clock;
use link::{Address, HostPort};
use machine::Axis;
use machine::record::machine::Machine;
use planning::proof::ProvenModes;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Address of linuxcncrsh.
    #[serde(default = "usual_address")]
    pub(super) tcp: HostPort,
    /// Folder of the programs and their result logs; the control must see the same folder.
    program_dir: PathBuf,
    /// INI file of the control, for values that the control does not report.
    ini: Option<PathBuf>,
    #[serde(default = "dialect")]
    dialect: String,
    /// Sampler that timestamps positions during motion.
    sampler: Option<sampler::Config>,
}

/// Port 5007 is linuxcncrsh's own default.
fn usual_address() -> HostPort {
    HostPort::local(5007)
}

fn dialect() -> String {
    "linuxcnc".to_owned()
}

impl Named for Config {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn log(&self) -> Option<String> {
        Some(log_name(&self.program_dir))
    }

    fn at(&self) -> String {
        format!("{}, with files in {}", Address::from(&self.tcp), self.program_dir.display())
    }

    fn open<'a>(
        &'a self,
        machine: &'a Machine,
        modes: ProvenModes,
        clock: Arc<dyn Clock>,
    ) -> Opening<'a> {
        Box::pin(async move {
            let axes: Vec<Axis> = machine.axes.keys().copied().collect();
            let sampler = match &self.sampler {
                Some(sampler) => Some(Sampler::open(sampler, &axes, clock).await?),
                None => None,
            };
            let directory = self.program_dir.clone();
            let settings =
                Settings { address: (&self.tcp).into(), directory, axes, ini: self.ini.clone() };
            let (driver, halt) = LinuxCnc::open(settings, modes).await?;
            Ok(Controller::spawn(driver.stamped_by(sampler), halt))
        })
    }

    fn diagnose<'a>(
        &'a self,
        machine: &'a Machine,
        failed: &'a ControllerError,
        leave: Leave,
    ) -> Diagnosing<'a> {
        Box::pin(self.suspects(machine, failed, leave))
    }
}
