//! A person's word at the page, against what the machine says itself, and beside what others do with it.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::Stdio;
use std::time::Duration;

use serde_json::{Value, json};

use super::page::{HTTP, code, get, port, post, until, vouched};
use super::shop::Shop;

/// As few touches as the method takes.
fn short(trigger: &str) -> Shop {
    let shop = Shop::new(trigger);
    shop.change("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    shop
}

/// Whoever vouches for a closed guard at the page does not close it.
pub fn against_the_machine() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = listener.local_addr().unwrap();
    let shop = short(&format!("[serve.line]\ntcp = \"{at}\"\n{HTTP}"));
    let daemon = shop.serve("fast");
    let (port, (mut line, _)) = (port(&daemon), listener.accept().unwrap());
    line.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut answers = BufReader::new(line.try_clone().unwrap());
    let mut tells = |words: &str| {
        line.write_all(format!("TELL {words}\r\n").as_bytes()).unwrap();
        let mut answer = String::new();
        answers.read_line(&mut answer).unwrap();
        assert_eq!(answer.trim(), "OK");
    };
    for (words, why) in [
        ("ENABLE AUTO", "a guard is open"),
        ("AUTO DOOR", "the external start is not enabled at the machine"),
    ] {
        tells(words);
        let refused = post(port, "start", &vouched());
        assert_eq!((code(&refused), &refused.1["message"]), ((409, "refused"), &json!(why)));
    }
    assert!(shop.states().is_empty());
    tells("ENABLE AUTO DOOR");
    assert_eq!(post(port, "start", &vouched()).0, 202);
    until(port, |standing| standing["state"] == "waiting");
}

/// The control restarts before the references: the run cannot go on, and its axes must be homed by somebody who
/// says so. Why it stopped stands on the board until then.
pub fn leaves_a_lost_position() {
    let shop = short(HTTP);
    shop.change("[serve]", "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 3\n[serve]");
    let daemon = shop.serve("fast");
    let port = port(&daemon);
    assert_eq!(post(port, "start", &vouched()).0, 202);
    let held = until(port, |standing| standing["state"] == "held");
    let failure = held["failure"]["what"].as_str().unwrap();
    assert!(failure.starts_with("run 1: "), "{failure}");
    let page = "/machines/simulated%20five-axis%20machine";
    let (_, shown) = super::page::ask(port, "GET", page, "", "");
    assert!(shown.contains("What to do: ") && shown.contains("name=\"homed\""), "{shown}");
    let leave = |homed: bool| {
        post(port, "acknowledge", &json!({"who": "Ada", "why": "chips", "homed": homed}))
    };
    let refused = leave(false);
    assert_eq!(code(&refused), (409, "refused"));
    assert_eq!(
        get(port, "/api/v1/audit")[0]["outcome"].as_str().unwrap().split(':').next(),
        Some("refused")
    );
    let (status, standing) = leave(true);
    assert_eq!(
        (status, &standing["state"], &standing["failure"]),
        (202, &json!("waiting"), &Value::Null)
    );
    let story = get(port, "/api/v1/runs/1")["story"].to_string();
    assert!(story.contains("acknowledged by Ada") && story.contains("chips"), "{story}");
    assert_eq!(get(port, "/api/v1/audit")[0]["outcome"], "accepted");
}

/// The command goes on with a run that the daemon held: the board says so, no hold is promised, and what became
/// of it is seen.
pub fn resumes_elsewhere() {
    let shop = short(HTTP);
    // Farther on than what is left after it.
    shop.change("[serve]", "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 30\n[serve]");
    let daemon = shop.serve("fast");
    let port = port(&daemon);
    assert_eq!(post(port, "start", &vouched()).0, 202);
    until(port, |standing| standing["state"] == "held");
    let resume = |speed: &str| {
        let words = ["resume", "1", "--acknowledge", "Ada", "--homed", "--speed", speed];
        shop.command(&words)
    };
    let mut resumed = resume("real").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let standing = until(port, |standing| standing["elsewhere"] == true);
    assert_eq!(standing["state"], "held");
    assert_eq!(code(&post(port, "hold", &json!({}))), (409, "refused"));
    assert_eq!(code(&post(port, "acknowledge", &json!({"who": "Lise"}))), (409, "refused"));
    resumed.kill().unwrap();
    resumed.wait().unwrap();
    let standing = until(port, |standing| standing["elsewhere"] == false);
    assert_eq!(standing["state"], "held", "nobody has seen to it");
    let ended = resume("fast").output().unwrap();
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    until(port, |standing| standing["state"] == "waiting");
    assert_eq!(shop.states(), ["finished"]);
}
