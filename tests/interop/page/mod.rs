//! The page as an operator uses it: headless Chromium behind chromedriver, connected to the program. The browser
//! and its driver are Debian's `chromium` and `chromium-driver`; axe-core, which checks accessibility, is built by
//! `tests/peers/axe/fetch`. Without them these trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1`
//! they fail. Pictures of the pages are in `page` below the target directory.

mod accessibility;
mod browser;
mod cycle;
mod live_updates;
mod restart;
mod sensor_setup;
mod states;
mod webdriver;

use std::path::{Path, PathBuf};

use crate::support::harness::{Pool, Trials, is_command_in_path, trials};

const MISSING_BROWSER_REASON: &str =
    "chromedriver or axe-core is missing: apt-get install chromium chromium-driver; tests/peers/axe/fetch";

/// The file that `tests/peers/axe/fetch` creates.
fn axe_script_path() -> Option<PathBuf> {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent()?;
    let file = target.join("peers/axe-4.12.1/axe.min.js");
    file.is_file().then_some(file)
}

fn missing_browser() -> Option<&'static str> {
    (!is_command_in_path("chromedriver") || axe_script_path().is_none()).then_some(MISSING_BROWSER_REASON)
}

pub fn trials() -> Trials {
    trials![Pool::Browser, 30;
        cycle::run_is_held_resumed_and_signed,
        states::disconnected_page_hides_a_result_out_of_tolerance,
        sensor_setup::sensor_values_update_while_a_name_is_typed,
        live_updates::page_of_stalled_daemon_shows_no_live_values,
        live_updates::idle_page_shows_changes_and_keeps_input,
        states::page_without_its_script_hides_the_state_after_a_time,
        states::page_works_without_script,
        restart::waiting_page_reconnects_after_restarts,
        restart::measuring_and_held_pages_reconnect_after_a_restart,
        restart::failed_page_reconnects_after_a_restart,
        restart::page_with_an_open_prompt_reconnects_after_a_restart,
        restart::hold_without_a_response_is_reported_on_the_page,
        restart::page_of_a_signed_in_tablet_leads_to_the_sign_in_after_a_restart,
        restart::machines_overview_reconnects_after_a_restart,
    ]
    .requires_peer(missing_browser)
}
