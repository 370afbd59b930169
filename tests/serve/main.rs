//! `trued serve` as a machine's PLC sees it, and as whoever comes over HTTP does. For the first pymodbus is the client (`tests/peers/pymodbus/install`, or
//! `TRUED_PYMODBUS`). Without it these trials are skipped, with the reason; with
//! `TRUED_REQUIRE_PEERS=1` they fail.

mod abuse;
mod again;
mod asks;
mod audited;
mod client;
mod crowd;
mod hostile;
mod line;
mod lists;
mod page;
mod people;
mod person;
mod prompts;
#[path = "../support/pymodbus.rs"]
mod pymodbus;
mod several;
mod shop;
mod slow;
mod starts;
mod stops;
mod tokens;
#[path = "../support/waiting.rs"]
mod waiting;

use libtest_mimic::{Completion, Failed, Trial};
use pymodbus::{MISSING, python};
use waiting::{alone, watched};

fn with_pymodbus(name: &str, run: fn()) -> Trial {
    let own = name.to_owned();
    Trial::ignorable_test(name, move || match python() {
        Some(_) => {
            watched(own, run);
            Ok(Completion::Completed)
        }
        None if std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1") => {
            Err(Failed::from(MISSING))
        }
        None => Ok(Completion::ignored_with(MISSING)),
    })
}

fn main() {
    if let Some((port, token)) = crowd::asked_for() {
        return crowd::be(port, &token);
    }
    if let Some((port, from)) = crowd::asked_to_connect() {
        return crowd::only_connect(port, from);
    }
    let trials = vec![
        with_pymodbus("a_coil_starts_a_cycle_and_registers_tell", starts::a_cycle),
        with_pymodbus("each_run_is_captured_by_itself", starts::captures),
        with_pymodbus("each_refusal_has_its_reason", starts::refusals),
        with_pymodbus("a_sign_of_life_that_stops_takes_the_enable_with_it", starts::stale),
        with_pymodbus("nonsense_floods_and_half_open_lines_disturb_nothing", abuse::of_all_kinds),
        with_pymodbus("connections_left_behind_make_room", abuse::left_behind),
        with_pymodbus("only_who_is_allowed_may_connect", abuse::strangers),
        with_pymodbus("a_stop_holds_until_somebody_acknowledges", stops::by_a_coil),
        with_pymodbus("a_cycle_that_fails_waits_for_an_acknowledgement", stops::by_a_fault),
        with_pymodbus("a_lost_position_is_not_acknowledged_away", stops::position_lost),
        with_pymodbus("a_person_who_resumes_has_the_machine", stops::elsewhere),
        with_pymodbus("sigterm_just_after_a_start_is_a_stop", stops::at_once),
        with_pymodbus("sigterm_holds_and_the_next_service_waits", stops::by_sigterm),
        alone("a_line_of_text_starts_a_cycle", line::starts),
        alone("a_cycle_is_started_from_the_page_and_told_as_elsewhere", page::a_cycle),
        alone("a_hold_from_the_page_waits_for_an_acknowledgement", page::a_hold),
        alone("a_verdict_has_its_time_and_outlives_a_restart", lists::a_verdict),
        alone("what_is_long_comes_by_pages", lists::pages),
        alone("a_slip_is_told_in_words", lists::slips),
        alone("a_listener_hears_that_the_service_lives", lists::signs_of_life),
        alone("a_held_run_is_resumed_by_somebody_with_a_name", again::resumed),
        alone("a_result_is_signed_as_it_was_read", again::signed),
        alone("no_person_vouches_against_the_machine", person::against_the_machine),
        alone("a_lost_position_is_left_by_who_has_homed", person::leaves_a_lost_position),
        alone("a_run_that_goes_on_elsewhere_is_seen", person::resumes_elsewhere),
        alone("who_is_not_the_page_gets_nothing_done", page::strangers),
        alone("the_command_asks_the_daemon_that_has_the_machine", asks::a_cycle),
        alone("the_command_measures_by_the_daemons_file_or_not_at_all", asks::another_file),
        alone("a_daemon_without_a_page_is_named", asks::no_page),
        alone("what_is_asked_is_answered_once_by_whoever_may", prompts::answered),
        alone("a_run_that_waits_for_a_person_is_held_and_killed", prompts::stopped),
        alone("enter_at_a_terminal_answers_a_run", prompts::at_a_terminal),
        alone("two_machines_of_one_daemon_measure_at_once", several::machines),
        alone("a_daemon_file_that_means_nothing_is_refused", several::bad_files),
        alone("each_role_may_what_it_may_and_no_more", hostile::roles),
        alone("a_session_is_a_browsers_own", hostile::sessions),
        alone("too_often_is_refused_but_no_hold", hostile::too_often),
        alone("somebody_at_a_browser_is_refused_in_words", people::refused),
        alone("no_path_leads_round_the_door", hostile::paths),
        alone("who_does_not_get_on_is_shown_out", slow::shown_out),
        alone("a_thousand_connections_disturb_no_run", crowd::beside_a_run),
        alone("a_hold_comes_through_a_thousand_connections", crowd::and_a_hold),
        alone("a_hold_comes_through_those_who_only_connect", crowd::who_only_connect),
        alone("many_listeners_of_one_caller_leave_the_tablet_alone", crowd::listeners),
        alone("what_root_revokes_is_revoked", tokens::by_root),
        alone("without_a_list_of_tokens_nobody_is_let_in", tokens::unreadable),
        alone("holds_are_all_done_and_counted", audited::holds),
        alone("the_audit_log_is_read_by_pages", audited::pages),
        alone("each_call_may_say_why", audited::reasons),
        alone("who_has_gone_stands_in_the_audit_log", audited::gone),
        alone("a_section_that_is_not_safe_is_refused", shop::bad_sections),
    ];
    waiting::run(trials);
}
