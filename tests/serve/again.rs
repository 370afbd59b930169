//! A held run goes on from the page, and a result is signed: what is refused, and what it takes.

use serde_json::{Value, json};

use super::page::{HTTP, code, get, port, post, post_to, until, vouched};
use super::shop::Shop;

/// The control restarts on the way, after the references: the axes must be homed, and somebody must say so.
pub fn resumed() {
    let shop = Shop::new(HTTP);
    shop.change("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    let fault = "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 14\n[serve]";
    shop.change("[serve]", fault);
    let daemon = shop.serve("fast");
    let port = port(&daemon);
    let word = |change: &dyn Fn(&mut Value)| {
        let mut word = json!({"run": 1, "who": "Ada", "free": true, "whole": true, "homed": true});
        change(&mut word);
        word
    };
    assert_eq!(code(&post(port, "resume", &word(&|_| ()))), (404, "not-found"));
    assert_eq!(post(port, "start", &vouched()).0, 202);
    until(port, |standing| standing["state"] == "held");
    let readings = || get(port, "/api/v1/runs/1")["readings"].as_u64().unwrap();
    let before = readings();
    let refused: [(&str, Value, (u16, &str)); 5] = [
        ("nobody", word(&|word| word["who"] = json!(" ")), (400, "nameless")),
        ("the way", word(&|word| word["free"] = json!(false)), (409, "not-vouched")),
        ("the probe", word(&|word| word["whole"] = json!(false)), (409, "not-vouched")),
        ("not homed", word(&|word| word["homed"] = json!(false)), (409, "not-homed")),
        ("another run", word(&|word| word["run"] = json!(7)), (404, "not-found")),
    ];
    for (what, word, wanted) in &refused {
        assert_eq!(code(&post(port, "resume", word)), *wanted, "{what}");
    }
    assert_eq!((shop.states(), readings()), (vec!["held".to_owned()], before));
    let because = word(&|word| word["why"] = json!("the plug sat loose"));
    assert_eq!(post(port, "resume", &because).0, 202);
    let audits = get(port, "/api/v1/audit");
    let (what, why) = (&audits[0]["what"], &audits[0]["why"]);
    assert_eq!((what, why), (&json!("resume of run 1"), &json!("the plug sat loose")));
    // The same fault again: held, but farther on, and the same run.
    until(port, |standing| standing["state"] == "held" && readings() > before);
    assert_eq!(shop.states(), ["held"]);
    let story = get(port, "/api/v1/runs/1")["story"].to_string();
    assert!(story.contains("acknowledged by Ada") && story.contains("resumed after"), "{story}");
}

/// Bound to the estimate that was read; by name.
pub fn signed() {
    let shop = Shop::new(HTTP);
    let daemon = shop.serve("fast");
    let port = port(&daemon);
    assert_eq!(post(port, "start", &vouched()).0, 202);
    until(port, |standing| standing["state"] == "waiting");
    let path = "/api/v1/runs/1/sign";
    let sign = |who: &str, estimate: &str| {
        post_to(port, path, &json!({"who": who, "why": "as ever", "estimate": estimate}))
    };
    let (_, page) = super::page::ask(port, "GET", "/runs/1", "", "");
    let (_, rest) = page.split_once("name=\"estimate\" value=\"").unwrap();
    let hash = &rest[..64];
    assert_eq!(code(&sign("Lise", "0")), (409, "other-estimate"));
    assert_eq!(code(&sign("", hash)), (400, "nameless"));
    assert_eq!(get(port, "/api/v1/runs")[0]["signed"], Value::Null);
    assert_eq!(sign("Lise", hash).0, 201);
    assert_eq!(get(port, "/api/v1/runs")[0]["signed"], "Lise");
    let audit = &get(port, "/api/v1/audit")[0];
    assert_eq!((&audit["who"], &audit["what"]), (&json!("Lise"), &json!("signature under run 1")));
    // Identified again from the same readings it is the same estimate.
    shop.json(&["identify", "self-calibration", "--run", "1", "--json"]);
    assert_eq!(get(port, "/api/v1/runs")[0]["signed"], "Lise");
    let other = json!({"who": "Ada", "estimate": hash});
    assert_eq!(post_to(port, "/api/v1/runs/7/sign", &other).0, 404);
}
