//! `trued serve` over HTTP and over a line of text: cycles, lists, roles, hostile and slow clients.

mod again;
mod asks;
mod audited;
pub mod crowd;
mod hostile;
mod line;
mod lists;
mod page;
mod people;
mod person;
mod prompts;
mod refused_config;
mod several;
mod slow;
mod tokens;
mod watched;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 40;
        slow::slow_clients_are_disconnected,
        lists::idle_listener_receives_signs_of_life,
    ]
    .with(trials![Pool::Waiting, 20;
        lists::page_shows_the_result_after_a_restart,
        page::page_holds_a_run,
        several::two_machines_run_at_once,
        audited::holds_are_audited,
        audited::reasons_are_audited,
    ])
    .with(trials![Pool::Waiting, 0;
        line::line_protocol_starts_a_cycle,
        page::page_starts_a_cycle,
        lists::run_list_is_paged,
        lists::input_errors_are_explained,
        again::resumed_run_in_the_page,
        again::signed_estimate,
        person::page_does_not_override_the_machine,
        person::lost_position_needs_a_person,
        person::run_is_resumed_at_the_command_line,
        page::other_origins_are_refused,
        asks::command_line_asks_the_daemon_for_a_cycle,
        asks::other_machine_file_is_refused,
        asks::daemon_without_page,
        prompts::prompts_are_answered_in_the_page,
        prompts::run_is_stopped_at_a_prompt,
        prompts::prompts_are_answered_at_a_terminal,
        watched::live_values_over_http,
        watched::live_values_at_a_terminal,
        several::invalid_machine_files_are_refused,
        hostile::roles_limit_actions,
        hostile::session_cookie_is_protected_and_ends,
        hostile::repeated_wrong_tokens_are_limited,
        people::refusals_for_people_and_programs,
        hostile::hostile_paths_are_refused,
        tokens::tokens_created_by_root,
        tokens::unreadable_token_file,
        audited::audit_log_is_paged,
        audited::vanished_client_is_audited,
        refused_config::invalid_serve_sections_are_refused,
    ])
    // A thousand connections: other trials would disturb the load and the daemon's memory.
    .with(trials![Pool::Alone, 10;
        crowd::many_clients_during_a_run,
        crowd::many_clients_during_a_hold,
        crowd::idle_connections_delay_no_hold,
        crowd::event_streams_are_limited,
    ])
}
