//! Unauthorised or hostile requests: without a token, with a token of another role, from another site's page, with
//! paths outside of the interface.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{FORM_HEADER, HTTP_SECTION, HttpClient, JSON_HEADER, MACHINE_API_PATH, start_request_body};
use crate::support::machine_shop::MachineShop;
use serde_json::{Value, json};

const STATE_TIMEOUT: Duration = Duration::from_secs(300);

/// A machine whose page requires tokens, its daemon, and one token of each role.
pub struct GuardedDaemon {
    pub shop: MachineShop,
    pub daemon: DaemonProcess,
    pub port: u16,
    pub viewer_token: String,
    pub operator_token: String,
    pub metrologist_token: String,
}

pub fn create_token(shop: &MachineShop, name: &str, role: &str) -> String {
    let made = shop.run_trued(&["token", "add", name, "--role", role]);
    assert!(made.status.success(), "{made:?}");
    String::from_utf8(made.stdout).unwrap().trim().to_owned()
}

pub fn bearer_header(token: &str) -> String {
    format!("Authorization: Bearer {token}\r\n")
}

impl GuardedDaemon {
    /// `speed`: argument of `--speed`.
    pub fn new(speed: &str) -> Self {
        Self::start_with_changes(speed, |_| {})
    }

    /// Starts the daemon after `change` of the machine file.
    pub fn start_with_changes(speed: &str, change: impl FnOnce(&MachineShop)) -> Self {
        let shop = MachineShop::with_serve(&format!("{HTTP_SECTION}names = [\"true.example\"]\ntokens = true\n"));
        change(&shop);
        let [viewer, operator, metrologist] =
            ["viewer", "operator", "metrologist"].map(|role| create_token(&shop, &format!("a-{role}"), role));
        let daemon = shop.start_daemon(speed);
        let http = daemon.http();
        let port = http.port;
        Self { shop, daemon, port, viewer_token: viewer, operator_token: operator, metrologist_token: metrologist }
    }

    pub fn get_status(&self, path: &str, headers: &str) -> u16 {
        HttpClient::new(self.port).request("GET", path, headers, "").0
    }

    /// Status of the response to a program's POST request of `what`.
    pub fn post_status(&self, what: &str, token: &str, body: &Value) -> u16 {
        let headers = format!("{JSON_HEADER}{}", bearer_header(token));
        HttpClient::new(self.port).request("POST", &format!("{MACHINE_API_PATH}/{what}"), &headers, &body.to_string()).0
    }

    pub fn machine_state(&self) -> Value {
        self.try_machine_state().unwrap()
    }

    fn try_machine_state(&self) -> io::Result<Value> {
        let headers = bearer_header(&self.viewer_token);
        let (status, text) = HttpClient::new(self.port).try_request("GET", MACHINE_API_PATH, &headers, "")?;
        assert_eq!(status, 200, "{text}");
        Ok(serde_json::from_str(&text).unwrap())
    }

    pub fn wait_until(&self, is_reached: impl Fn(&Value) -> bool) -> Value {
        let started = Instant::now();
        loop {
            // At its limits the daemon closes a connection of the caller with the most connections: repeat the request.
            match self.try_machine_state() {
                Ok(state) if is_reached(&state) => return state,
                other => assert!(started.elapsed() < STATE_TIMEOUT, "{other:?}"),
            }
            sleep(Duration::from_millis(20));
        }
    }

    /// The daemon's complete response, with its head.
    pub fn raw_response(&self, request: &str) -> String {
        send_bytes_and_read_response(self.port, request.as_bytes())
    }

    /// The cookie that the page sets, with its attributes.
    pub fn sign_in_cookie(&self, token: &str, host: &str) -> String {
        let body = format!("token={token}");
        let answer = self.raw_response(&format!(
            "POST /login HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n{FORM_HEADER}Content-Length: {}\r\n\
             Connection: close\r\n\r\n{body}",
            body.len()
        ));
        let set = answer.lines().find_map(|line| line.strip_prefix("set-cookie: "));
        set.unwrap_or_else(|| panic!("{answer}")).to_owned()
    }
}

/// Sends `request`; returns all received bytes until the server closes.
fn send_bytes_and_read_response(port: u16, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(STATE_TIMEOUT)).unwrap();
    // The server may close before all bytes are sent.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

