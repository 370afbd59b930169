//! `trued serve`: one machine waits for whoever may start it.

use std::path::Path;
use std::sync::Arc;

use super::Exit;
use super::args::ServeArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::run::{check_folder, runtime};
use super::signals::stop_on_signals;
use crate::methods;
use crate::service::{Config, Ended, Service};
use crate::setup::{MachineFile, SetupError};

pub fn serve(args: &ServeArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let machine = MachineFile::read(&args.machine).map_err(SetupError::from)?;
    machine.check_method_names(&methods::NAMES).map_err(SetupError::from)?;
    let config: Option<Config> = machine.serve().map_err(SetupError::from)?;
    let config = config.ok_or_else(|| {
        Failure::new(
            format!("{}: it has no section [serve]", args.machine.display()),
            "say there which cycles may be started, and by whom; docs/modbus.md tells how",
        )
    })?;
    let log = Arc::new(|words: &str| tell!("{words}"));
    let service = Service::new(machine, config, state_folder(state)?, args.speed.into(), log)?;
    let service = match &args.capture {
        Some(file) => {
            check_folder(file, "the captures", "--capture")?;
            service.capturing(file.clone())
        }
        None => service,
    };
    stop_on_signals(service.halt())?;
    match runtime()?.block_on(service.serve())? {
        Ended::Waiting => Ok(Exit::Pass),
        Ended::Held => Ok(Exit::Stopped),
    }
}
