//! Against real LinuxCNC (Debian packages linuxcnc-uspace and linuxcnc-uspace-dev). Without it the
//! trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they fail.

mod cycle;
mod interpreter;
mod machine;
mod rig;

use libtest_mimic::{Arguments, Completion, Failed, Trial};

/// Run `trial` unless something is missing.
fn with(
    name: &str,
    missing: fn() -> Option<&'static str>,
    trial: fn() -> Result<(), Failed>,
) -> Trial {
    Trial::ignorable_test(name, move || match missing() {
        None => trial().map(|()| Completion::Completed),
        Some(reason) if std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1") => {
            Err(reason.into())
        }
        Some(reason) => Ok(Completion::ignored_with(reason)),
    })
}

fn is_here(command: &str) -> bool {
    std::env::var_os("PATH")
        .is_some_and(|path| std::env::split_paths(&path).any(|dir| dir.join(command).is_file()))
}

fn no_interpreter() -> Option<&'static str> {
    (!is_here("rs274")).then_some("LinuxCNC is not here: apt-get install linuxcnc-uspace")
}

fn no_rig() -> Option<&'static str> {
    if !is_here("linuxcncrsh") || !is_here("halcompile") {
        return Some("LinuxCNC is not here: apt-get install linuxcnc-uspace linuxcnc-uspace-dev");
    }
    let id = std::process::Command::new("id").arg("-u").output().ok()?;
    (id.stdout != b"0\n").then_some("the rig installs a HAL component: run it as root")
}

fn main() {
    let rs274 = |name, trial| with(name, no_interpreter, trial);
    let machine = |name, trial| with(name, no_rig, trial);
    let trials = vec![
        rs274("rs274_reads_every_program_as_we_do", interpreter::reads_as_we_do),
        rs274("rs274_disagrees_with_another_program", interpreter::another_disagrees),
        rs274("rs274_reads_whole_plans_as_we_do", interpreter::reads_whole_plans_as_we_do),
        machine("linuxcnc_self_calibration", cycle::finds_the_true_axis_wherever_the_part_stands),
        machine("linuxcnc_stop", cycle::a_stop_holds_and_keeps_what_was_read),
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
        machine("linuxcnc_hangs", machine::a_control_that_hangs_is_given_up)
            .with_ignored_flag(true),
        machine("linuxcnc_offsets_of_the_user", machine::the_users_offsets_are_respected),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
