//! `trued generate`: shell completions and man pages, from the definition of the command line.

use clap::CommandFactory as _;
use clap_complete::{Shell, generate_to};

use super::args::{Cli, GenerateArgs};
use super::failure::CommandFailure;

/// Shells for which completions are written.
const SHELLS: [Shell; 3] = [Shell::Bash, Shell::Zsh, Shell::Fish];

/// Writes the completions of the shells, and one man page for the program and one for each command.
pub fn generate_command(args: &GenerateArgs) -> Result<(), CommandFailure> {
    let folder = &args.folder;
    let file_error = |error: std::io::Error| CommandFailure::from_file_error(folder, &error);
    std::fs::create_dir_all(folder).map_err(file_error)?;
    for shell in SHELLS {
        generate_to(shell, &mut Cli::command(), "trued", folder).map_err(file_error)?;
    }
    clap_mangen::generate_to(Cli::command(), folder).map_err(file_error)?;
    Ok(())
}
