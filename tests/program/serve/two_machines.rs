//! One daemon, two machines.

use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::http::{HttpClient, JSON_HEADER};
use crate::support::machine_shop::MachineShop;
use serde_json::{Value, json};

const MACHINE_NAME_LINE: &str = "name = \"simulated five-axis machine\"";
const STATE_TIMEOUT: Duration = Duration::from_secs(300);

fn machine_state(port: u16, machine: &str) -> Value {
    HttpClient::new(port).get_json(&format!("/api/v1/machines/{machine}"))
}

fn wait_until(port: u16, machine: &str, is_reached: impl Fn(&Value) -> bool) -> Value {
    let started = Instant::now();
    loop {
        let standing = machine_state(port, machine);
        if is_reached(&standing) {
            return standing;
        }
        assert!(started.elapsed() < STATE_TIMEOUT, "{standing}");
        sleep(Duration::from_millis(20));
    }
}

fn post_action(port: u16, machine: &str, action: &str, body: &Value) -> u16 {
    let path = format!("/api/v1/machines/{machine}/{action}");
    HttpClient::new(port).request("POST", &path, JSON_HEADER, &body.to_string()).0
}

/// A shop with two machine files and the daemon's own file.
fn shop_with_two_machines(names: [&str; 2], more: &str) -> MachineShop {
    let shop = MachineShop::with_serve("");
    let text = std::fs::read_to_string(shop.machine_path()).unwrap();
    for (file, name) in ["one.toml", "two.toml"].iter().zip(names) {
        std::fs::write(shop.path_text(file), text.replace(MACHINE_NAME_LINE, &format!("name = \"{name}\""))).unwrap();
    }
    let daemon = "[http]\nlisten = \"127.0.0.1:0\"\n\
                  [[machine]]\nfile = \"one.toml\"\n[[machine]]\nfile = \"two.toml\"\n";
    std::fs::write(shop.path_text("trued.toml"), format!("{daemon}{more}")).unwrap();
    shop
}

/// Both machines measure at the same time; a hold of one does not affect the other.
pub fn two_machines_run_at_once() {
    let shop = shop_with_two_machines(["one", "two"], "");
    let config = shop.path_text("trued.toml");
    let daemon = shop.start_prepared_daemon(&["--config", &config, "--speed", "real"], |_| {});
    let http = daemon.http();
    let port = http.port;
    let vouched = json!({"cycle": 1, "who": "Ada", "enable": true, "auto": true, "door": true});
    for machine in ["one", "two"] {
        assert_eq!(post_action(port, machine, "start", &vouched), 202);
    }
    for machine in ["one", "two"] {
        wait_until(port, machine, |standing| standing["measured"].as_u64().unwrap() > 0);
    }
    assert_eq!(post_action(port, "one", "hold", &json!({})), 202);
    wait_until(port, "one", |standing| standing["state"] == "held");
    let before = machine_state(port, "two")["measured"].as_u64().unwrap();
    wait_until(port, "two", |standing| standing["measured"].as_u64().unwrap() > before + 1);
    assert_eq!(machine_state(port, "one")["state"], "held");
    let mut of_machines: Vec<String> = shop
        .run_json(&["runs", "--json"])
        .as_array()
        .unwrap()
        .iter()
        .map(|run| format!("{} {}", run["machine"], run["state"]).replace('"', ""))
        .collect();
    of_machines.sort();
    assert_eq!(of_machines, ["one held", "two running"]);
    let (_, page) = http.request("GET", "/", "", "");
    assert!(page.contains(">one<small>held") && page.contains(">two<small>measuring"), "{page}");
    let log = daemon.log.clone();
    // The run at the second machine is held as well.
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.run_states(), ["held", "held"]);
    let log = log.lock().unwrap();
    assert!(log.contains("one: run ") && log.contains("two: run "), "{log}");
}

/// Errors in the daemon's own file, and a machine file with a page of its own.
pub fn invalid_multi_machine_configs_are_refused() {
    let page = "[serve.http]\nlisten = \"127.0.0.1:0\"\n";
    let cases = [
        (shop_with_two_machines(["one", "one"], ""), "two machines have the name `one`"),
        (shop_with_two_machines(["one", "two"], "[[machine]]\nfile = \"three.toml\"\n"), "three.toml cannot be read"),
        (shop_with_two_machines(["one", "two"], "[htp]\n"), "unknown section [htp]"),
        (shop_with_two_machines(["one", "two"], "[[machine]]\nfil = \"three.toml\"\n"), "did you mean `file`"),
    ];
    for (shop, words) in cases {
        assert_refused(&shop, words);
    }
    let shop = shop_with_two_machines(["one", "two"], "");
    let text = std::fs::read_to_string(shop.path_text("two.toml")).unwrap();
    std::fs::write(shop.path_text("two.toml"), text + page).unwrap();
    assert_refused(&shop, "one daemon serves one page");
    let shop = shop_with_two_machines(["one", "two"], "");
    let text = std::fs::read_to_string(shop.path_text("trued.toml")).unwrap();
    std::fs::write(shop.path_text("trued.toml"), text.replace("[http]", "[http]\nlissen = 1")).unwrap();
    assert_refused(&shop, "trued.toml:2: unknown key `lissen`");
}

fn assert_refused(shop: &MachineShop, words: &str) {
    let output = shop.run_trued(&["serve", "--config", &shop.path_text("trued.toml")]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{words}: {told}");
    assert!(told.contains(words), "{words} in {told}");
}
