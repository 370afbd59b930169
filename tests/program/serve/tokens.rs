//! Tokens that are created and revoked by another user than the daemon's, and a token list that cannot be read.

use std::os::unix::fs::{MetadataExt, chown};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::json;

use super::hostile_requests::{GuardedDaemon, bearer_header, create_token};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{HTTP_SECTION, start_request_body};
use crate::support::machine_shop::MachineShop;

/// Id of `nobody`, the daemon's own user.
const DAEMON_USER_ID: u32 = 65_534;
const LOG_TIMEOUT: Duration = Duration::from_secs(300);

/// Root creates the tokens and revokes one; the daemon runs as another user, as under systemd.
pub fn daemon_of_another_user_reads_tokens_created_by_root() {
    let shop = MachineShop::with_serve(&format!("{HTTP_SECTION}tokens = true\n"));
    let state = shop.path_text("state");
    std::fs::create_dir(&state).unwrap();
    if chown(&state, Some(DAEMON_USER_ID), Some(DAEMON_USER_ID)).is_err() {
        println!("skipped, for this is not root");
        return;
    }
    chown(Path::new(&state).parent().unwrap(), Some(DAEMON_USER_ID), Some(DAEMON_USER_ID)).unwrap();
    let [gone, stays] = ["gone", "stays"].map(|name| create_token(&shop, name, "operator"));
    // A copy of the program that this user can execute. It is written by another process: a child that another trial
    // starts meanwhile would inherit the open file, and an open file cannot be executed.
    let program = shop.path_text("trued");
    assert!(Command::new("cp").args([env!("CARGO_BIN_EXE_trued"), &program]).status().unwrap().success());
    let mut command = Command::new(program);
    command.args(["serve", "--speed", "fast", "--machine", &shop.machine_path(), "--state", &state]);
    command.uid(DAEMON_USER_ID).gid(DAEMON_USER_ID);
    let daemon = DaemonProcess::start(&mut command);
    let http = daemon.http();
    let reads = |token: &str| http.request("GET", "/api/v1/runs", &bearer_header(token), "").0;
    assert_eq!((reads(&gone), reads(&stays)), (200, 200));
    let revoked = shop.run_trued(&["token", "revoke", "gone"]);
    assert!(revoked.status.success(), "{revoked:?}");
    assert_eq!((reads(&gone), reads(&stays)), (401, 200));
    let file = std::fs::metadata(Path::new(&state).join("tokens.json")).unwrap();
    assert_eq!((file.uid(), file.mode() & 0o777), (DAEMON_USER_ID, 0o600));
}

/// All requests are refused, the log gives the reason, and a hold still works.
pub fn unreadable_token_file_refuses_all_but_holds() {
    let guarded = GuardedDaemon::new("fast");
    let list = Path::new(&guarded.shop.path_text("state")).join("tokens.json");
    let sound = std::fs::read(&list).unwrap();
    let said = |words: &str| guarded.daemon.log().matches(words).count();
    std::fs::write(&list, "{").unwrap();
    for _ in 0..3 {
        assert_eq!(guarded.post_status("start", &guarded.operator_token, &start_request_body()), 503);
        assert_eq!(guarded.get_status("/runs", &bearer_header(&guarded.viewer_token)), 503);
    }
    assert_eq!(guarded.post_status("hold", &guarded.viewer_token, &json!({})), 202);
    assert_eq!(guarded.post_status("hold", "trued_0", &json!({})), 401);
    std::fs::write(&list, sound).unwrap();
    assert_eq!(guarded.get_status("/runs", &bearer_header(&guarded.viewer_token)), 200);
    let began = Instant::now();
    while said("the tokens can be read again") == 0 {
        assert!(began.elapsed() < LOG_TIMEOUT, "{}", guarded.daemon.log());
        sleep(Duration::from_millis(20));
    }
    assert_eq!((said("so access is refused"), said("the tokens can be read again")), (1, 1));
    assert!(guarded.shop.run_states().is_empty());
}
