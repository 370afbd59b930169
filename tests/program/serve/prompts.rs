//! A run with prompts: which client may answer which prompt, each only once, at the page and at a terminal.

use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::hostile_requests::{GuardedDaemon, bearer_header};
use crate::support::http::{HTTP_SECTION, HttpClient, MACHINE_API_PATH, start_request_body, status_and_error_code};
use crate::support::machine_shop::MachineShop;

const TWO_PROMPTS: &str = "[[prompt]]\ntext = \"the part is clean\"\n[[prompt]]\ntext = \"so is the stylus\"\n[serve]";

fn shows_prompt(text: &'static str) -> impl Fn(&Value) -> bool {
    move |standing| standing["asked"]["text"] == text
}

fn prompt_answer(step: u32) -> Value {
    json!({"step": step, "who": "Ada"})
}

/// Prompts are answered one by one by an authorised client; an outdated or repeated answer is refused.
pub fn prompts_are_answered_in_the_page() {
    let guarded =
        GuardedDaemon::start_with_changes("fast", |shop| shop.replace_in_machine_file("[serve]", TWO_PROMPTS));
    let GuardedDaemon { viewer_token: viewer, operator_token: operator, shop, port, .. } = &guarded;
    let answer = |token: &str, step| guarded.post_status("answer", token, &prompt_answer(step));
    assert_eq!(answer(operator, 0), 409, "nothing is asked yet");
    assert_eq!(guarded.post_status("start", operator, &start_request_body()), 202);
    let standing = guarded.wait_until(shows_prompt("the part is clean"));
    assert_eq!((&standing["state"], &standing["measured"]), (&json!("running"), &json!(0)));
    assert_eq!(standing["asked"]["step"], 0);
    // The duration in the daemon's log at its start.
    let left = standing["remaining_s"].as_f64().unwrap();
    let takes = format!("cycle 1: machine time about {:.0} min;", left / 60.0);
    assert!(left > 60.0 && guarded.daemon.log().contains(&takes), "{takes}");
    let (_, page) = HttpClient::new(*port).request("GET", &MACHINE_API_PATH[7..], &bearer_header(viewer), "");
    let shown = format!("time left<b>{:.0}:", (left / 60.0).floor());
    assert!(page.contains(&shown), "{shown}: {page}");
    assert!(page.contains("Done: the part is clean</button>"), "{page}");
    assert_eq!([answer(viewer, 0), answer(operator, 1)], [403, 409]);
    let nameless = guarded.post_status("answer", operator, &json!({"step": 0, "more": 1}));
    assert_eq!(nameless, 422);
    assert_eq!(guarded.machine_state()["asked"]["step"], 0);
    assert_eq!([answer(operator, 0), answer(operator, 0)], [202, 409]);
    guarded.wait_until(shows_prompt("so is the stylus"));
    assert_eq!([answer(operator, 0), answer(operator, 1)], [409, 202]);
    let ended = guarded.wait_until(|standing| standing["state"] == "waiting");
    assert_eq!((&ended["verdict"], &ended["asked"]), (&json!("pass"), &Value::Null));
    let told = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    for words in ["prompt for the operator: the part is clean", "prompt confirmed by a-operator: Ada"] {
        assert!(told.contains(words), "{words} in {told}");
    }
    let (_, audit) = HttpClient::new(*port).request("GET", "/api/v1/audit", &bearer_header(viewer), "");
    let audit: Vec<Value> = serde_json::from_str(&audit).unwrap();
    let answers = audit.iter().filter(|one| one["what"] == "answer to step 0, pass 1");
    let outcomes: Vec<_> = answers.map(|one| one["outcome"].as_str().unwrap()).collect();
    assert_eq!(outcomes.iter().filter(|outcome| **outcome == "accepted").count(), 1);
    assert_eq!(outcomes.len(), 4, "{outcomes:?}");
}

/// The run is held, and the next one killed, while a prompt is open. A later answer is refused, because there is
/// no prompt.
pub fn answer_after_a_stop_at_a_prompt_is_refused() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("[serve]", TWO_PROMPTS);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(shows_prompt("the part is clean"));
    assert_eq!(http.post_action("hold", &json!({})).0, 202);
    let held = http.wait_until_machine_state(|standing| standing["state"] == "held");
    assert_eq!((&held["asked"], shop.run_states()), (&Value::Null, vec!["held".to_owned()]));
    assert_eq!(status_and_error_code(&http.post_action("answer", &prompt_answer(0))), (409, "refused"));
    assert_eq!(http.post_action("acknowledge", &json!({"who": "Ada"})).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "waiting");
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(shows_prompt("the part is clean"));
    drop(daemon);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let standing = http.get_json(MACHINE_API_PATH);
    assert_eq!((&standing["state"], &standing["asked"]), (&json!("held"), &Value::Null));
    assert_eq!(shop.run_states(), ["held", "interrupted"]);
    assert_eq!(status_and_error_code(&http.post_action("answer", &prompt_answer(0))), (409, "refused"));
    assert_eq!(http.get_json("/api/v1/runs/2")["readings"], 0);
}

/// Prompts are answered by Enter, without a daemon and while a daemon has the machine. Without a terminal a run
/// with prompts does not begin.
pub fn prompts_are_answered_at_a_terminal() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("[serve]", TWO_PROMPTS);
    let machine = shop.machine_path();
    let refused = shop.run_trued(&["run", "self-calibration", "--machine", &machine]);
    let told = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && told.contains("no operator can answer"), "{told}");
    assert!(told.contains("nothing has moved"), "{told}");
    assert_eq!(shop.run_states(), ["failed"]);
    let run = ["run", "self-calibration", "--machine", &machine, "--acknowledge", "Ada"];
    assert_enter_answers_both_prompts(&shop, &run);
    assert_eq!(shop.run_states(), ["failed", "finished"]);
    let daemon = shop.start_daemon("fast");
    assert_enter_answers_both_prompts(&shop, &run);
    assert_eq!(shop.run_states(), ["failed", "finished", "finished"]);
    assert!(daemon.log().contains("prompt answered by Ada"));
    let told = String::from_utf8(shop.run_trued(&["show", "2"]).stdout).unwrap();
    assert!(told.contains("prompt confirmed by Ada"), "{told}");
}

/// Both prompts are answered by Enter at a terminal (that of `script`), and the run succeeds.
fn assert_enter_answers_both_prompts(shop: &MachineShop, arguments: &[&str]) {
    let command = shop.trued_command(arguments);
    let words = [command.get_program()].into_iter().chain(command.get_args());
    let words: Vec<String> = words.map(|word| format!("'{}'", word.to_string_lossy())).collect();
    let mut script = Command::new("script");
    script.args(["--quiet", "--return", "--command", &words.join(" "), "/dev/null"]);
    let mut child: Child = script.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut keys = child.stdin.take().unwrap();
    let mut shown = child.stdout.take().unwrap();
    let (mut seen, mut answered, started) = (String::new(), 0, Instant::now());
    let mut some = [0; 4096];
    while let Ok(count @ 1..) = shown.read(&mut some) {
        seen.push_str(&String::from_utf8_lossy(&some[..count]));
        if seen.matches("Press Enter").count() > answered {
            answered += 1;
            keys.write_all(b"\n").unwrap();
        }
        assert!(started.elapsed() < Duration::from_secs(120), "{seen}");
    }
    assert_eq!(child.wait().unwrap().code(), Some(0), "{seen}");
    assert_eq!(answered, 2, "{seen}");
}
