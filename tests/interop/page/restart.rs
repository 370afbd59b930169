//! The daemon is restarted under an open page: the page remains, shows no state of the machine meanwhile, and
//! reconnects by itself when the daemon answers again.

use std::net::TcpListener;
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::browser::Browser;
use super::cycle::{page_url, quick_shop_with_http};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{MACHINE_API_PATH, start_request_body};
use crate::support::machine_shop::MachineShop;

const PAGE_STATE_TIMEOUT: Duration = Duration::from_secs(60);
/// Longer than the page waits for an event, and than it waits for a response.
const LONG_ABSENCE: Duration = Duration::from_secs(12);

/// A shop whose daemon gets the same port at each start.
fn shop_with_fixed_port() -> MachineShop {
    let shop = quick_shop_with_http();
    let free_port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    shop.replace_in_machine_file("listen = \"127.0.0.1:0\"", &format!("listen = \"127.0.0.1:{free_port}\""));
    shop
}

/// Waits for a text of the page; fails if the browser shows its own error page.
fn wait_for_page_text(browser: &Browser, is_reached: impl Fn(&str) -> bool) {
    let started = Instant::now();
    loop {
        // While the page is loaded again, the script may fail.
        let address = browser.client.execute_script("return location.href", &[]).unwrap_or_default();
        let address = address.as_str().unwrap_or("http");
        let text = browser.visible_text("main");
        assert!(address.starts_with("http"), "the browser shows {address}");
        if is_reached(&text) {
            return;
        }
        assert!(started.elapsed() < PAGE_STATE_TIMEOUT, "{address}: {text}");
        sleep(Duration::from_millis(50));
    }
}

fn wait_until_away(browser: &Browser) {
    wait_for_page_text(browser, |text| text.contains("no connection") && !text.contains("as of"));
}

/// Waits until the page has a connection and shows `state`.
fn wait_until_connected(browser: &Browser, state: &str) {
    wait_for_page_text(browser, |text| {
        !text.contains("no connection") && text.to_lowercase().contains("as of") && text.contains(state)
    });
}

/// Waits until the page has been loaded again after the last change of the state: a reload when the daemon ends would
/// show the browser's own error page.
fn wait_until_loaded_in_present_state(browser: &Browser, daemon: &DaemonProcess) {
    let state = daemon.http().get_json(MACHINE_API_PATH)["state"].clone();
    wait_for_page_text(browser, |_| {
        let loaded = "return document.readyState === 'complete' && document.getElementById('live').dataset.state";
        browser.client.execute_script(loaded, &[]).is_ok_and(|loaded| loaded == state)
    });
}

/// The page reads the event that announces the end of the daemon two seconds late, as a slow tablet may: the daemon has
/// exited by then.
const READ_END_EVENT_LATE: &str = "const parse = JSON.parse;
    JSON.parse = (text) => {
        const value = parse(text);
        const until = Date.now() + (value.state === 'ending' ? 2000 : 0);
        while (Date.now() < until);
        return value;
    };";

/// Stops the daemon as systemd does and starts it again after `absence`; the page then shows `state_after`.
fn restart_under_page(
    browser: &Browser,
    shop: &MachineShop,
    daemon: DaemonProcess,
    absence: Duration,
    state_after: &str,
) -> DaemonProcess {
    wait_until_loaded_in_present_state(browser, &daemon);
    browser.client.execute_script(READ_END_EVENT_LATE, &[]).unwrap();
    daemon.terminate();
    wait_until_away(browser);
    let until = Instant::now() + absence;
    while Instant::now() < until {
        wait_until_away(browser);
        sleep(Duration::from_millis(200));
    }
    let daemon = shop.start_daemon("real");
    wait_until_connected(browser, state_after);
    daemon
}

pub fn waiting_page_reconnects_after_restarts() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    let mut daemon = shop.start_daemon("real");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    for absence in [Duration::ZERO, LONG_ABSENCE] {
        wait_until_connected(&browser, "unknown: no result yet");
        daemon = restart_under_page(&browser, &shop, daemon, absence, "unknown: no result yet");
    }
    // The page is connected to the events of the new daemon.
    assert_eq!(daemon.http().post_action("start", &start_request_body()).0, 202);
    wait_until_connected(&browser, "measuring");
    wait_for_page_text(&browser, |_| is_script_from_cache(&browser));
}

/// Whether the page was loaded without a request for its script: the daemon may end between the two requests.
fn is_script_from_cache(browser: &Browser) -> bool {
    let transferred_bytes =
        "return performance.getEntriesByType('resource').find((one) => one.name.includes('live.js')).transferSize";
    // While the page is loaded again, the script may fail.
    browser.client.execute_script(transferred_bytes, &[]).is_ok_and(|bytes| bytes == 0)
}