/// Each role can do what it is allowed to, and the log names the token.
pub fn roles_limit_actions() {
    let guarded = GuardedDaemon::new("real");
    let GuardedDaemon { viewer_token: viewer, operator_token: operator, metrologist_token: metrologist, .. } = &guarded;
    let start = json!({"cycle": 1, "enable": true, "auto": true, "door": true, "who": ""});
    let reads = ["/", "/runs", "/live.js", "/api/v1/machines", "/api/v1/audit", "/api/v1/openapi.json"];
    for path in reads {
        assert_eq!(guarded.get_status(path, ""), 401, "{path}");
        assert_eq!(guarded.get_status(path, &bearer_header("trued_0")), 401, "{path}");
        let seen = guarded.get_status(path, &bearer_header(viewer));
        assert!(seen == 200 || seen == 303, "{path}: {seen}");
    }
    let stranger = guarded
        .raw_response("GET /runs HTTP/1.1\r\nHost: true.example\r\nAccept: text/html\r\nConnection: close\r\n\r\n");
    assert!(stranger.starts_with("HTTP/1.1 303") && stranger.contains("location: /login"), "{stranger}");
    for what in ["start", "hold", "acknowledge"] {
        let (status, told) =
            HttpClient::new(guarded.port).request("POST", &format!("{MACHINE_API_PATH}/{what}"), JSON_HEADER, "{}");
        assert_eq!(status, 401, "{what}: {told}");
    }
    assert_eq!(guarded.post_status("start", viewer, &start_request_body()), 403);
    assert_eq!(guarded.post_status("acknowledge", viewer, &start_request_body()), 403);
    assert_eq!(guarded.shop.run_states(), Vec::<String>::new());
    assert_eq!(guarded.post_status("start", operator, &start), 202);
    // A hold is accepted from every authenticated client, whatever else the request contains.
    let spoilt = format!("{JSON_HEADER}{}", bearer_header(viewer));
    assert_eq!(
        HttpClient::new(guarded.port).request("POST", &format!("{MACHINE_API_PATH}/hold"), &spoilt, "{\"why\": 7").0,
        202
    );
    guarded.wait_until(|now| now["state"] == "held");
    assert_eq!(guarded.post_status("acknowledge", metrologist, &json!({"who": "Ada"})), 202);
    let audits = HttpClient::new(guarded.port).request("GET", "/api/v1/audit", &bearer_header(viewer), "").1;
    let audits: Vec<Value> = serde_json::from_str(&audits).unwrap();
    let who: Vec<&str> = audits.iter().map(|audit| audit["who"].as_str().unwrap()).collect();
    assert_eq!(who, ["a-metrologist: Ada", "a-viewer", "a-operator"]);
    // A revoked token is refused at once; the others remain valid.
    assert!(guarded.shop.run_trued(&["token", "revoke", "a-operator"]).status.success());
    assert_eq!(guarded.post_status("start", operator, &start), 401);
    assert_eq!(guarded.get_status("/runs", &bearer_header(operator)), 401);
    assert_eq!(guarded.get_status("/runs", &bearer_header(metrologist)), 200);
}

/// A browser's session: a cookie that no script and no other site's page can read, and that alone is not
/// sufficient.
pub fn session_cookie_is_protected_and_ends() {
    let guarded = GuardedDaemon::new("fast");
    let here = format!("localhost:{}", guarded.port);
    let set = guarded.sign_in_cookie(&guarded.operator_token, &here);
    for word in ["HttpOnly", "SameSite=Strict", "Max-Age=43200", "Path=/"] {
        assert!(set.contains(word), "{word} in {set}");
    }
    assert!(!set.contains("Secure"));
    assert!(guarded.sign_in_cookie(&guarded.operator_token, "true.example").contains("Secure"));
    assert!(!set.contains(&guarded.operator_token));
    let cookie = format!("Cookie: {}\r\n", set.split(';').next().unwrap());
    assert_eq!(guarded.get_status("/runs", &cookie), 200);
    assert_eq!(guarded.get_status("/runs", "Cookie: trued=0123\r\n"), 401);
    // A browser sends cookies of one name for several paths, the longest path first (RFC 6265, 5.4).
    let good = cookie.trim_end().split_once(' ').unwrap().1;
    assert_eq!(guarded.get_status("/runs", &format!("Cookie: trued=0123; {good}; trued=\r\n")), 200);
    assert_eq!(guarded.get_status("/runs", &format!("Cookie: a=b; trued=0123\r\n{cookie}")), 200);
    let many = "trued=0123; ".repeat(20);
    assert_eq!(guarded.get_status("/runs", &format!("Cookie: {many}{good}\r\n")), 401);
    let form = "cycle=1&who=&enable=true&auto=true&door=true";
    let start = |origin: &str| {
        let headers = format!("{FORM_HEADER}{cookie}{origin}");
        HttpClient::new(guarded.port).request("POST", &format!("{MACHINE_API_PATH}/start"), &headers, form).0
    };
    assert_eq!(start("Origin: http://evil.example\r\n"), 403);
    assert_eq!(start("Origin: null\r\n"), 403);
    assert_eq!(start(""), 403);
    assert_eq!(guarded.shop.run_states(), Vec::<String>::new());
    assert_eq!(start(&format!("Origin: http://{here}\r\n")), 303);
    guarded.wait_until(|now| now["state"] == "waiting");
    // A client that signs out, or whose token is revoked, has no session.
    let other = guarded.sign_in_cookie(&guarded.metrologist_token, &here);
    let other = format!("Cookie: {}\r\n", other.split(';').next().unwrap());
    assert_eq!(guarded.get_status("/runs", &other), 200);
    let own = format!("{FORM_HEADER}{other}Origin: http://{here}\r\n");
    assert_eq!(HttpClient::new(guarded.port).request("POST", "/logout", &own, "").0, 303);
    assert_eq!(guarded.get_status("/runs", &other), 401);
    assert!(guarded.shop.run_trued(&["token", "revoke", "a-operator"]).status.success());
    assert_eq!(guarded.get_status("/runs", &cookie), 401);
}

