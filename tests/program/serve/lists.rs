//! Persistent and long data: a verdict has its time, and lists are paged.

use std::path::Path;
use std::time::Duration;

use crate::support::http::{HTTP_SECTION, HttpClient, MACHINE_API_PATH, start_request_body, status_and_error_code};
use crate::support::journal_checksums;
use crate::support::machine_shop::MachineShop;
use serde_json::{Value, json};

const MACHINE_PAGE_PATH: &str = "/machines/simulated%20five-axis%20machine";

fn page_text(port: u16, path: &str) -> String {
    let (status, text) = HttpClient::new(port).request("GET", path, "", "");
    assert_eq!(status, 200, "{path}: {text}");
    text
}

/// A result from before a restart is shown after it, with its time; it becomes outdated.
pub fn page_shows_the_result_after_a_restart() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let at = http.port;
    assert_eq!(http.get_json(MACHINE_API_PATH)["result"], Value::Null);
    assert!(page_text(at, MACHINE_PAGE_PATH).contains("unknown: no result yet"));
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    let ended = http.wait_until_machine_state(|standing| standing["result"]["run"] == 1);
    assert_eq!(daemon.terminate(), 0);

    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let at = http.port;
    let standing = http.get_json(MACHINE_API_PATH);
    assert_eq!((&standing["result"], &standing["verdict"]), (&ended["result"], &Value::Null));
    let told = shop.run_json(&["runs", "--json"]);
    assert_eq!(standing["result"]["measured"], told[0]["ended"]);
    assert_eq!(standing["result"]["verdict"], "pass");
    let page = page_text(at, MACHINE_PAGE_PATH);
    for words in ["class=\"glance pass\"", "Result of run 1", "measured 20", ", run 1; as of 20"] {
        assert!(page.contains(words), "{words}: {page}");
    }
    // Without tokens there is no sign-in.
    assert!(!page.contains("sign in"), "{page}");

    let long_ago = "UPDATE runs SET ended = '2026-01-10T05:30:00Z', started = '2026-01-10T05:00:00Z'";
    journal_checksums::execute_sql_and_update_checksums(Path::new(&shop.path_text("state")), long_ago);
    // The page is updated without a request.
    let standing = http.wait_until_machine_state(|standing| standing["result"]["outdated"] == true);
    assert_eq!(standing["result"]["run"], 1);
    let page = page_text(at, MACHINE_PAGE_PATH);
    assert!(page.contains("class=\"glance none\"") && !page.contains("Result of run"), "{page}");
    assert!(page.contains("measured 2026-01-10"), "{page}");
    assert_eq!(daemon.terminate(), 0);
    shop.replace_in_machine_file("min_interval_s = 0.0", "min_interval_s = 0.0\nverdict_h = 0.05");
    let refused = shop.run_trued(&["serve", "--machine", &shop.machine_path()]);
    let told = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && told.contains("verdict_h is 0.05"), "{told}");
}

