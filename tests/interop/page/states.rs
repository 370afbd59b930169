//! The page in other states, and without a script.

use serde_json::json;

use super::browser::Browser;
use super::cycle::{address, shop};
use super::look;

/// Out of tolerance, then disconnected: no earlier value remains visible.
pub fn from_afar() {
    let browser = Browser::open();
    let shop = shop();
    shop.change("EX0C_um = 500.0", "EX0C_um = 5.0");
    let mut daemon = shop.serve("fast");
    let at = address(&daemon);
    browser.client.goto(&at).unwrap();
    for run in 1..=2 {
        browser.send("/start", &[("who", "Ada")]);
        let result = format!("Result of run {run}");
        browser.until("#live", |text| text.contains("out of tolerance") && text.contains(&result));
    }
    look::at(&browser, "untrue");
    browser.client.goto(&format!("{at}compare?a=1&b=2")).unwrap();
    browser.until("table", |text| text.contains("EX0C") && text.contains("within U"));
    look::at(&browser, "compare");
    browser.client.goto(&format!("{at}compare?a=1&b=7")).unwrap();
    browser.until(".glance", |text| text.contains("no run 7"));
    look::at(&browser, "refused");
    browser.console();
    browser.client.goto(&at).unwrap();
    browser.until("#live", |text| text.contains("out of tolerance"));
    assert_eq!(browser.console(), Vec::<String>::new());
    daemon.child.kill().unwrap();
    // innerText of a parent does not contain hidden text.
    browser.until("main", |text| text.contains("no connection") && !text.contains("as of"));
    let seen = browser.text("main");
    assert!(!seen.contains("out of tolerance") && !seen.contains("Result of run"), "{seen}");
    assert_eq!(browser.client.title().unwrap(), "no connection");
    look::at(&browser, "away");
}

/// Text of the element; empty while the page changes and the element has become stale.
fn said(browser: &Browser, css: &str) -> String {
    browser.find(css).text().unwrap_or_default()
}

/// Started and read with plain forms and links.
pub fn without_script() {
    let browser = Browser::open();
    browser.devtools("Emulation.setScriptExecutionDisabled", &json!({"value": true}));
    let shop = shop();
    let daemon = shop.serve("fast");
    browser.client.goto(&address(&daemon)).unwrap();
    let boxes = browser.client.find_all("input[type=checkbox]");
    for tick in boxes.unwrap() {
        tick.click().unwrap();
    }
    browser.find("[name=who]").send_keys("Ada").unwrap();
    browser.find("form[action$='/start'] button").click().unwrap();
    let started = std::time::Instant::now();
    while !said(&browser, "#live .glance").starts_with("in tolerance") {
        assert!(started.elapsed().as_secs() < 60);
        browser.client.refresh().unwrap();
    }
    browser.find("a[href='/runs/1']").click().unwrap();
    browser.find("[name=who]").send_keys("Lise").unwrap();
    browser.find("form[action$='/sign'] button").click().unwrap();
    while !said(&browser, ".glance").contains("signed by Lise") {
        assert!(started.elapsed().as_secs() < 120);
    }
}
