//! The page in other states, and without a script.

use serde_json::json;

use super::browser::Browser;
use super::cycle::{page_address, served_shop};
use super::look;

/// Out of tolerance, then disconnected: no earlier value remains visible.
pub fn disconnected_page_hides_a_result_out_of_tolerance() {
    let browser = Browser::open();
    let shop = served_shop();
    shop.replace_in_machine("EX0C_um = 500.0", "EX0C_um = 5.0");
    let mut daemon = shop.start_daemon("fast");
    let at = page_address(&daemon);
    browser.client.goto(&at).unwrap();
    for run in 1..=2 {
        browser.submit_form("/start", &[("who", "Ada")]);
        let result = format!("Result of run {run}");
        browser.wait_for_text("#live", |text| text.contains("out of tolerance") && text.contains(&result));
    }
    look::check_at_all_sizes(&browser, "untrue");
    browser.client.goto(&format!("{at}compare?a=1&b=2")).unwrap();
    browser.wait_for_text("table", |text| text.contains("EX0C") && text.contains("within U"));
    look::check_at_all_sizes(&browser, "compare");
    browser.client.goto(&format!("{at}compare?a=1&b=7")).unwrap();
    browser.wait_for_text(".glance", |text| text.contains("no run 7"));
    look::check_at_all_sizes(&browser, "refused");
    browser.console_entries();
    browser.client.goto(&at).unwrap();
    browser.wait_for_text("#live", |text| text.contains("out of tolerance"));
    assert_eq!(browser.console_entries(), Vec::<String>::new());
    daemon.child.kill().unwrap();
    // innerText of a parent does not contain hidden text.
    browser.wait_for_text("main", |text| text.contains("no connection") && !text.contains("as of"));
    let seen = browser.text("main");
    assert!(!seen.contains("out of tolerance") && !seen.contains("Result of run"), "{seen}");
    assert_eq!(browser.client.title().unwrap(), "no connection");
    look::check_at_all_sizes(&browser, "away");
}

/// Text of the element; empty while the page changes and the element has become stale.
fn element_text(browser: &Browser, css: &str) -> String {
    browser.find(css).text().unwrap_or_default()
}

/// Started and read with plain forms and links.
pub fn page_works_without_script() {
    let browser = Browser::open();
    browser.devtools("Emulation.setScriptExecutionDisabled", &json!({"value": true}));
    let shop = served_shop();
    let daemon = shop.start_daemon("fast");
    browser.client.goto(&page_address(&daemon)).unwrap();
    let boxes = browser.client.find_all("input[type=checkbox]");
    for tick in boxes.unwrap() {
        tick.click().unwrap();
    }
    browser.find("[name=who]").send_keys("Ada").unwrap();
    browser.find("form[action$='/start'] button").click().unwrap();
    let started = std::time::Instant::now();
    while !element_text(&browser, "#live .glance").starts_with("in tolerance") {
        assert!(started.elapsed().as_secs() < 60);
        browser.client.refresh().unwrap();
    }
    browser.find("a[href='/runs/1']").click().unwrap();
    browser.find("[name=who]").send_keys("Lise").unwrap();
    browser.find("form[action$='/sign'] button").click().unwrap();
    while !element_text(&browser, ".glance").contains("signed by Lise") {
        assert!(started.elapsed().as_secs() < 120);
    }
}
