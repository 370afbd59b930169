//! `trued backup`: copies the journal while it may be written.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::BackupArgs;
use crate::store;

pub fn backup_command(args: &BackupArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let copied = store::backup(&state_folder(state)?, &args.file)?;
    let file = args.file.display();
    match copied.newest_run {
        Some(run) => outln!("{file}: complete and verified, with all runs up to {run}"),
        None => outln!("{file}: complete and verified, without runs"),
    }
    if !copied.has_row_checksums {
        outln!("the journal was written by an older version without checksums: its values are not verified");
    }
    Ok(())
}
