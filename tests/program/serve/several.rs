//! One daemon, two machines.

use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::http::{HttpClient, JSON};
use crate::support::machine_shop::MachineShop;
use serde_json::{Value, json};

const NAME: &str = "name = \"simulated five-axis machine\"";
const PATIENCE: Duration = Duration::from_secs(300);

fn standing(port: u16, machine: &str) -> Value {
    HttpClient::at(port).get(&format!("/api/v1/machines/{machine}"))
}

fn until(port: u16, machine: &str, right: impl Fn(&Value) -> bool) -> Value {
    let started = Instant::now();
    loop {
        let standing = standing(port, machine);
        if right(&standing) {
            return standing;
        }
        assert!(started.elapsed() < PATIENCE, "{standing}");
        sleep(Duration::from_millis(20));
    }
}

fn post(port: u16, machine: &str, what: &str, body: &Value) -> u16 {
    let path = format!("/api/v1/machines/{machine}/{what}");
    HttpClient::at(port).request("POST", &path, JSON, &body.to_string()).0
}

/// A shop with two machine files and the daemon's own file.
fn two(names: [&str; 2], more: &str) -> MachineShop {
    let shop = MachineShop::with_serve("");
    let text = std::fs::read_to_string(shop.machine()).unwrap();
    for (file, name) in ["one.toml", "two.toml"].iter().zip(names) {
        std::fs::write(shop.file(file), text.replace(NAME, &format!("name = \"{name}\""))).unwrap();
    }
    let daemon = "[http]\nlisten = \"127.0.0.1:0\"\n\
                  [[machine]]\nfile = \"one.toml\"\n[[machine]]\nfile = \"two.toml\"\n";
    std::fs::write(shop.file("trued.toml"), format!("{daemon}{more}")).unwrap();
    shop
}

/// Both machines measure at the same time; a hold of one does not affect the other.
pub fn machines() {
    let shop = two(["one", "two"], "");
    let config = shop.file("trued.toml");
    let daemon = shop.serve_as(&["--config", &config, "--speed", "real"], |_| {});
    let http = daemon.http();
    let port = http.port;
    let vouched = json!({"cycle": 1, "who": "Ada", "enable": true, "auto": true, "door": true});
    for machine in ["one", "two"] {
        assert_eq!(post(port, machine, "start", &vouched), 202);
    }
    for machine in ["one", "two"] {
        until(port, machine, |standing| standing["measured"].as_u64().unwrap() > 0);
    }
    assert_eq!(post(port, "one", "hold", &json!({})), 202);
    until(port, "one", |standing| standing["state"] == "held");
    let before = standing(port, "two")["measured"].as_u64().unwrap();
    until(port, "two", |standing| standing["measured"].as_u64().unwrap() > before + 1);
    assert_eq!(standing(port, "one")["state"], "held");
    let mut of_machines: Vec<String> = shop
        .json(&["runs", "--json"])
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
    assert_eq!(shop.states(), ["held", "held"]);
    let log = log.lock().unwrap();
    assert!(log.contains("one: run ") && log.contains("two: run "), "{log}");
}

/// Errors in the daemon's own file.
pub fn bad_files() {
    let page = "[serve.http]\nlisten = \"127.0.0.1:0\"\n";
    let cases = [
        (two(["one", "one"], ""), "two machines have the name `one`"),
        (two(["one", "two"], "[[machine]]\nfile = \"three.toml\"\n"), "three.toml cannot be read"),
        (two(["one", "two"], "[htp]\n"), "unknown section [htp]"),
        (two(["one", "two"], "[[machine]]\nfil = \"three.toml\"\n"), "did you mean `file`"),
    ];
    for (shop, words) in cases {
        refused(&shop, words);
    }
    let shop = two(["one", "two"], "");
    let text = std::fs::read_to_string(shop.file("two.toml")).unwrap();
    std::fs::write(shop.file("two.toml"), text + page).unwrap();
    refused(&shop, "one daemon serves one page");
    let shop = two(["one", "two"], "");
    let text = std::fs::read_to_string(shop.file("trued.toml")).unwrap();
    std::fs::write(shop.file("trued.toml"), text.replace("[http]", "[http]\nlissen = 1")).unwrap();
    refused(&shop, "trued.toml:2: unknown key `lissen`");
}

fn refused(shop: &MachineShop, words: &str) {
    let output = shop.trued(&["serve", "--config", &shop.file("trued.toml")]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{words}: {told}");
    assert!(told.contains(words), "{words} in {told}");
}
