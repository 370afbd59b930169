//! `trued serve`: starts the daemon, which runs cycles on request.

use std::path::Path;

use super::Exit;
use super::args::ServeArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::run::check_folder;
use super::signals::stop_on_signals;
use crate::service::{DaemonFile, Ended, Service, telemetry};
use crate::setup::SetupError;

pub fn serve(args: &ServeArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let file = match (&args.config, &args.machine) {
        (Some(config), _) => DaemonFile::read(config),
        (None, Some(machine)) => DaemonFile::of_machine(machine),
        (None, None) => DaemonFile::built_in(),
    };
    let DaemonFile { machines, http, retention } = file.map_err(SetupError::from)?;
    let log = telemetry::start();
    let service = Service::new(machines, http, state_folder(state)?, args.speed.into(), log)?;
    let service = match &args.capture {
        Some(file) => {
            check_folder(file, "the captures", "--capture")?;
            service.capturing(file.clone())
        }
        None => service,
    };
    let service = service.retaining(retention);
    if args.check {
        service.check()?;
        return Ok(Exit::Pass);
    }
    stop_on_signals(service.halt())?;
    match service.serve()? {
        Ended::Waiting => Ok(Exit::Pass),
        Ended::Held => Ok(Exit::Stopped),
    }
}