/// Runs and readings are paged, and a page links to the next one.
pub fn run_and_reading_lists_are_paged() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let at = http.port;
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["result"]["run"] == 1);
    let more = "WITH RECURSIVE many (n) AS (SELECT 2 UNION ALL SELECT n + 1 FROM many WHERE n < 450)
        INSERT INTO runs (id, started, ended, method, machine, state, program_version, config,
                          config_sha256, plan_head, plan_sha256)
        SELECT n, started, ended, method, machine, 'failed', program_version, config,
               config_sha256, plan_head, plan_sha256 FROM many, runs WHERE runs.id = 1";
    journal_checksums::execute_sql_and_update_checksums(Path::new(&shop.path_text("state")), more);
    let ids = |path: &str| -> Vec<i64> {
        http.get_json(path).as_array().unwrap().iter().map(|run| run["id"].as_i64().unwrap()).collect()
    };
    let down = |from: i64, to: i64| (to..=from).rev().collect::<Vec<_>>();
    assert_eq!(ids("/api/v1/runs"), down(450, 251));
    assert_eq!(ids("/api/v1/runs?before=251"), down(250, 51));
    assert_eq!(ids("/api/v1/runs?after=50"), down(250, 51));
    assert_eq!(ids("/api/v1/runs?after=447"), down(450, 448));
    assert_eq!(ids("/api/v1/runs?before=9&after=6&limit=50"), [8, 7]);
    let walk = |path: &str, word: &str| {
        let page = page_text(at, path);
        let runs = page.matches("class=\"target\" href=\"/runs/").count();
        let link = page.split("href=\"").find(|link| link.contains(&format!("\">{word}</a>")));
        (runs, link.map(|link| link.split('"').next().unwrap().to_owned()))
    };
    let to = |path: &str| Some(path.to_owned());
    assert_eq!(walk("/runs", "older"), (200, to("/runs?before=251")));
    assert_eq!(walk("/runs", "newer").1, None);
    assert_eq!(walk("/runs?before=251", "older"), (200, to("/runs?before=51")));
    assert_eq!(walk("/runs?before=51", "older"), (50, None));
    assert_eq!(walk("/runs?before=51", "newer").1, to("/runs?after=50"));
    assert_eq!(walk("/runs?after=50", "newer"), (200, to("/runs?after=250")));
    assert_eq!(walk("/runs?after=250", "newer"), (200, None));
    assert_eq!(walk("/runs?after=250", "older").1, to("/runs?before=251"));
    // The newest run with a result is the first of all of these.
    assert_eq!(http.get_json(MACHINE_API_PATH)["result"]["run"], 1);

    let readings = |query: &str| http.get_json(&format!("/api/v1/runs/1/readings{query}"));
    let all = readings("");
    let whole = all["readings"].as_array().unwrap();
    assert_eq!(all["all"], whole.len());
    let some = readings("?after=7&limit=5");
    assert_eq!(some["readings"].as_array().unwrap().as_slice(), &whole[7..12]);
    assert_eq!((&some["all"], &some["after"]), (&all["all"], &json!(7)));
    assert_eq!(readings("?after=1000000")["readings"], json!([]));
    assert_eq!(http.request("GET", "/api/v1/runs/451/readings", "", "").0, 404);
}

/// Input errors in a form are explained on a page, those of a program as JSON; a request for an unknown machine is
/// answered with 404.
pub fn input_errors_are_explained() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let at = http.port;
    let form = format!("Origin: http://localhost:{at}\r\nContent-Type: application/x-www-form-urlencoded\r\n");
    let slip = |what: &str, body: &str| http.request("POST", &format!("{MACHINE_API_PATH}/{what}"), &form, body);
    for (what, body, status) in [("arm", "cycle=1&who=Ada&until=tomorrow", 400), ("disarm", "who=++", 400)] {
        let (answered, page) = slip(what, body);
        assert_eq!(answered, status, "{what}: {page}");
        assert!(page.contains("</html>") && page.contains("Request failed"), "{what}: {page}");
    }
    let slip = json!({"cycle": 1, "who": "Ada", "until": "tomorrow"});
    assert_eq!(status_and_error_code(&http.post_action("arm", &slip)), (400, "until"));
    let (status, told) = http.request("GET", "/api/v1/machines/nobody/schedule", "", "");
    assert!(status == 404 && told.starts_with('{'), "{told}");
    let (status, told) = http.request("GET", "/api/v1/machines/nobody/trends", "", "");
    assert!(status == 404 && told.contains("\"not-found\""), "{told}");
    assert_eq!(http.get_json(&format!("{MACHINE_API_PATH}/trends")), json!([]));
}

/// While nothing changes, a listener still receives signs of life; proxies in between do not delay them.
pub fn idle_listener_receives_signs_of_life() {
    use std::io::{BufRead, BufReader, Write};
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let at = http.port;
    let mut stream = std::net::TcpStream::connect(("127.0.0.1", at)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    write!(stream, "GET {MACHINE_API_PATH}/events HTTP/1.1\r\nHost: localhost:{at}\r\n\r\n").unwrap();
    let mut lines = BufReader::new(stream).lines().map(Result::unwrap);
    let head: Vec<String> = lines.by_ref().take_while(|line| !line.is_empty()).collect();
    let says = |words: &str| head.iter().any(|line| line.eq_ignore_ascii_case(words));
    assert!(says("x-accel-buffering: no") && says("content-type: text/event-stream"), "{head:?}");
    let data = lines.filter_map(|line| line.strip_prefix("data: ").map(str::to_owned));
    let standings: Vec<Value> = data.take(3).map(|data| serde_json::from_str(&data).unwrap()).collect();
    let waiting = json!({"state": "waiting", "late": false});
    for standing in &standings {
        assert_eq!(json!({"state": standing["state"], "late": standing["late"]}), waiting);
    }
}
