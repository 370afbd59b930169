//! Tests the page after a result out of tolerance, after a disconnection, and without a script.

use serde_json::json;

use super::accessibility;
use super::browser::Browser;
use super::cycle::{page_url, quick_shop_with_http};
use crate::support::http::MACHINE_API_PATH;

/// Out of tolerance, then disconnected: no earlier value remains visible.
pub fn disconnected_page_hides_a_result_out_of_tolerance() {
    let browser = Browser::open();
    let shop = quick_shop_with_http();
    shop.replace_in_machine_file("EX0C_um = 500.0", "EX0C_um = 5.0");
    let mut daemon = shop.start_daemon("fast");
    let at = page_url(&daemon);
    browser.client.open_url(&at).unwrap();
    for run in 1..=2 {
        browser.fill_and_submit_form("/start", &[("who", "Ada")]);
        let result = format!("Result of run {run}");
        browser.wait_for_text("#live", |text| text.contains("out of tolerance") && text.contains(&result));
    }
    accessibility::check_page_at_all_sizes(&browser, "untrue");
    browser.client.open_url(&format!("{at}compare?a=1&b=2")).unwrap();
    browser.wait_for_text("table", |text| text.contains("EX0C") && text.contains("within U"));
    accessibility::check_page_at_all_sizes(&browser, "compare");
    browser.client.open_url(&format!("{at}compare?a=1&b=7")).unwrap();
    browser.wait_for_text(".glance", |text| text.contains("no run 7"));
    accessibility::check_page_at_all_sizes(&browser, "refused");
    for page in ["runs", "audit", "runs/2/report"] {
        browser.client.open_url(&format!("{at}{page}")).unwrap();
        browser.wait_for_text("h1", |_| true);
        accessibility::check_page_at_all_sizes(&browser, &page.replace('/', "-"));
    }
    browser.take_console_entries();
    browser.client.open_url(&at).unwrap();
    browser.wait_for_text("#live", |text| text.contains("out of tolerance"));
    assert_eq!(browser.take_console_entries(), Vec::<String>::new());
    daemon.child.kill().unwrap();
    // innerText of a parent does not contain hidden text.
    browser.wait_for_text("main", |text| text.contains("no connection") && !text.contains("as of"));
    let seen = browser.visible_text("main");
    assert!(!seen.contains("out of tolerance") && !seen.contains("Result of run"), "{seen}");
    assert_eq!(browser.client.page_title().unwrap(), "no connection");
    accessibility::check_page_at_all_sizes(&browser, "away");
}

/// Text of the element; empty while the page changes and the element has become stale.
fn element_text_or_empty(browser: &Browser, css: &str) -> String {
    browser.wait_for_element(css).visible_text().unwrap_or_default()
}

/// The script could not be loaded, because the service ended after it had sent the page.
pub fn page_without_its_script_hides_the_state_after_a_time() {
    let (browser, shop) = (Browser::open(), quick_shop_with_http());
    let daemon = shop.start_daemon("fast");
    let (status, page) = daemon.http().request("GET", MACHINE_API_PATH.trim_start_matches("/api/v1"), "", "");
    assert_eq!(status, 200);
    let copy_path = shop.path_text("page.html");
    std::fs::write(&copy_path, page).unwrap();
    browser.client.open_url(&format!("file://{copy_path}")).unwrap();
    assert!(browser.visible_text("#live").contains("unknown: no result yet"));
    browser.wait_for_text("#away", |text| text.contains("no connection"));
    assert_eq!(browser.visible_text("#live"), "");
}

/// The run is started and its result is read and signed with plain forms and links.
pub fn page_works_without_script() {
    let browser = Browser::open();
    browser.run_devtools_command("Emulation.setScriptExecutionDisabled", &json!({"value": true}));
    let shop = quick_shop_with_http();
    let daemon = shop.start_daemon("fast");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    let boxes = browser.client.find_elements("input[type=checkbox]");
    for tick in boxes.unwrap() {
        tick.click().unwrap();
    }
    browser.wait_for_element("[name=who]").send_keys("Ada").unwrap();
    browser.wait_for_element("form[action$='/start'] button").click().unwrap();
    let started = std::time::Instant::now();
    while !element_text_or_empty(&browser, "#live .glance").starts_with("in tolerance") {
        assert!(started.elapsed().as_secs() < 60);
        browser.client.reload_page().unwrap();
    }
    browser.wait_for_element("a[href='/runs/1']").click().unwrap();
    browser.wait_for_element("[name=who]").send_keys("Lise").unwrap();
    browser.wait_for_element("form[action$='/sign'] button").click().unwrap();
    while !element_text_or_empty(&browser, ".glance").contains("signed by Lise") {
        assert!(started.elapsed().as_secs() < 120);
    }
}
