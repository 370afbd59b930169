//! Proposal, approval and undo at the page and its interface.

use std::time::Duration;

use serde_json::{Value, json};

use super::shop::CompensationShop;
use super::verification::{WRITTEN_C_MM, store_second_run};
use crate::serve::hostile_requests::{bearer_header, create_token};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{HttpClient, JSON_HEADER};
use trued::store::CompensationState;

const RUN_PATH: &str = "/api/v1/runs/1/compensation";
const MACHINE_PATH: &str = "/api/v1/machines/linuxcnc-sim5/compensation";

/// The daemon of a machine with a stored run, and one token of each role.
struct CompensationDaemon {
    _daemon: DaemonProcess,
    port: u16,
    viewer: String,
    operator: String,
    metrologist: String,
}

impl CompensationDaemon {
    /// `day`: part of the names of the tokens.
    fn start(shop: &CompensationShop, day: &str) -> Self {
        let [viewer, operator, metrologist] =
            ["viewer", "operator", "metrologist"].map(|role| create_token(&shop.shop, &format!("{day}-{role}"), role));
        let daemon = shop.shop.start_daemon("fast");
        Self { port: daemon.http_port(), _daemon: daemon, viewer, operator, metrologist }
    }

    fn get(&self, path: &str, token: &str) -> (u16, String) {
        HttpClient::new(self.port).request("GET", path, &bearer_header(token), "")
    }

    fn post(&self, path: &str, token: &str, body: &Value) -> (u16, Value) {
        let headers = format!("{JSON_HEADER}{}", bearer_header(token));
        let (status, text) = HttpClient::new(self.port).request("POST", path, &headers, &body.to_string());
        (status, serde_json::from_str(&text).unwrap_or(Value::Null))
    }

    fn proposal_hash(&self) -> Value {
        let (status, text) = self.get(RUN_PATH, &self.viewer);
        assert_eq!(status, 200, "{text}");
        serde_json::from_str::<Value>(&text).unwrap()["sha256"].clone()
    }
}

fn serve_section(tokens: bool) -> String {
    format!(
        "[serve]\nmin_interval_s = 0.0\n[[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n[serve.http]\nlisten = \"127.0.0.1:0\"\ntokens = {tokens}\n"
    )
}

/// Only a metrologist writes, with the hash of the present proposal; viewers see the proposal and the result.
pub fn metrologist_approves_values_on_the_page() {
    let shop = CompensationShop::new();
    shop.append_to_machine_file(&serve_section(true));
    let serve = CompensationDaemon::start(&shop, "monday");
    let CompensationDaemon { viewer, operator, metrologist, .. } = &serve;
    let hash = serve.proposal_hash();
    assert_eq!(hash, json!(shop.hash()), "the page and the command line propose the same");
    let (_, page) = serve.get("/runs/1", viewer);
    assert!(page.contains("href=\"/runs/1/compensation?target=linuxcnc-trunnion\""), "{page}");
    let (_, page) = serve.get("/runs/1/compensation", viewer);
    for part in ["X of C", "xyzbc-trt-kins.x-rot-point", "Approve and write", hash.as_str().unwrap()] {
        assert!(page.contains(part), "{part}: {page}");
    }
    assert!(serve.get("/runs/1/sheet", viewer).1.contains("Not verified on this control"));
    assert!(serve.get("/api/v1/runs/1/sheet.csv", viewer).1.contains("X of C,0.0500,0.0010,mm"));
    let (status, problem) = serve.get("/api/v1/runs/99/compensation", viewer);
    assert!(status == 404 && problem.starts_with('{'), "{problem}");
    let approval = json!({"who": "Ada", "approve": hash});
    for token in ["", viewer, operator] {
        let (status, _) = serve.post(RUN_PATH, token, &approval);
        assert!([401, 403].contains(&status), "{status}");
    }
    let (status, problem) = serve.post(RUN_PATH, metrologist, &json!({"who": "Ada", "approve": "0".repeat(64)}));
    assert_eq!((status, &problem["code"]), (409, &json!("no-compensation")));
    assert!(problem["remedy"].as_str().unwrap().contains("approve its hash"), "{problem}");
    assert!(shop.is_as_before());
    shop.assert_refused(&shop.write(hash.as_str().unwrap()), "is in use");
    assert_eq!(serve.post(RUN_PATH, metrologist, &approval), (201, json!({"id": 1})));
    assert!(shop.is_corrected() && shop.state() == Some(CompensationState::Written));
    let (_, page) = serve.get("/machines/linuxcnc-sim5", viewer);
    assert!(page.contains("were written to the control") && page.contains("monday-metrologist: Ada"), "{page}");
    let (_, status) = serve.get(MACHINE_PATH, viewer);
    assert!(status.contains("\"state\":\"written\""), "{status}");
    let undo = format!("{MACHINE_PATH}/undo");
    assert_eq!(serve.post(&undo, operator, &json!({"who": "Ada"})).0, 403);
    assert!(shop.is_corrected());
    assert_eq!(serve.post(&undo, metrologist, &json!({"who": "Ada"})).0, 201);
    assert!(shop.is_as_before());
    let (_, audit) = serve.get("/api/v1/audit", viewer);
    for part in ["compensation from run 1", "undo of the last compensation", "is not the present proposal"] {
        assert!(audit.contains(part), "{part}: {audit}");
    }
}

