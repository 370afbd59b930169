//! Against real LinuxCNC (Debian packages linuxcnc-uspace and linuxcnc-uspace-dev). Without it the
//! trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they fail.

mod interpreter;

use libtest_mimic::{Arguments, Completion, Failed, Trial};

/// Run `trial` if `command` is on this machine.
fn with(name: &str, command: &'static str, trial: fn() -> Result<(), Failed>) -> Trial {
    Trial::ignorable_test(name, move || {
        let here = std::env::var_os("PATH").is_some_and(|path| {
            std::env::split_paths(&path).any(|dir| dir.join(command).is_file())
        });
        if here {
            return trial().map(|()| Completion::Completed);
        }
        let reason = format!(
            "`{command}` is not installed: apt-get install linuxcnc-uspace linuxcnc-uspace-dev"
        );
        if std::env::var_os("TRUED_REQUIRE_PEERS").is_some_and(|value| value == "1") {
            return Err(reason.into());
        }
        Ok(Completion::ignored_with(reason))
    })
}

fn main() {
    let trials = vec![
        with("rs274_reads_every_program_as_we_do", "rs274", interpreter::reads_as_we_do),
        with("rs274_disagrees_with_another_program", "rs274", interpreter::another_disagrees),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
