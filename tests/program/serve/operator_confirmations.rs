//! Confirmations of an operator at the page, in conflict with the machine's own reports and with other users.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::{Command, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use crate::support::http::{HTTP_SECTION, start_request_body, status_and_error_code};
use crate::support::machine_shop::{MachineShop, stderr};
use serde_json::{Value, json};

/// A machine whose cycle has the minimum number of touches of the method.
fn short_cycle_shop(trigger: &str) -> MachineShop {
    let shop = MachineShop::with_serve(trigger);
    shop.replace_in_machine_file("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    shop
}

/// A confirmation of a closed guard at the page does not override the machine's report.
pub fn page_confirmation_does_not_override_machine_interlocks() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = listener.local_addr().unwrap();
    let shop = short_cycle_shop(&format!("[serve.line]\ntcp = \"{at}\"\n{HTTP_SECTION}"));
    let daemon = shop.start_daemon("fast");
    let (http, (mut line, _)) = (daemon.http(), listener.accept().unwrap());
    line.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut answers = BufReader::new(line.try_clone().unwrap());
    let mut tells = |words: &str| {
        line.write_all(format!("TELL {words}\r\n").as_bytes()).unwrap();
        let mut answer = String::new();
        answers.read_line(&mut answer).unwrap();
        assert_eq!(answer.trim(), "OK");
    };
    for (words, why) in
        [("ENABLE AUTO", "a guard is open"), ("AUTO DOOR", "the external start is not enabled at the machine")]
    {
        tells(words);
        let refused = http.post_action("start", &start_request_body());
        assert_eq!((status_and_error_code(&refused), &refused.1["message"]), ((409, "refused"), &json!(why)));
    }
    assert!(shop.run_states().is_empty());
    tells("ENABLE AUTO DOOR");
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "waiting");
}

/// The control restarts before the references: the run cannot be resumed, and the operator must home the axes and
/// confirm it. The reason of the stop is shown until then.
pub fn homing_must_be_confirmed_after_a_control_reset() {
    let shop = short_cycle_shop(HTTP_SECTION);
    shop.replace_in_machine_file("[serve]", "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 3\n[serve]");
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    let held = http.wait_until_machine_state(|standing| standing["state"] == "held");
    let failure = held["failure"]["what"].as_str().unwrap();
    assert!(failure.starts_with("run 1: "), "{failure}");
    let page = "/machines/simulated%20five-axis%20machine";
    let (_, shown) = http.request("GET", page, "", "");
    assert!(shown.contains("Remedy: ") && shown.contains("name=\"homed\""), "{shown}");
    let leave = |homed: bool| http.post_action("acknowledge", &json!({"who": "Ada", "why": "chips", "homed": homed}));
    let refused = leave(false);
    assert_eq!(status_and_error_code(&refused), (409, "refused"));
    assert_eq!(http.get_json("/api/v1/audit")[0]["outcome"].as_str().unwrap().split(':').next(), Some("refused"));
    let (status, standing) = leave(true);
    assert_eq!((status, &standing["state"], &standing["failure"]), (202, &json!("waiting"), &Value::Null));
    let story = http.get_json("/api/v1/runs/1")["story"].to_string();
    assert!(story.contains("confirmed by Ada") && story.contains("chips"), "{story}");
    assert_eq!(http.get_json("/api/v1/audit")[0]["outcome"], "accepted");
}

/// The command resumes a run that the daemon held: the page shows it, offers no hold, and later shows its result.
pub fn held_run_is_resumed_at_the_command_line() {
    let shop = short_cycle_shop(HTTP_SECTION);
    // Later than the steps that remain after it.
    shop.replace_in_machine_file("[serve]", "[[simulated.fault]]\nkind = \"reset\"\nafter_touch = 30\n[serve]");
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "held");
    let resume = |speed: &str| {
        let words = ["resume", "1", "--acknowledge", "Ada", "--homed", "--speed", speed];
        shop.trued_command(&words)
    };
    let mut resumed = resume("real").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let standing = http.wait_until_machine_state(|standing| standing["elsewhere"] == true);
    assert_eq!(standing["state"], "held");
    assert_eq!(status_and_error_code(&http.post_action("hold", &json!({}))), (409, "refused"));
    assert_eq!(status_and_error_code(&http.post_action("acknowledge", &json!({"who": "Lise"}))), (409, "refused"));
    resumed.kill().unwrap();
    resumed.wait().unwrap();
    let standing = http.wait_until_machine_state(|standing| standing["elsewhere"] == false);
    assert_eq!(standing["state"], "held", "nobody has seen to it");
    let ended = resume_when_machine_lock_is_free(&mut resume("fast"));
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    http.wait_until_machine_state(|standing| standing["state"] == "waiting");
    assert_eq!(shop.run_states(), ["finished"]);
}

/// The daemon's test of the lock of a killed process blocks others for an instant (`MachineLock::holder`): the
/// command is then repeated.
fn resume_when_machine_lock_is_free(resume: &mut Command) -> Output {
    for _ in 0..100 {
        let output = resume.output().unwrap();
        if !stderr(&output).contains("is in use by process") {
            return output;
        }
        sleep(Duration::from_millis(100));
    }
    panic!("the lock of the killed process is held");
}
