//! Content of the audit log: every call that changes something, with its reason, also of a client that has
//! disconnected; and a bound on its size.

use std::io::Write;
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::http::{HTTP_SECTION, HttpClient, JSON_HEADER, MACHINE_API_PATH, start_request_body};
use crate::support::machine_shop::MachineShop;
use serde_json::{Value, json};

const AUDIT_TIMEOUT: Duration = Duration::from_secs(300);
const SCHEDULE_SECTION: &str = "[[serve.schedule]]\nname = \"dawn\"\ncycle = 1\nat = \"30 5 1 1 *\"\nzone = \"UTC\"\n";

/// Audit entries, newest first, page by page.
fn audit_entries(port: u16) -> Vec<Value> {
    let (mut all, mut before) = (Vec::<Value>::new(), String::new());
    loop {
        let page = HttpClient::new(port).get_json(&format!("/api/v1/audit?limit=7{before}"));
        let page = page.as_array().unwrap();
        let Some(last) = page.last() else { return all };
        let older = |seq: &Value| all.last().is_none_or(|last| seq.as_i64() < last["seq"].as_i64());
        assert!(page.iter().all(|audit| older(&audit["seq"])), "{page:?} after {:?}", all.last());
        before = format!("&before={}", last["seq"]);
        all.extend(page.iter().cloned());
    }
}

/// Waits until exactly `count` audit entries have the text `what`.
fn wait_for_audit_entries(port: u16, what: &str, count: usize) {
    let started = Instant::now();
    loop {
        let all = audit_entries(port);
        if all.iter().filter(|audit| audit["what"] == what).count() == count {
            return;
        }
        assert!(started.elapsed() < AUDIT_TIMEOUT, "{all:?}");
        sleep(Duration::from_millis(50));
    }
}

/// The hold button is pressed continuously: each hold is executed, few have a separate entry, none is lost; a hold
/// that stops a run always has its own entry.
pub fn holds_are_audited() {
    const HOLD_COUNT: u64 = 200;
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("real");
    let http = daemon.http();
    let port = http.port;
    let why = json!({"who": "Eve", "why": "w".repeat(10_000)});
    for _ in 0..HOLD_COUNT {
        assert_eq!(http.post_action("hold", &why).0, 202);
    }
    let alone = audit_entries(port).len() as u64;
    assert!((1..HOLD_COUNT / 2).contains(&alone), "{alone}");
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["measured"].as_u64().unwrap() > 0);
    assert_eq!(http.post_action("hold", &json!({"who": "Ada", "why": "smoke"})).0, 202);
    let held = |audit: &Value| (&audit["what"], &audit["run"]) == (&json!("hold"), &json!(1));
    let all = audit_entries(port);
    let of_run: Vec<&Value> = all.iter().filter(|audit| held(audit)).collect();
    assert_eq!((of_run.len(), &of_run[0]["why"]), (1, &json!("smoke")));
    // The other holds are counted in the text.
    let counted = |audit: &Value| {
        let told = audit["outcome"].as_str().unwrap().strip_prefix("accepted, ")?;
        told.split(' ').next()?.parse::<u64>().ok()
    };
    let told = || audit_entries(port).iter().filter_map(counted).sum::<u64>();
    let started = Instant::now();
    while told() + alone < HOLD_COUNT {
        assert!(started.elapsed() < AUDIT_TIMEOUT, "{} and {alone}", told());
        sleep(Duration::from_millis(200));
    }
    let all = audit_entries(port);
    assert!(all.iter().all(|audit| audit["why"].as_str().unwrap().len() <= 500));
}

/// The pages contain each entry once; an unknown filter is refused, not ignored.
pub fn audit_log_is_paged() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let port = http.port;
    for number in 0..17 {
        let words = json!({"who": "Ada", "why": format!("number {number}")});
        assert_eq!(http.post_action("acknowledge", &words).0, 409);
    }
    let why = |audit: &Value| audit["why"].as_str().unwrap().to_owned();
    let paged: Vec<String> = audit_entries(port).iter().map(why).collect();
    let wanted: Vec<String> = (0..17).rev().map(|number| format!("number {number}")).collect();
    assert_eq!(paged, wanted);
    for list in ["audit?after=1", "runs?seq=1", "runs/1/readings?before=1"] {
        assert_eq!(http.request("GET", &format!("/api/v1/{list}"), "", "").0, 400, "{list}");
    }
}

/// A request may state a reason, and it is stored.
pub fn reasons_are_audited() {
    let shop = MachineShop::with_serve(&format!("{SCHEDULE_SECTION}{HTTP_SECTION}"));
    let daemon = shop.start_daemon("real");
    let http = daemon.http();
    let port = http.port;
    let because = |mut words: Value, why: &str| {
        words["why"] = json!(why);
        words
    };
    let due = because(json!({"cycle": 1, "who": "timer"}), "it is time");
    assert_eq!(http.post_action("due", &due).0, 409);
    let arm = because(json!({"cycle": 1, "who": "Ada", "until": "1d"}), "for the night");
    assert_eq!(http.post_action("arm", &arm).0, 202);
    assert_eq!(http.post_action("start", &because(start_request_body(), "after the crash")).0, 202);
    http.wait_until_machine_state(|standing| standing["measured"].as_u64().unwrap() > 0);
    assert_eq!(http.post_action("hold", &because(json!({}), "a noise")).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "held");
    let seen = because(json!({"who": "Ada"}), "it was the door");
    assert_eq!(http.post_action("acknowledge", &seen).0, 202);
    let all = audit_entries(port);
    for why in ["it is time", "for the night", "after the crash", "a noise", "it was the door"] {
        assert!(all.iter().any(|audit| audit["why"] == why), "{why}: {all:?}");
    }
}

/// The socket is closed as soon as the request is sent.
pub fn request_of_a_disconnected_client_is_audited() {
    let shop = MachineShop::with_serve(&format!("{SCHEDULE_SECTION}{HTTP_SECTION}"));
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let port = http.port;
    let send = |what: &str, body: &str, length: usize| {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let head = format!("POST {MACHINE_API_PATH}/{what} HTTP/1.1\r\nHost: localhost:{port}\r\n{JSON_HEADER}");
        let request = format!("{head}Content-Length: {length}\r\n\r\n{body}");
        stream.write_all(request.as_bytes()).unwrap();
    };
    let due = json!({"cycle": 1, "who": "timer"}).to_string();
    for count in 1..=5 {
        send("due", &due, due.len());
        wait_for_audit_entries(port, "cycle 1 is due", count);
    }
    for count in 1..=5 {
        send("hold", "{\"who\"", 100);
        wait_for_audit_entries(port, "hold", count);
    }
}