pub fn daemon_killed_during_a_write_shows_and_finishes_it() {
    let shop = CompensationShop::new();
    shop.append_to_machine_file(&serve_section(true));
    let serve = CompensationDaemon::start(&shop, "monday");
    let approval = json!({"who": "Ada", "approve": serve.proposal_hash()});
    let calls: usize = std::fs::read_to_string(shop.shop.path("calls")).unwrap().trim().parse().unwrap();
    // After the second value is set: the write proposes once more, with one call.
    std::fs::write(shop.shop.path("kill-at"), format!("{}+", calls + 1 + 3 + 5 + 4)).unwrap();
    let headers = format!("{JSON_HEADER}{}", bearer_header(&serve.metrologist));
    HttpClient::new(serve.port).try_request("POST", RUN_PATH, &headers, &approval.to_string()).unwrap_err();
    drop(serve);
    std::fs::remove_file(shop.shop.path("kill-at")).unwrap();
    assert!(!shop.is_corrected() && !shop.is_as_before() && shop.state() == Some(CompensationState::Writing));
    let serve = CompensationDaemon::start(&shop, "tuesday");
    let (_, page) = serve.get("/machines/linuxcnc-sim5", &serve.viewer);
    assert!(page.contains("is unfinished: some values of the control may be new and others old"), "{page}");
    let finish = format!("{MACHINE_PATH}/finish");
    assert_eq!(serve.post(&finish, &serve.operator, &json!({"who": "Ada"})).0, 403);
    assert_eq!(serve.post(&finish, &serve.metrologist, &json!({"who": "Ada"})).0, 201);
    assert!(shop.is_corrected() && shop.state() == Some(CompensationState::Written));
}

/// The page of the second run shows the verification; a metrologist stores it.
pub fn metrologist_stores_a_verification() {
    let shop = CompensationShop::new();
    shop.append_to_machine_file(&serve_section(true));
    assert!(shop.write(&shop.hash()).status.success());
    let run = store_second_run(&shop, [80.0, -30.3], WRITTEN_C_MM);
    let serve = CompensationDaemon::start(&shop, "monday");
    let CompensationDaemon { viewer, operator, metrologist, .. } = &serve;
    let path = format!("/runs/{run}/verification");
    assert!(serve.get("/machines/linuxcnc-sim5", viewer).1.contains("They are not verified"));
    assert!(
        serve.get(&format!("/runs/{run}"), viewer).1.contains(&format!("href=\"{path}?target=linuxcnc-trunnion\""))
    );
    assert!(!serve.get("/runs/1", viewer).1.contains("/verification"));
    let (_, page) = serve.get(&path, viewer);
    for part in ["X of C", "outside the limit", "Store this result"] {
        assert!(page.contains(part), "{part}: {page}");
    }
    let (api_path, by) = (format!("/api/v1{path}"), json!({"who": "Ada"}));
    assert!(serve.get(&api_path, viewer).1.contains("\"new_position_count\":4"));
    for token in ["", viewer, operator] {
        assert!([401, 403].contains(&serve.post(&api_path, token, &by).0));
    }
    assert_eq!(shop.state(), Some(CompensationState::Written));
    assert_eq!(serve.post(&api_path, metrologist, &by), (201, json!({"id": 1})));
    assert!(shop.is_corrected() && shop.state() == Some(CompensationState::NotConfirmed));
    let (_, page) = serve.get("/machines/linuxcnc-sim5", viewer);
    assert!(
        page.contains("did not confirm them") && page.contains("restore the values before this compensation"),
        "{page}"
    );
}

/// Nobody is known to be a metrologist.
pub fn page_without_tokens_writes_nothing() {
    let shop = CompensationShop::new();
    shop.append_to_machine_file(&serve_section(false));
    let daemon = shop.shop.start_daemon("fast");
    let approval = json!({"who": "Ada", "approve": shop.hash()});
    let (status, problem) = daemon.http().post_json(RUN_PATH, &approval);
    assert_eq!((status, &problem["code"]), (403, &json!("no-token")));
    assert!(shop.is_as_before());
}

/// Only the worker opens the link of the control; here nothing listens at its address.
pub fn values_over_the_link_are_read_by_the_worker() {
    let shop = CompensationShop::new();
    shop.append_to_machine_file("\n[compensation.work-offset]\nslot = \"G55\"\n");
    shop.append_to_machine_file(&serve_section(true));
    let serve = CompensationDaemon::start(&shop, "monday");
    // At the start of the service the worker is not ready.
    let is_waiting = || serve.get("/api/v1/machines/linuxcnc-sim5", &serve.viewer).1.contains("\"state\":\"waiting\"");
    assert!((0..100).any(|_| is_waiting() || {
        std::thread::sleep(Duration::from_millis(50));
        false
    }));
    let [by_link, by_pins] = ["work-offset", "linuxcnc-trunnion"].map(|kind| format!("{RUN_PATH}?target={kind}"));
    assert!(serve.get("/runs/1", &serve.viewer).1.contains("href=\"/runs/1/compensation?target=work-offset\""));
    for _ in 0..2 {
        let (status, problem) = serve.get(&by_link, &serve.viewer);
        assert!(status == 403 && problem.contains("only a metrologist may read"), "{status} {problem}");
        let (status, problem) = serve.get(&by_link, &serve.metrologist);
        assert!(status == 409 && problem.contains("no linuxcncrsh listens"), "{status} {problem}");
        let (status, problem) = serve.get(&format!("{MACHINE_PATH}?target=work-offset"), &serve.metrologist);
        assert!(status == 409 && problem.contains("no linuxcncrsh listens"), "{status} {problem}");
    }
    assert_eq!(serve.get(&by_pins, &serve.viewer).0, 200);
    for action in [&["propose", "1"][..], &["status"]] {
        shop.assert_refused(&shop.compensate(&[action, &["--target", "work-offset"]].concat()), "is in use");
        assert!(shop.compensate(&[action, &["--target", "linuxcnc-trunnion"]].concat()).status.success());
    }
}
