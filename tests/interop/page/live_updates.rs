//! Tests that a page that stays open for days shows the current state or none.

use std::thread::sleep;
use std::time::Duration;

use super::accessibility;
use super::browser::Browser;
use super::cycle::{page_url, quick_shop_with_http};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::MachineShop;

const MACHINE_NAME: &str = "simulated five-axis machine";
/// Text that a page without a connection must not show.
const LIVE_TEXTS: [&str; 6] = ["as of", "measuring", "time left", "Newest runs", "dawn", "armed"];

/// A machine with a schedule.
fn shop_with_schedule() -> MachineShop {
    let shop = quick_shop_with_http();
    let schedule = "[[serve.schedule]]\nname = \"dawn\"\ncycle = 1\nat = \"30 5 * * *\"\nzone = \"Europe/Berlin\"\n";
    shop.replace_in_machine_file(HTTP_SECTION, &format!("{schedule}{HTTP_SECTION}"));
    shop
}

/// The service computes the schedule a moment after it is ready.
fn open_page_with_schedule(browser: &Browser, daemon: &DaemonProcess) {
    let at = page_url(daemon);
    browser.client.open_url(&at).unwrap();
    for _ in 0..100 {
        if browser.visible_text("main").contains("dawn") {
            return;
        }
        sleep(Duration::from_millis(200));
        browser.client.open_url(&at).unwrap();
    }
    panic!("the schedule is not told");
}

/// The connection stays open but transmits nothing more.
pub fn page_of_stalled_daemon_shows_no_live_values() {
    let browser = Browser::open();
    let shop = shop_with_schedule();
    let daemon = shop.start_daemon("real");
    open_page_with_schedule(&browser, &daemon);
    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    browser.wait_for_text("#live", |text| text.starts_with("measuring") && text.contains("time left"));
    assert!(browser.visible_text("main").contains("dawn"));
    daemon.send_signal("STOP");
    let away = |text: &str| text.contains("no connection") && !text.contains("as of");
    let seen = browser.wait_for_text("main", away);
    assert!(LIVE_TEXTS.iter().all(|words| !seen.contains(words)), "{seen}");
    assert_eq!(browser.client.page_title().unwrap(), "no connection");
    // The hold button stays available without a connection.
    browser.wait_for_element("button.hold");
    accessibility::check_page_at_all_sizes(&browser, "stands-still");
    daemon.send_signal("CONT");
    let back = |text: &str| {
        !text.contains("no connection") && ["as of", "dawn", "Newest runs"].iter().all(|words| text.contains(words))
    };
    browser.wait_for_text("main", back);
}

/// A schedule is armed elsewhere: an idle page shows it after a minute. Open sections stay open, and typed text is
/// kept.
pub fn idle_page_shows_changes_and_keeps_input() {
    let browser = Browser::open();
    let shop = shop_with_schedule();
    let daemon = shop.start_daemon("fast");
    let client = &browser.client;
    open_page_with_schedule(&browser, &daemon);
    browser.wait_for_text("#schedule", |text| text.contains("not armed"));
    let touched = "document.querySelector('#arm details').open = true;
        document.querySelector('#arm [name=until]').value = '3d';
        window.untouched = true";
    client.execute_script(touched, &[]).unwrap();
    let armed = shop.run_trued(&["arm", MACHINE_NAME, "1", "--who", "Ada", "--until", "3d"]);
    assert!(armed.status.success(), "{armed:?}");
    // Advance the page's clock by a minute.
    let later = "const now = Date.now; Date.now = () => now() + 61000";
    client.execute_script(later, &[]).unwrap();
    browser.wait_for_text("#schedule", |text| text.contains("armed by Ada until"));
    let kept = "return [window.untouched, document.querySelector('#arm details').open,
        document.querySelector('#arm [name=until]').value]";
    let kept = client.execute_script(kept, &[]).unwrap();
    assert_eq!(kept, serde_json::json!([true, true, "3d"]));
    assert_eq!(browser.take_console_entries(), Vec::<String>::new());
}
