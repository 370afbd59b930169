//! Against real LinuxCNC (Debian packages linuxcnc-uspace and linuxcnc-uspace-dev). Without it the
//! trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they fail.

mod interpreter;
mod machine;
mod rig;

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
    let rs274 = |name, trial| with(name, "rs274", trial);
    let machine = |name, trial| with(name, "linuxcncrsh", trial);
    let trials = vec![
        rs274("rs274_reads_every_program_as_we_do", interpreter::reads_as_we_do),
        rs274("rs274_disagrees_with_another_program", interpreter::another_disagrees),
        machine("linuxcnc_finds_the_true_centre", machine::finds_the_true_centre),
        machine(
            "linuxcnc_missed_touch",
            machine::a_touch_without_contact_ends_everything_until_it_is_prepared_again,
        ),
        machine(
            "linuxcnc_contact_in_a_guarded_move",
            machine::a_contact_in_a_guarded_move_stops_it,
        ),
        machine("linuxcnc_contact_in_a_rapid", machine::a_contact_in_a_rapid_stops_it),
        machine("linuxcnc_faulty_probe", machine::a_probe_that_does_not_open_or_close_is_found),
        machine("linuxcnc_halt", machine::a_halt_holds_and_nothing_moves_after_it),
        machine("linuxcnc_emergency_stop", machine::the_emergency_stop_is_named),
        machine("linuxcnc_limit", machine::a_limit_is_told_in_the_controls_words),
        machine("linuxcnc_offsets_of_the_user", machine::the_users_offsets_are_respected),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
