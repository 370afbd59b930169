//! A browser whose request is refused gets a page with an explanation. A program gets JSON.

use super::hostile_requests::GuardedDaemon;
use crate::support::http::{FORM_HEADER, JSON_HEADER, MACHINE_API_PATH};

const BROWSER_ACCEPT_HEADER: &str = "Accept: text/html,application/xhtml+xml;q=0.9,*/*;q=0.8\r\n";

/// Head and body.
type HeadAndBody = (String, String);

fn send_request(guarded: &GuardedDaemon, request: &str, headers: &str, body: &str) -> HeadAndBody {
    let (port, length) = (guarded.port, body.len());
    let answer = guarded.raw_response(&format!(
        "{request} HTTP/1.1\r\nHost: localhost:{port}\r\nOrigin: http://localhost:{port}\r\n{headers}\
         Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    ));
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.to_lowercase(), body.to_owned())
}

/// Asserts that the answer is a page with these words.
fn assert_error_page((head, body): &HeadAndBody, status: &str, words: &[&str]) {
    assert!(head.starts_with(&format!("http/1.1 {status}")), "{head}");
    assert!(head.contains("content-type: text/html"), "{head}");
    assert!(body.contains("</html>") && body.contains("Request failed"), "{body}");
    for word in words {
        assert!(body.contains(word), "{word} in {body}");
    }
}

fn assert_error_json((head, body): &HeadAndBody, status: &str, code: &str) {
    assert!(head.starts_with(&format!("http/1.1 {status}")), "{head}");
    let told: serde_json::Value = serde_json::from_str(body).unwrap();
    assert_eq!(told["code"], code);
}

pub fn refusals_are_pages_for_browsers_and_json_for_programs() {
    let guarded = GuardedDaemon::new("fast");
    let here = format!("localhost:{}", guarded.port);
    let cookie = |token: &str| {
        let set = guarded.sign_in_cookie(token, &here);
        format!("Cookie: {}\r\n", set.split(';').next().unwrap())
    };
    let (viewer, operator) = (cookie(&guarded.viewer_token), cookie(&guarded.operator_token));
    let form = |what: &str, cookie: &str| {
        let headers = format!("{BROWSER_ACCEPT_HEADER}{FORM_HEADER}{cookie}");
        send_request(&guarded, &format!("POST {MACHINE_API_PATH}/{what}"), &headers, "who=Eve")
    };
    let program = |request: &str, headers: &str| {
        send_request(&guarded, request, &format!("{BROWSER_ACCEPT_HEADER}{headers}"), "{\"who\": \"Eve\"}")
    };
    assert_error_page(&form("start", &viewer), "403", &["role operator", "sign in with such a token"]);
    let acknowledge = format!("POST {MACHINE_API_PATH}/acknowledge");
    assert_error_json(&program(&acknowledge, &format!("{JSON_HEADER}{viewer}")), "403", "wrong-role");
    // Most important for a hold: the operator must read that the machine was not held.
    let signed_out = ["the request was not executed", "sign in, then", "href=\"/login\""];
    assert_error_page(&form("hold", "Cookie: trued=0123\r\n"), "401", &signed_out);
    assert_error_page(&form("hold", ""), "401", &signed_out);
    assert_error_json(&program(&acknowledge, JSON_HEADER), "401", "no-token");
    assert_error_json(&program("GET /api/v1/runs", ""), "401", "no-token");
    let mut answers = (0..2000).map(|_| form("acknowledge", &operator));
    let often = answers.find(|(head, _)| !head.starts_with("http/1.1 409")).unwrap();
    assert_error_page(&often, "429", &["too many requests", "wait "]);
    assert!(often.0.contains("retry-after: "), "{}", often.0);
    let json = std::iter::repeat_with(|| program(&acknowledge, &format!("{JSON_HEADER}{operator}")));
    let often = json.take(2000).find(|(head, _)| !head.starts_with("http/1.1 409")).unwrap();
    assert_error_json(&often, "429", "too-often");
    let door =
        |_| send_request(&guarded, "POST /login", &format!("{BROWSER_ACCEPT_HEADER}{FORM_HEADER}"), "token=trued_0");
    let often = (0..500).map(door).find(|(head, _)| !head.starts_with("http/1.1 401")).unwrap();
    assert_error_page(&often, "429", &["too many requests", "wait "]);
}
