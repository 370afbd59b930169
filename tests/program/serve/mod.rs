//! `trued serve` over HTTP and over a line of text: cycles, lists, roles, hostile and slow clients.

mod api_errors;
mod audit_log;
pub mod crowd;
pub mod hostile_requests;
mod line_trigger;
mod lists;
mod live_values;
mod operator_confirmations;
mod page_requests;
mod prompts;
mod refusal_formats;
mod refused_config;
mod resume_and_sign;
mod run_beside_daemon;
mod run_files;
mod slow_clients;
mod tokens;
mod two_machines;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 40;
        slow_clients::slow_clients_are_disconnected,
        lists::idle_listener_receives_signs_of_life,
    ]
    .with_trials(trials![Pool::Waiting, 20;
        lists::page_shows_the_result_after_a_restart,
        page_requests::page_holds_a_run,
        two_machines::two_machines_run_at_once,
        audit_log::holds_are_audited,
        audit_log::reasons_are_audited,
    ])
    .with_trials(trials![Pool::Waiting, 0;
        line_trigger::line_protocol_starts_a_cycle,
        page_requests::page_starts_a_cycle,
        api_errors::every_error_is_a_problem_in_json,
        api_errors::head_and_options_are_answered,
        run_files::downloads_equal_the_exported_files,
        lists::run_and_reading_lists_are_paged,
        lists::input_errors_are_explained,
        resume_and_sign::resume_from_the_page_needs_all_confirmations,
        resume_and_sign::signature_needs_a_name_and_the_current_estimate,
        operator_confirmations::page_confirmation_does_not_override_machine_interlocks,
        operator_confirmations::homing_must_be_confirmed_after_a_control_reset,
        operator_confirmations::held_run_is_resumed_at_the_command_line,
        page_requests::foreign_origins_and_malformed_requests_are_refused,
        run_beside_daemon::trued_run_requests_the_cycle_from_a_running_daemon,
        run_beside_daemon::other_machine_file_is_refused,
        run_beside_daemon::run_beside_a_daemon_without_page_names_its_process,
        prompts::prompts_are_answered_in_the_page,
        prompts::answer_after_a_stop_at_a_prompt_is_refused,
        prompts::prompts_are_answered_at_a_terminal,
        live_values::live_values_are_sent_over_http_and_not_stored,
        live_values::live_values_are_shown_at_a_terminal,
        two_machines::invalid_multi_machine_configs_are_refused,
        hostile_requests::roles_limit_actions,
        hostile_requests::session_cookie_is_protected_and_ends,
        hostile_requests::repeated_wrong_tokens_are_limited,
        refusal_formats::refusals_are_pages_for_browsers_and_json_for_programs,
        hostile_requests::hostile_paths_and_malformed_requests_are_refused,
        tokens::daemon_of_another_user_reads_tokens_created_by_root,
        tokens::unreadable_token_file_refuses_all_but_holds,
        audit_log::audit_log_is_paged,
        audit_log::request_of_a_disconnected_client_is_audited,
        refused_config::invalid_serve_sections_are_refused,
    ])
    // A thousand connections: other trials would disturb the load and the daemon's memory.
    .with_trials(trials![Pool::Alone, 10;
        crowd::many_clients_change_no_result_and_memory_growth_is_limited,
        crowd::hold_works_with_many_clients,
        crowd::repeated_idle_connections_block_no_hold,
        crowd::event_streams_are_limited,
    ])
}
