//! `trued serve`: starts the daemon, which runs cycles on request.

use std::path::Path;

use super::ExitStatus;
use super::args::ServeArgs;
use super::failure::CommandFailure;
use super::files::state_folder;
use super::run::check_parent_folder;
use super::signals::start_signal_halt_thread;
use crate::service::{DaemonFile, ExitState, Service, log_destination};
use crate::setup::SetupError;

/// `trued serve`: runs the daemon until it is shut down; with `--check`, only checks the plans.
pub fn serve_command(args: &ServeArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let file = match (&args.config, &args.machine) {
        (Some(config), _) => DaemonFile::read(config),
        (None, Some(machine)) => DaemonFile::for_machine_file(machine),
        (None, None) => DaemonFile::built_in(),
    };
    let file = file.map_err(SetupError::from)?;
    let log = log_destination::start_log();
    let service = Service::new(file, state_folder(state)?, args.speed.into(), log)?;
    let service = match &args.capture {
        Some(file) => {
            check_parent_folder(file, "the captures", "--capture")?;
            service.with_captures(file.clone())
        }
        None => service,
    };
    if args.check {
        service.check_plans()?;
        return Ok(ExitStatus::Pass);
    }
    start_signal_halt_thread(service.shut_down_handle())?;
    match service.serve()? {
        ExitState::NoRunInProgress => Ok(ExitStatus::Pass),
        ExitState::RunHeld => Ok(ExitStatus::Stopped),
    }
}