/// One client guesses tokens, another sends many starts. Other clients are not delayed, and no hold is.
pub fn repeated_wrong_tokens_are_limited() {
    let guarded = GuardedDaemon::new("fast");
    // The first refusal comes within this number of tries, however slow the computer is.
    let tries = (0..500).map(|n| guarded.get_status("/runs", &bearer_header(&format!("trued_{n}"))));
    assert!(tries.take_while(|status| *status == 401).count() < 500);
    assert_eq!(guarded.get_status("/runs", &bearer_header(&guarded.viewer_token)), 200);
    let nothing = json!({"who": "Eve"});
    let calls = (0..2000).map(|_| guarded.post_status("acknowledge", &guarded.operator_token, &nothing));
    let allowed = calls.take_while(|status| *status == 409).count();
    assert!((60..2000).contains(&allowed), "{allowed}");
    for _ in 0..70 {
        assert_eq!(guarded.post_status("hold", &guarded.operator_token, &json!({})), 202);
    }
    assert_eq!(guarded.post_status("acknowledge", &guarded.metrologist_token, &nothing), 409);
}

/// Paths that try to bypass the access control, and malformed requests.
pub fn hostile_paths_and_malformed_requests_are_refused() {
    let guarded = GuardedDaemon::new("fast");
    let paths = [
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "//api/v1/runs",
        "/api/v1/runs/",
        "/api//v1/runs",
        "/login/../api/v1/runs",
        "/login/..%2fapi/v1/runs",
        "/login%2f..%2fruns",
        "/API/V1/RUNS",
        "/api/v1/machines/%00",
        "/api/v1/machines/%ff%fe",
        "/api/v1/machines/..%2f..",
        "/api/v1/runs/-1",
        "/api/v1/runs/99999999999999999999",
        "/api/v1/runs?limit=-1",
        "/api/v1/runs?before=1&before=2",
        "/api/v1/machines/x%0d%0aSet-Cookie:%20a=b",
        "/runs/1;a=b",
        "http://evil.example/runs",
        "*",
    ];
    let long = format!("/{}", "a".repeat(20_000));
    let deep = "/a".repeat(4_000);
    for path in paths.iter().copied().chain([long.as_str(), deep.as_str()]) {
        for (who, headers) in [("a stranger", String::new()), ("somebody", bearer_header(&guarded.viewer_token))] {
            let answer = guarded.raw_response(&format!(
                "GET {path} HTTP/1.1\r\nHost: localhost:{}\r\n{headers}Connection: close\r\n\r\n",
                guarded.port
            ));
            let status = answer.split(' ').nth(1).unwrap_or("closed");
            let wanted = ["400", "401", "404", "414", "421", "431", "closed"];
            assert!(wanted.contains(&status), "{who}, {}: {status}", &path[..path.len().min(60)]);
            let head = answer.split("\r\n\r\n").next().unwrap().to_lowercase();
            assert!(!head.contains("set-cookie"), "{path}");
        }
    }
    // With a token, so that only the malformed part causes the refusal.
    let known = bearer_header(&guarded.viewer_token);
    let host = format!("Connection: close\r\nHost: localhost:{}\r\n", guarded.port);
    // Too many fields, though the head is not large.
    let flood: String = (0..500).map(|n| format!("X-{n}: {n}\r\n")).collect();
    let large = format!("X-Large: {}\r\n", "x".repeat(1_000_000));
    let spoilt: [Vec<u8>; 7] = [
        format!("GET /runs HTTP/1.1\r\n{host}{known}{flood}\r\n").into(),
        format!("GET /runs HTTP/1.1\r\n{host}{known}{large}\r\n").into(),
        b"GET /\0/runs HTTP/1.1\r\n\r\n".into(),
        vec![0xff; 10_000],
        format!("GET /runs HTTP/1.1\r\n{host}{host}{known}\r\n").into(),
        format!("POST /login HTTP/1.1\r\n{host}Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n")
            .into(),
        format!("POST /login HTTP/1.1\r\n{host}Content-Length: -1\r\n\r\n").into(),
    ];
    for request in spoilt {
        let answer = send_bytes_and_read_response(guarded.port, &request);
        let status = answer.split(' ').nth(1).unwrap_or("closed");
        let text = String::from_utf8_lossy(&request[..request.len().min(60)]).into_owned();
        assert!(status == "closed" || status.starts_with('4'), "{text}: {answer}");
    }
    assert_eq!(guarded.get_status("/runs", &bearer_header(&guarded.viewer_token)), 200);
    assert!(!guarded.daemon.log().contains("panicked"));
}
