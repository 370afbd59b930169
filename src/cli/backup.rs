//! `trued backup`: copies the journal while it may be written.

use std::path::Path;

use super::Exit;
use super::failure::Failure;
use super::files::state_folder;
use super::result_args::BackupArgs;
use crate::store;

pub fn backup(args: &BackupArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let copied = store::backup(&state_folder(state)?, &args.file)?;
    let until = copied.newest.map_or("no runs yet".to_owned(), |run| format!("up to run {run}"));
    say!("{}: whole, {until}", args.file.display());
    if !copied.has_checksums {
        say!("an older version wrote this journal, without checksums: its values are not verified");
    }
    Ok(Exit::Pass)
}
