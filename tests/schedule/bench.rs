//! The program, its schedule, and what it says of it.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::shop::{Daemon, Shop};
use super::wall::{Machine, Wall};

pub const NAME: &str = "simulated five-axis machine";
const API: &str = "/api/v1/machines/simulated%20five-axis%20machine";
const PATIENCE: Duration = Duration::from_secs(300);

pub struct Bench {
    pub wall: Wall,
    pub machine: Machine,
    pub shop: Shop,
}

impl Bench {
    /// On a clock that shows `now`; `more` of the one schedule, `at` in Berlin.
    pub fn new(now: &str, at: &str, more: &str) -> Self {
        let (wall, machine) = (Wall::showing(now), Machine::new());
        let port = machine.port;
        let mut shop = Shop::new(&format!(
            "[[serve.schedule]]\nname = \"dawn\"\ncycle = 1\nat = \"{at}\"\nzone = \"Europe/Berlin\"\n{more}\n\
             [serve.line]\ntcp = \"127.0.0.1:{port}\"\n[serve.http]\nlisten = \"127.0.0.1:0\"\n"
        ));
        shop.envs = wall.envs();
        Self { wall, machine, shop }
    }

    pub fn arm(&self) {
        let arm = ["arm", NAME, "1", "--who", "Ada", "--until", "300d"];
        let output = self.shop.trued(&arm);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// Each slot of the journal, newest first: instant, outcome, why.
    pub fn slots(&self) -> Vec<[String; 3]> {
        let told = self.shop.json(&["schedule", NAME, "--json"]);
        let text = |slot: &Value, key: &str| slot[key].as_str().unwrap().to_owned();
        let slots = told[0]["last"].as_array().unwrap().iter();
        slots.map(|slot| ["at", "outcome", "why"].map(|key| text(slot, key))).collect()
    }

    /// Until the newest slot has come to `outcome`; all of them.
    pub fn until(&self, outcome: &str) -> Vec<[String; 3]> {
        let started = Instant::now();
        loop {
            let slots = self.slots();
            if slots.first().is_some_and(|[_, became, _]| became == outcome) {
                return slots;
            }
            assert!(started.elapsed() < PATIENCE, "{slots:?}");
            sleep(Duration::from_millis(100));
        }
    }

    pub fn one(&self, at: &str, outcome: &str, words: &str) {
        let slots = self.until(outcome);
        let [[instant, _, why]] = slots.as_slice() else { panic!("{slots:?}") };
        assert!(instant == at && why.contains(words), "{slots:?}");
    }
}

/// What the daemon has said contains `words`, by and by.
pub fn said(daemon: &Daemon, words: &str) {
    let started = Instant::now();
    while !daemon.log.lock().unwrap().contains(words) {
        assert!(started.elapsed() < PATIENCE, "{words} in {}", daemon.log.lock().unwrap());
        sleep(Duration::from_millis(20));
    }
}

/// Status and JSON of what the interface answers.
pub fn ask(daemon: &Daemon, method: &str, what: &str, body: &Value) -> (u16, Value) {
    let port = daemon.page();
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let body = body.to_string();
    write!(
        stream,
        "{method} {API}{what} HTTP/1.1\r\nHost: localhost:{port}\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
    let body = answer.split_once("\r\n\r\n").unwrap().1;
    (status, serde_json::from_str(body).unwrap_or_else(|_| panic!("{answer}")))
}

pub fn start(daemon: &Daemon) {
    let vouched = json!({"cycle": 1, "who": "Ada", "enable": true, "auto": true, "door": true});
    assert_eq!(ask(daemon, "POST", "/start", &vouched).0, 202);
}

/// Until the machine stands so.
pub fn stands(daemon: &Daemon, right: impl Fn(&Value) -> bool) -> Value {
    let started = Instant::now();
    loop {
        let standing = ask(daemon, "GET", "", &Value::Null).1;
        if right(&standing) {
            return standing;
        }
        assert!(started.elapsed() < PATIENCE, "{standing}");
        sleep(Duration::from_millis(50));
    }
}

/// Until the journal knows the run of the newest slot.
pub fn until_run(daemon: &Daemon) {
    let started = Instant::now();
    loop {
        let told = ask(daemon, "GET", "/schedule", &Value::Null).1;
        if told["last"][0]["run"] == 1 {
            return;
        }
        assert!(started.elapsed() < PATIENCE, "{told}");
        sleep(Duration::from_millis(100));
    }
}
