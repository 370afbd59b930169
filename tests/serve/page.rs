//! The page and its interface, asked over plain sockets: words that a browser or a program would send.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::shop::{Daemon, Shop};

pub const HTTP: &str = "[serve.http]\nlisten = \"127.0.0.1:0\"\n";
pub const MACHINE: &str = "/api/v1/machines/simulated%20five-axis%20machine";
const PATIENCE: Duration = Duration::from_secs(300);

pub fn port(daemon: &Daemon) -> u16 {
    daemon.page()
}

/// Status and body of what `request` (without Host) is answered.
pub fn ask(port: u16, method: &str, path: &str, headers: &str, body: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let host = match headers.contains("Host:") {
        true => String::new(),
        false => format!("Host: localhost:{port}\r\n"),
    };
    let length = body.len();
    write!(
        stream,
        "{method} {path} HTTP/1.1\r\n{host}{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
    (status, answer.split_once("\r\n\r\n").unwrap().1.to_owned())
}

pub const JSON: &str = "Content-Type: application/json\r\n";

pub fn post(port: u16, what: &str, body: &Value) -> (u16, Value) {
    post_to(port, &format!("{MACHINE}/{what}"), body)
}

pub fn post_to(port: u16, path: &str, body: &Value) -> (u16, Value) {
    let (status, body) = ask(port, "POST", path, JSON, &body.to_string());
    (status, serde_json::from_str(&body).unwrap_or_else(|_| panic!("{body}")))
}

pub fn get(port: u16, path: &str) -> Value {
    let (status, body) = ask(port, "GET", path, "", "");
    assert_eq!(status, 200, "{path}: {body}");
    serde_json::from_str(&body).unwrap()
}

pub fn until(port: u16, right: impl Fn(&Value) -> bool) -> Value {
    let started = Instant::now();
    loop {
        let standing = get(port, MACHINE);
        if right(&standing) {
            return standing;
        }
        assert!(started.elapsed() < PATIENCE, "{standing}");
        sleep(Duration::from_millis(20));
    }
}

pub fn vouched() -> Value {
    json!({"cycle": 1, "who": "Ada", "enable": true, "auto": true, "door": true})
}

pub fn code(answer: &(u16, Value)) -> (u16, &str) {
    (answer.0, answer.1["code"].as_str().unwrap_or(""))
}

/// Started, measured to its verdict; the same figures as the command tells.
pub fn a_cycle() {
    let shop = Shop::new(HTTP);
    let daemon = shop.serve("fast");
    let port = port(&daemon);
    let mut unvouched = vouched();
    unvouched["door"] = json!(false);
    let mut nameless = vouched();
    nameless["who"] = json!("  ");
    let mut unknown = vouched();
    unknown["cycle"] = json!(3);
    assert_eq!(code(&post(port, "start", &unvouched)), (409, "not-vouched"));
    assert_eq!(code(&post(port, "start", &nameless)), (400, "nameless"));
    assert_eq!(code(&post(port, "start", &unknown)), (409, "refused"));
    assert_eq!(code(&post(port, "acknowledge", &json!({"who": "Ada"}))), (409, "refused"));
    assert_eq!(get(port, "/api/v1/runs").as_array().unwrap().len(), 0);
    assert_eq!(post(port, "start", &vouched()).0, 202);
    let ended = until(port, |standing| standing["state"] == "waiting");
    assert_eq!(ended["verdict"], "pass");
    assert_eq!(ended["run"], 1);
    let told = shop.json(&["show", "1", "--json"]);
    assert_eq!(ended["parameters"], told["parameters"]);
    assert_eq!(get(port, "/api/v1/runs/1/estimate"), told);
    let readings = get(port, "/api/v1/runs/1/readings?after=60&limit=5");
    assert_eq!(readings["readings"].as_array().unwrap().len(), 5);
    assert_eq!(readings["all"], ended["measured"]);
    let trends = get(port, &format!("{MACHINE}/trends"));
    assert_eq!(trends[0]["values"][0]["value"], told["parameters"][0]["value"]);
    let all = get(port, "/api/v1/runs/1/readings");
    let felt = all["readings"].as_array().unwrap().iter();
    let felt: Vec<f64> =
        felt.map(|reading| reading["temperatures_c"]["spindle"].as_f64().unwrap()).collect();
    assert_eq!(all["all"], felt.len());
    let mean = trends[0]["values"][0]["temperatures_c"]["spindle"].as_f64().unwrap();
    assert!((mean - felt.iter().sum::<f64>() / felt.len() as f64).abs() < 1e-9, "{mean} {felt:?}");
    let (least, most) =
        felt.iter().fold((f64::MAX, f64::MIN), |(a, b), it| (a.min(*it), b.max(*it)));
    let warmth = format!("{mean:.2} °C on average, {least:.2} to {most:.2} °C, ");
    let (page, report) = ("/runs/1", "/runs/1/report");
    let [page, report] = [page, report].map(|path| ask(port, "GET", path, "", "").1);
    let shown = String::from_utf8(shop.trued(&["show", "1"]).stdout).unwrap();
    for told in [page, report, shown] {
        assert!(told.contains(&warmth) && told.contains("spindle"), "{warmth} in {told}");
    }
    assert_eq!(trends[0]["tolerance"], 500.0);
    let one = get(port, "/api/v1/compare?a=1&b=1");
    assert_eq!((&one["runs"][1]["id"], &one["differences"][0]["by"]), (&json!(1), &json!(0.0)));
    assert_eq!(ask(port, "GET", "/api/v1/compare?a=1&b=9", "", "").0, 404);
    for page in ["/runs", "/runs/1", "/machines/simulated%20five-axis%20machine"] {
        let (status, text) = ask(port, "GET", page, "", "");
        assert!(status == 200 && text.contains("</html>"), "{page}: {text}");
    }
    assert_eq!(ask(port, "GET", "/runs/7", "", "").0, 404);
}

/// Held from the page: a name is not asked for; then it waits for somebody who has one.
pub fn a_hold() {
    let shop = Shop::new(HTTP);
    let daemon = shop.serve("real");
    let port = port(&daemon);
    assert_eq!(post(port, "start", &vouched()).0, 202);
    until(port, |standing| standing["measured"].as_u64().unwrap() > 0);
    let own = format!("Origin: http://localhost:{port}\r\n");
    let form = "Content-Type: application/x-www-form-urlencoded\r\n";
    let (status, _) = ask(port, "POST", &format!("{MACHINE}/hold"), &format!("{own}{form}"), "");
    assert_eq!(status, 303);
    until(port, |standing| standing["state"] == "held");
    assert_eq!(shop.states(), ["held"]);
    assert_eq!(code(&post(port, "start", &vouched())), (409, "refused"));
    assert_eq!(post(port, "acknowledge", &json!({"who": "Ada", "why": "nothing there"})).0, 202);
    until(port, |standing| standing["state"] == "waiting");
    let audits: Vec<String> = get(port, "/api/v1/audit")
        .as_array()
        .unwrap()
        .iter()
        .map(|audit| format!("{} {}", audit["who"], audit["what"]).replace('"', ""))
        .collect();
    let wanted = [
        "Ada acknowledgement",
        "Ada start of cycle 1",
        "somebody at the page hold",
        "Ada start of cycle 1",
    ];
    assert_eq!(audits, wanted);
}

/// What another site's page, another name, a large, a slow or a broken request get.
pub fn strangers() {
    let shop = Shop::new(HTTP);
    let daemon = shop.serve("fast");
    let port = port(&daemon);
    let start = format!("{MACHINE}/start");
    let form = "cycle=1&who=Eve&enable=true&auto=true&door=true";
    let urlencoded = "Content-Type: application/x-www-form-urlencoded\r\n";
    let from = |origin: &str| format!("{urlencoded}Origin: {origin}\r\n");
    let large = format!("{{\"cycle\": 1, \"who\": \"{}\"}}", "e".repeat(100_000));
    let cases = [
        (start.as_str(), from("http://evil.example"), form, 403),
        (start.as_str(), from("null"), form, 403),
        (start.as_str(), urlencoded.to_owned(), form, 403),
        (start.as_str(), "Content-Type: text/plain\r\n".to_owned(), form, 403),
        (start.as_str(), format!("Host: evil.example\r\n{JSON}"), form, 421),
        (start.as_str(), JSON.to_owned(), "{", 400),
        (start.as_str(), JSON.to_owned(), "{\"cycle\": 1, \"who\": \"Eve\", \"more\": 1}", 422),
        (start.as_str(), JSON.to_owned(), large.as_str(), 413),
        ("/api/v1/machines/other/start", JSON.to_owned(), "{\"cycle\": 1, \"who\": \"Eve\"}", 404),
        ("/api/v1/machines/..%2f..%2fetc/hold", JSON.to_owned(), "{}", 404),
    ];
    for (path, headers, body, wanted) in cases {
        let (status, told) = ask(port, "POST", path, &headers, body);
        assert_eq!(status, wanted, "{path} {headers}: {told}");
    }
    assert_eq!(ask(port, "GET", "/", "Host: evil.example\r\n", "").0, 421);
    assert_eq!(ask(port, "GET", "/../../etc/passwd", "", "").0, 404);
    assert_eq!(get(port, "/api/v1/runs").as_array().unwrap().len(), 0);
    assert!(!daemon.log.lock().unwrap().contains("panicked"));
}
