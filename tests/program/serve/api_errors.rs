//! Every error of the HTTP interface is JSON with a code, a message and a remedy; HEAD and OPTIONS are answered.

use serde_json::Value;

use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{FORM_HEADER, HTTP_SECTION, JSON_HEADER, MACHINE_API_PATH};
use crate::support::machine_shop::MachineShop;
use std::io::{Read, Write};

struct ApiResponse {
    status: u16,
    /// Status line and header fields, in lower case.
    head: String,
    body: String,
}

fn request(daemon: &DaemonProcess, method: &str, path: &str, headers: &str, body: &str) -> ApiResponse {
    let http = daemon.http();
    let (mut stream, port, length) = (http.connect(), http.port, body.len());
    write!(
        stream,
        "{method} {path} HTTP/1.1\r\nHost: localhost:{port}\r\nOrigin: http://localhost:{port}\r\n{headers}\
         Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
    .unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    let (head, body) = response.split_once("\r\n\r\n").unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    ApiResponse { status, head: head.to_lowercase(), body: body.to_owned() }
}

fn assert_problem(response: &ApiResponse, status: u16, code: &str, what: &str) {
    let ApiResponse { head, body, .. } = response;
    assert_eq!(response.status, status, "{what}: {head} {body}");
    assert!(head.contains("content-type: application/json"), "{what}: {head}");
    let problem: Value = serde_json::from_str(body).unwrap_or_else(|_| panic!("{what}: {body}"));
    assert_eq!(problem["code"], code, "{what}: {body}");
    assert_eq!(problem.as_object().unwrap().keys().collect::<Vec<_>>(), ["code", "message", "remedy"], "{what}");
    for text in ["message", "remedy"] {
        assert!(problem[text].as_str().unwrap().len() > 10, "{what}: {body}");
    }
}

pub fn every_error_is_a_problem_in_json() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let start = format!("{MACHINE_API_PATH}/start");
    let large = format!("{{\"cycle\": 1, \"who\": \"{}\"}}", "a".repeat(20_000));
    let cases = [
        ("GET", "/api/v1/runs/first", "", "", 400, "unreadable"),
        ("GET", "/api/v1/runs/99999999999999999999", "", "", 400, "unreadable"),
        ("GET", "/api/v1/machines/%ff%fe", "", "", 400, "unreadable"),
        ("GET", "/api/v1/runs?limit=-1", "", "", 400, "unreadable"),
        ("GET", "/api/v1/runs?colour=red", "", "", 400, "unreadable"),
        ("GET", "/api/v1/compare?a=1", "", "", 400, "unreadable"),
        ("GET", "/api/v1/runs/1/readings?after=x", "", "", 400, "unreadable"),
        ("GET", "/api/v1/runs/1", "", "", 404, "not-found"),
        ("GET", "/api/v1/runs/1/readings.csv", "", "", 404, "not-found"),
        ("GET", "/api/v1/machines/none", "", "", 404, "not-found"),
        ("GET", "/api/v1/machines/none/events", "", "", 404, "not-found"),
        ("GET", "/api/v1/nothing", "", "", 404, "not-found"),
        ("GET", "/api/v1/runs/", "", "", 404, "not-found"),
        ("GET", "/api/v1", "", "", 404, "not-found"),
        ("GET", "/api", "", "", 404, "not-found"),
        ("POST", "/api/v1/nothing", JSON_HEADER, "{}", 404, "not-found"),
        ("OPTIONS", "/api/v1/nothing", "", "", 404, "not-found"),
        ("DELETE", "/api/v1/runs/1", JSON_HEADER, "", 405, "method-not-allowed"),
        ("POST", "/api/v1/machines", JSON_HEADER, "{}", 405, "method-not-allowed"),
        ("GET", &start, "", "", 405, "method-not-allowed"),
        ("PUT", &start, JSON_HEADER, "{}", 405, "method-not-allowed"),
        ("POST", &start, JSON_HEADER, "{", 400, "unreadable"),
        ("POST", &start, JSON_HEADER, "{\"cycle\": 1}", 422, "unreadable"),
        ("POST", &start, JSON_HEADER, "{\"cycle\": 70000, \"who\": \"Ada\"}", 422, "unreadable"),
        ("POST", &start, JSON_HEADER, &large, 413, "unreadable"),
        ("POST", &start, "Content-Type: text/plain\r\n", "cycle=1", 415, "unreadable"),
        ("POST", &start, "", "", 415, "unreadable"),
        ("POST", &start, FORM_HEADER, "cycle=one&who=Ada", 422, ""),
        ("POST", "/api/v1/machines/none/start", JSON_HEADER, "{\"cycle\": 1, \"who\": \"Ada\"}", 404, "not-found"),
    ];
    for (method, path, headers, body, status, code) in cases {
        let response = request(&daemon, method, path, headers, body);
        let what = format!("{method} {path} {}", &body[..body.len().min(40)]);
        match code {
            // A form of the page gets a page.
            "" => assert!(response.status == status && response.body.contains("Request failed"), "{}", response.body),
            _ => assert_problem(&response, status, code, &what),
        }
    }
    let wrong_host = request(&daemon, "GET", "/api/v1/nothing", "X-Forwarded-Host: a\r\nHost: evil.example\r\n", "");
    assert_problem(&wrong_host, 421, "other-host", "wrong host");
    let page = request(&daemon, "GET", "/nothing", "", "");
    assert!(page.status == 404 && !page.head.contains("json"), "{}", page.head);
}

pub fn head_and_options_are_answered() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let get = request(&daemon, "GET", "/api/v1/runs", "", "");
    let head = request(&daemon, "HEAD", "/api/v1/runs", "", "");
    let length = format!("content-length: {}", get.body.len());
    assert!(get.head.contains(&length) && head.head.contains(&length), "{} {}", get.head, head.head);
    assert_eq!((head.status, head.body.as_str()), (200, ""));
    assert!(head.head.contains("content-type: application/json"), "{}", head.head);
    let missing = request(&daemon, "HEAD", "/api/v1/runs/first", "", "");
    assert_eq!((missing.status, missing.body.as_str()), (400, ""));
    assert!(missing.head.contains("content-type: application/json"), "{}", missing.head);
    for (path, methods) in [("/api/v1/runs".to_owned(), "get,head"), (format!("{MACHINE_API_PATH}/start"), "post")] {
        let options = request(&daemon, "OPTIONS", &path, "", "");
        assert_eq!((options.status, options.body.as_str()), (204, ""), "{path}");
        assert!(options.head.contains(&format!("allow: {methods}\r\n")), "{}", options.head);
        let refused = request(&daemon, "PATCH", &path, JSON_HEADER, "");
        assert!(refused.head.contains(&format!("allow: {methods}")), "{}", refused.head);
    }
}
