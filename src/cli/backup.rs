//! `trued backup`: copies the journal while it may be written.

use std::path::Path;

use super::ExitStatus;
use super::failure::Failure;
use super::files::state_folder;
use super::result_args::BackupArgs;
use crate::store;

pub fn backup_command(args: &BackupArgs, state: Option<&Path>) -> Result<ExitStatus, Failure> {
    let copied = store::backup(&state_folder(state)?, &args.file)?;
    let until = copied.newest_run.map_or("without runs".to_owned(), |run| format!("with all runs up to {run}"));
    outln!("{}: complete and verified, {until}", args.file.display());
    if !copied.has_row_checksums {
        outln!("the journal was written by an older version without checksums: its values are not verified");
    }
    Ok(ExitStatus::Pass)
}
