//! A cycle from the page: started, monitored, held midway, resumed, monitored up to its verdict, signed.

use super::accessibility;
use super::browser::Browser;
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::MachineShop;

pub fn page_url(daemon: &DaemonProcess) -> String {
    format!("http://127.0.0.1:{}/", daemon.http_port())
}

/// A machine file with the HTTP interface, few touches and a fast machine: a whole run in real time takes less than a
/// minute, of which half remains after the twelfth touch.
pub fn quick_shop_with_http() -> MachineShop {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let faster = [
        ("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5"),
        ("rapid_per_min = 20000.0", "rapid_per_min = 60000.0"),
        ("rapid_per_min = 7200.0", "rapid_per_min = 36000.0"),
        ("rapid_per_min = 10800.0", "rapid_per_min = 36000.0"),
        ("acceleration_per_s2 = 2000.0", "acceleration_per_s2 = 20000.0"),
        ("acceleration_per_s2 = 400.0", "acceleration_per_s2 = 4000.0"),
        ("acceleration_per_s2 = 1000.0", "acceleration_per_s2 = 10000.0"),
        ("\nfeed_mm_min = 30.0", "\nfeed_mm_min = 600.0"),
        ("search_feed_mm_min = 1500.0", "search_feed_mm_min = 3000.0"),
        ("guarded_feed_mm_min = 3000.0", "guarded_feed_mm_min = 12000.0"),
    ];
    faster.iter().for_each(|(from, to)| shop.replace_in_machine_file(from, to));
    shop
}

/// Waits until the page shows this number of touches.
fn wait_for_touch_count(browser: &Browser, at_least: usize) {
    let count = |text: &str| text.lines().last().and_then(|line| line.parse::<usize>().ok());
    let is = |text: &str| count(text).is_some_and(|count| count >= at_least);
    browser.wait_for_text("#live .measured", is);
}

fn wait_for_page_status(browser: &Browser, words: &str) {
    browser.wait_for_text("#live .glance", |text| text.starts_with(words));
}

pub fn run_is_held_resumed_and_signed() {
    let browser = Browser::open();
    let shop = quick_shop_with_http();
    shop.replace_in_machine_file("[serve]", "[[prompt]]\ntext = \"part and stylus are clean\"\n[serve]");
    // Enough time for a slow browser to hold the run midway.
    shop.replace_in_machine_file("positions = 5", "positions = 8");
    let daemon = shop.start_daemon("real");
    let (client, at) = (&browser.client, page_url(&daemon));
    client.open_url(&at).unwrap();
    wait_for_page_status(&browser, "unknown");
    accessibility::check_page_at_all_sizes(&browser, "unknown");

    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    wait_for_page_status(&browser, "waiting: a prompt is open");
    browser.wait_for_text("#asked .question", |text| text == "part and stylus are clean");
    accessibility::check_page_at_all_sizes(&browser, "asked");
    browser.fill_and_submit_form("/answer", &[("who", "Ada")]);
    wait_for_page_status(&browser, "measuring");
    assert_eq!(browser.visible_text("#asked"), "");
    // Five touches locate the part; four references follow.
    wait_for_touch_count(&browser, 12);
    browser.wait_for_element("#live svg .mark.now");
    let hold = "const box = document.querySelector('button.hold').getBoundingClientRect();
        return box.top >= 0 && box.bottom <= innerHeight";
    for place in ["0", "document.body.scrollHeight"] {
        client.execute_script(&format!("scrollTo(0, {place})"), &[]).unwrap();
        assert_eq!(client.execute_script(hold, &[]).unwrap(), true, "hold is out of reach");
    }
    browser.fill_and_submit_form("/hold", &[]);
    wait_for_page_status(&browser, "held");
    assert_eq!(shop.run_states(), ["held"]);
    let before = shop.run_json(&["runs", "--json"])[0].clone();
    accessibility::check_page_at_all_sizes(&browser, "held");

    browser.fill_and_submit_form("/resume", &[("who", "Grace")]);
    wait_for_page_status(&browser, "measuring");
    // Touches from before the hold count.
    wait_for_touch_count(&browser, 18);
    accessibility::check_page_at_all_sizes(&browser, "measuring");
    wait_for_page_status(&browser, "in tolerance");
    assert_eq!(shop.run_states(), ["finished"]);
    assert_eq!(shop.run_json(&["runs", "--json"])[0]["started"], before["started"]);
    accessibility::check_page_at_all_sizes(&browser, "true");

    browser.wait_for_element("a[href='/runs/1']").click().unwrap();
    browser.wait_for_text(".glance", |text| text.contains("not signed"));
    accessibility::check_page_at_all_sizes(&browser, "run");
    browser.fill_and_submit_form("/sign", &[("who", "Lise"), ("why", "as it was in May")]);
    let signed = "signed by Lise (as it was in May) on ";
    browser.wait_for_text(".glance", |text| text.contains(signed));
    accessibility::check_page_at_all_sizes(&browser, "signed");
    browser.wait_for_element("a[href='/runs/1/report']").click().unwrap();
    browser.wait_for_text(".under", |_| true);
    assert!(browser.visible_text("header").contains("Signed by Lise (as it was in May) on "));
    assert_eq!(accessibility::serious_axe_violations(&browser), Vec::<String>::new());
    assert_eq!(browser.take_console_entries(), Vec::<String>::new());

    assert_eq!(shop.run_json(&["runs", "--json"])[0]["signed"], "Lise");
    let told = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    let asked = "prompt for the operator: part and stylus are clean";
    for words in [
        asked,
        "prompt confirmed by Ada",
        "held: ",
        "confirmed by Grace",
        "resumed after an interruption",
        "signed by Lise",
    ] {
        assert!(told.contains(words), "{words} in {told}");
    }
}
