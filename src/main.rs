//! Entry point of the program. The code is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    trued::cli::main()
}
