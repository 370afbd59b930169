//! Resuming a held run from the page, and signing a result: requirements and refusals.

use crate::support::http::{HTTP_SECTION, start_request_body, status_and_error_code};
use crate::support::machine_shop::MachineShop;
use serde_json::{Value, json};

/// The control restarts after the references: the axes must be homed, and the operator must confirm it.
pub fn resume_from_the_page_needs_all_confirmations() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    let fault = "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 14\n[serve]";
    shop.replace_in_machine_file("[serve]", fault);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let word = |change: &dyn Fn(&mut Value)| {
        let mut word = json!({"run": 1, "who": "Ada", "free": true, "whole": true, "homed": true});
        change(&mut word);
        word
    };
    assert_eq!(status_and_error_code(&http.post_action("resume", &word(&|_| ()))), (404, "not-found"));
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "held");
    let readings = || http.get_json("/api/v1/runs/1")["readings"].as_u64().unwrap();
    let before = readings();
    let refused: [(&str, Value, (u16, &str)); 5] = [
        ("nobody", word(&|word| word["who"] = json!(" ")), (400, "nameless")),
        ("the way", word(&|word| word["free"] = json!(false)), (409, "not-vouched")),
        ("the probe", word(&|word| word["whole"] = json!(false)), (409, "not-vouched")),
        ("not homed", word(&|word| word["homed"] = json!(false)), (409, "not-homed")),
        ("another run", word(&|word| word["run"] = json!(7)), (404, "not-found")),
    ];
    for (what, word, wanted) in &refused {
        assert_eq!(status_and_error_code(&http.post_action("resume", word)), *wanted, "{what}");
    }
    assert_eq!((shop.run_states(), readings()), (vec!["held".to_owned()], before));
    let because = word(&|word| word["why"] = json!("the plug sat loose"));
    assert_eq!(http.post_action("resume", &because).0, 202);
    let audits = http.get_json("/api/v1/audit");
    let (what, why) = (&audits[0]["what"], &audits[0]["why"]);
    assert_eq!((what, why), (&json!("resume of run 1"), &json!("the plug sat loose")));
    // The same fault again: the same run is held at a later step.
    http.wait_until_machine_state(|standing| standing["state"] == "held" && readings() > before);
    assert_eq!(shop.run_states(), ["held"]);
    let story = http.get_json("/api/v1/runs/1")["story"].to_string();
    assert!(story.contains("confirmed by Ada") && story.contains("resumed after"), "{story}");
}

/// A signature belongs to the estimate that was read, and has a name.
pub fn signature_needs_a_name_and_the_current_estimate() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "waiting");
    let path = "/api/v1/runs/1/sign";
    let sign =
        |who: &str, estimate: &str| http.post_json(path, &json!({"who": who, "why": "as ever", "estimate": estimate}));
    let (_, page) = http.request("GET", "/runs/1", "", "");
    let (_, rest) = page.split_once("name=\"estimate\" value=\"").unwrap();
    let hash = &rest[..64];
    assert_eq!(status_and_error_code(&sign("Lise", "0")), (409, "other-estimate"));
    assert_eq!(status_and_error_code(&sign("", hash)), (400, "nameless"));
    assert_eq!(http.get_json("/api/v1/runs")[0]["signed"], Value::Null);
    assert_eq!(sign("Lise", hash).0, 201);
    assert_eq!(http.get_json("/api/v1/runs")[0]["signed"], "Lise");
    let audit = &http.get_json("/api/v1/audit")[0];
    assert_eq!((&audit["who"], &audit["what"]), (&json!("Lise"), &json!("signature under run 1")));
    // A new identification of the same readings gives the same estimate.
    shop.run_json(&["identify", "self-calibration", "--run", "1", "--json"]);
    assert_eq!(http.get_json("/api/v1/runs")[0]["signed"], "Lise");
    let other = json!({"who": "Ada", "estimate": hash});
    assert_eq!(http.post_json("/api/v1/runs/7/sign", &other).0, 404);
}