/// The stop holds the run; the new daemon waits for a person.
pub fn measuring_and_held_pages_reconnect_after_a_restart() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    let mut daemon = shop.start_daemon("real");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    wait_until_connected(&browser, "measuring");
    daemon.http().wait_until_machine_state(|machine| machine["measured"].as_u64().unwrap() > 0);
    // The second restart is under the page of the held machine.
    for _ in 0..2 {
        daemon = restart_under_page(&browser, &shop, daemon, Duration::ZERO, "held: inspect the machine");
        browser.wait_for_element("form[action$='/acknowledge']");
    }
}

pub fn failed_page_reconnects_after_a_restart() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    shop.replace_in_machine_file("[serve]", "[[simulated.fault]]\nkind = \"probe-stuck\"\n[serve]");
    let daemon = shop.start_daemon("real");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    wait_until_connected(&browser, "not measured: the last cycle failed");
    let _daemon = restart_under_page(&browser, &shop, daemon, Duration::ZERO, "unknown: no result yet");
    browser.wait_for_element("form[action$='/start']");
}

pub fn page_with_an_open_prompt_reconnects_after_a_restart() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    shop.replace_in_machine_file("[serve]", "[[prompt]]\ntext = \"the part is clean\"\n[serve]");
    let daemon = shop.start_daemon("real");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    wait_until_connected(&browser, "waiting: a prompt is open");
    browser.wait_for_element("#asked form");
    let _daemon = restart_under_page(&browser, &shop, daemon, Duration::ZERO, "held: inspect the machine");
    assert_eq!(browser.visible_text("#asked"), "");
}

/// A hold without a response is reported on the page: the process is stopped, then its port is closed.
pub fn hold_without_a_response_is_reported_on_the_page() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    let mut daemon = shop.start_daemon("real");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    wait_until_connected(&browser, "measuring");
    let click_hold_and_wait_for_alert = || {
        browser.wait_for_element("form[action$='/hold'] button").click().unwrap();
        browser.wait_for_text("form[action$='/hold'] [role=alert]", |text| text.contains("The hold is not confirmed"));
    };
    daemon.send_signal("STOP");
    click_hold_and_wait_for_alert();
    let remove_alert = "document.querySelector(\"form[action$='/hold'] [role=alert]\").remove()";
    browser.client.execute_script(remove_alert, &[]).unwrap();
    daemon.kill();
    wait_until_away(&browser);
    click_hold_and_wait_for_alert();
    let daemon = shop.start_daemon("real");
    wait_until_connected(&browser, "held: inspect the machine");
    assert_eq!(daemon.http().get_json(MACHINE_API_PATH)["state"], "held");
}

/// Sessions end with the daemon: the page of a tablet leads to the sign-in.
pub fn page_of_a_signed_in_tablet_leads_to_the_sign_in_after_a_restart() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    shop.replace_in_machine_file("[serve.http]", "[serve.http]\ntokens = true");
    let token = shop.run_trued(&["token", "add", "tablet", "--role", "operator"]).stdout;
    let token = String::from_utf8(token).unwrap();
    let daemon = shop.start_daemon("real");
    browser.client.open_url(&format!("{}login", page_url(&daemon))).unwrap();
    browser.fill_and_submit_form("/login", &[("token", token.trim())]);
    browser.wait_for_text("main", |text| text.contains("unknown: no result yet"));
    daemon.terminate();
    wait_until_away(&browser);
    let _daemon = shop.start_daemon("real");
    browser.wait_for_element("form[action$='/login'] [name=token]");
}

pub fn machines_overview_reconnects_after_a_restart() {
    let (browser, shop) = (Browser::open(), shop_with_fixed_port());
    let text = std::fs::read_to_string(shop.machine_path()).unwrap();
    let (machine, http) = text.split_once("[serve.http]").unwrap();
    let mut config = format!("[http]{http}");
    for name in ["mill", "lathe"] {
        let machine = machine.replace("name = \"simulated five-axis machine\"", &format!("name = \"{name}\""));
        std::fs::write(shop.path_text(&format!("{name}.toml")), machine).unwrap();
        config += &format!("[[machine]]\nfile = \"{name}.toml\"\n");
    }
    let config_path = shop.path_text("trued.toml");
    std::fs::write(&config_path, config).unwrap();
    let start = || shop.start_prepared_daemon(&["--config", &config_path], |_| {});
    let is_overview =
        |text: &str| ["mill", "lathe"].iter().all(|name| text.contains(name)) && !text.contains("no connection");
    let daemon = start();
    browser.client.open_url(&page_url(&daemon)).unwrap();
    wait_for_page_text(&browser, is_overview);
    daemon.terminate();
    wait_for_page_text(&browser, |text| text.contains("no connection") && !text.contains("lathe"));
    sleep(LONG_ABSENCE);
    let _daemon = start();
    wait_for_page_text(&browser, is_overview);
}
