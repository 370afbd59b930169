//! What the page looks like in other states, and without a script.

use serde_json::json;

use super::browser::{Browser, in_browser};
use super::cycle::{address, shop};
use super::look;

/// Not true, and away: nothing that was known stands on.
pub fn from_afar() {
    in_browser(async |browser| {
        let shop = shop();
        shop.change("EX0C_um = 500.0", "EX0C_um = 5.0");
        let mut daemon = shop.serve("fast");
        let at = address(&daemon);
        browser.client.goto(&at).await.unwrap();
        for run in 1..=2 {
            browser.send("/start", &[("who", "Ada")]).await;
            let result = format!("Result of run {run}");
            browser
                .until("#live", |text| text.contains("not true") && text.contains(&result))
                .await;
        }
        look::at(&browser, "untrue").await;
        browser.client.goto(&format!("{at}compare?a=1&b=2")).await.unwrap();
        browser.until("table", |text| text.contains("EX0C") && text.contains("within its U")).await;
        look::at(&browser, "compare").await;
        browser.client.goto(&format!("{at}compare?a=1&b=7")).await.unwrap();
        browser.until(".glance", |text| text.contains("no run 7")).await;
        look::at(&browser, "refused").await;
        browser.console().await;
        browser.client.goto(&at).await.unwrap();
        browser.until("#live", |text| text.contains("not true")).await;
        assert_eq!(browser.console().await, Vec::<String>::new());
        daemon.child.kill().unwrap();
        // Of what is hidden, innerText of what is around it says nothing.
        browser
            .until("main", |text| text.contains("no connection") && !text.contains("as of"))
            .await;
        let seen = browser.text("main").await;
        assert!(!seen.contains("not true") && !seen.contains("Result of run"), "{seen}");
        assert_eq!(browser.client.title().await.unwrap(), "no connection");
        look::at(&browser, "away").await;
    });
}

/// What stands there; nothing while the page goes elsewhere, and takes along what was found on it.
async fn said(browser: &Browser, css: &str) -> String {
    browser.find(css).await.text().await.unwrap_or_default()
}

/// Started and read with plain forms and links.
pub fn without_script() {
    in_browser(async |browser| {
        browser.tell("Emulation.setScriptExecutionDisabled", json!({"value": true})).await;
        let shop = shop();
        let daemon = shop.serve("fast");
        browser.client.goto(&address(&daemon)).await.unwrap();
        let boxes = browser.client.find_all(fantoccini::Locator::Css("input[type=checkbox]")).await;
        for tick in boxes.unwrap() {
            tick.click().await.unwrap();
        }
        browser.find("[name=who]").await.send_keys("Ada").await.unwrap();
        browser.find("form[action$='/start'] button").await.click().await.unwrap();
        let started = std::time::Instant::now();
        while !said(&browser, "#live .glance").await.starts_with("true") {
            assert!(started.elapsed().as_secs() < 60);
            browser.client.refresh().await.unwrap();
        }
        browser.find("a[href='/runs/1']").await.click().await.unwrap();
        browser.find("[name=who]").await.send_keys("Lise").await.unwrap();
        browser.find("form[action$='/sign'] button").await.click().await.unwrap();
        while !said(&browser, ".glance").await.contains("signed by Lise") {
            assert!(started.elapsed().as_secs() < 120);
        }
    });
}
