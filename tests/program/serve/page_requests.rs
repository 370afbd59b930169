//! The page and its interface over plain sockets, with requests as a browser or a program sends them.

use crate::support::http::{HTTP_SECTION, JSON_HEADER, MACHINE_API_PATH, start_request_body, status_and_error_code};
use crate::support::machine_shop::MachineShop;
use serde_json::json;

/// A cycle started at the page is measured up to its verdict; the results equal those of the command.
pub fn page_starts_a_cycle() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let mut unvouched = start_request_body();
    unvouched["door"] = json!(false);
    let mut nameless = start_request_body();
    nameless["who"] = json!("  ");
    let mut unknown = start_request_body();
    unknown["cycle"] = json!(3);
    assert_eq!(status_and_error_code(&http.post_action("start", &unvouched)), (409, "not-vouched"));
    assert_eq!(status_and_error_code(&http.post_action("start", &nameless)), (400, "nameless"));
    assert_eq!(status_and_error_code(&http.post_action("start", &unknown)), (409, "refused"));
    assert_eq!(status_and_error_code(&http.post_action("acknowledge", &json!({"who": "Ada"}))), (409, "refused"));
    assert_eq!(http.get_json("/api/v1/runs").as_array().unwrap().len(), 0);
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    let ended = http.wait_until_machine_state(|standing| standing["state"] == "waiting");
    assert_eq!(ended["verdict"], "pass");
    assert_eq!(ended["run"], 1);
    let told = shop.run_json(&["show", "1", "--json"]);
    assert_eq!(ended["parameters"], told["parameters"]);
    assert_eq!(http.get_json("/api/v1/runs/1/estimate"), told);
    let readings = http.get_json("/api/v1/runs/1/readings?after=60&limit=5");
    assert_eq!(readings["readings"].as_array().unwrap().len(), 5);
    assert_eq!(readings["all"], ended["measured"]);
    let trends = http.get_json(&format!("{MACHINE_API_PATH}/trends"));
    assert_eq!(trends[0]["values"][0]["value"], told["parameters"][0]["value"]);
    let all = http.get_json("/api/v1/runs/1/readings");
    let felt = all["readings"].as_array().unwrap().iter();
    let felt: Vec<f64> = felt.map(|reading| reading["temperatures_c"]["spindle"].as_f64().unwrap()).collect();
    assert_eq!(all["all"], felt.len());
    let mean = trends[0]["values"][0]["temperatures_c"]["spindle"].as_f64().unwrap();
    assert!((mean - felt.iter().sum::<f64>() / felt.len() as f64).abs() < 1e-9, "{mean} {felt:?}");
    let (least, most) = felt.iter().fold((f64::MAX, f64::MIN), |(a, b), it| (a.min(*it), b.max(*it)));
    let warmth = format!("mean {mean:.2} °C, from {least:.2} to {most:.2} °C, ");
    let (page, report) = ("/runs/1", "/runs/1/report");
    let [page, report] = [page, report].map(|path| http.request("GET", path, "", "").1);
    let shown = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    for told in [page, report, shown] {
        assert!(told.contains(&warmth) && told.contains("spindle"), "{warmth} in {told}");
    }
    assert_eq!(trends[0]["tolerance"], 500.0);
    let one = http.get_json("/api/v1/compare?a=1&b=1");
    assert_eq!((&one["runs"][1]["id"], &one["differences"][0]["by"]), (&json!(1), &json!(0.0)));
    assert_eq!(http.request("GET", "/api/v1/compare?a=1&b=9", "", "").0, 404);
    for page in ["/runs", "/runs/1", "/machines/simulated%20five-axis%20machine"] {
        let (status, text) = http.request("GET", page, "", "");
        assert!(status == 200 && text.contains("</html>"), "{page}: {text}");
    }
    assert_eq!(http.request("GET", "/runs/7", "", "").0, 404);
}

/// A hold from the page needs no name; the run then waits for an acknowledgement, which needs one.
pub fn page_holds_a_run() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("real");
    let http = daemon.http();
    let port = http.port;
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|standing| standing["measured"].as_u64().unwrap() > 0);
    let own = format!("Origin: http://localhost:{port}\r\n");
    let form = "Content-Type: application/x-www-form-urlencoded\r\n";
    let (status, _) = http.request("POST", &format!("{MACHINE_API_PATH}/hold"), &format!("{own}{form}"), "");
    assert_eq!(status, 303);
    http.wait_until_machine_state(|standing| standing["state"] == "held");
    assert_eq!(shop.run_states(), ["held"]);
    assert_eq!(status_and_error_code(&http.post_action("start", &start_request_body())), (409, "refused"));
    assert_eq!(http.post_action("acknowledge", &json!({"who": "Ada", "why": "nothing there"})).0, 202);
    http.wait_until_machine_state(|standing| standing["state"] == "waiting");
    let audits: Vec<String> = http
        .get_json("/api/v1/audit")
        .as_array()
        .unwrap()
        .iter()
        .map(|audit| format!("{} {}", audit["who"], audit["what"]).replace('"', ""))
        .collect();
    let wanted =
        ["Ada acknowledgement", "Ada start of cycle 1", "an unnamed person at the page hold", "Ada start of cycle 1"];
    assert_eq!(audits, wanted);
}

/// Responses to another site's page, another host name, and a large, a slow or a malformed request.
pub fn foreign_origins_and_malformed_requests_are_refused() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let start = format!("{MACHINE_API_PATH}/start");
    let form = "cycle=1&who=Eve&enable=true&auto=true&door=true";
    let urlencoded = "Content-Type: application/x-www-form-urlencoded\r\n";
    let from = |origin: &str| format!("{urlencoded}Origin: {origin}\r\n");
    let large = format!("{{\"cycle\": 1, \"who\": \"{}\"}}", "e".repeat(100_000));
    let cases = [
        (start.as_str(), from("http://evil.example"), form, 403),
        (start.as_str(), from("null"), form, 403),
        (start.as_str(), urlencoded.to_owned(), form, 403),
        (start.as_str(), "Content-Type: text/plain\r\n".to_owned(), form, 403),
        (start.as_str(), format!("Host: evil.example\r\n{JSON_HEADER}"), form, 421),
        (start.as_str(), JSON_HEADER.to_owned(), "{", 400),
        (start.as_str(), JSON_HEADER.to_owned(), "{\"cycle\": 1, \"who\": \"Eve\", \"more\": 1}", 422),
        (start.as_str(), JSON_HEADER.to_owned(), large.as_str(), 413),
        ("/api/v1/machines/other/start", JSON_HEADER.to_owned(), "{\"cycle\": 1, \"who\": \"Eve\"}", 404),
        ("/api/v1/machines/..%2f..%2fetc/hold", JSON_HEADER.to_owned(), "{}", 404),
    ];
    for (path, headers, body, wanted) in cases {
        let (status, told) = http.request("POST", path, &headers, body);
        assert_eq!(status, wanted, "{path} {headers}: {told}");
    }
    assert_eq!(http.request("GET", "/", "Host: evil.example\r\n", "").0, 421);
    assert_eq!(http.request("GET", "/../../etc/passwd", "", "").0, 404);
    assert_eq!(http.get_json("/api/v1/runs").as_array().unwrap().len(), 0);
    assert!(!daemon.log().contains("panicked"));
}
