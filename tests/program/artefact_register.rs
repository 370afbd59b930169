//! `trued artefact`, and runs with an artefact that is in the register.

use std::io::ErrorKind;
use std::net::TcpListener;
use std::process::{Command, Output};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::harness::{Pool, Trials, trials};
use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::{MachineShop, stderr};

const ARTEFACT_NAME: &str = "cylinder 7";
const REPORT_SECTION: &str = "\n[report]\nartefact = \"cylinder 7\"\n";
const CONDITION_TIMEOUT: Duration = Duration::from_secs(120);

/// The date in `days` days, from coreutils.
fn date_in_days(days: i32) -> String {
    let output = Command::new("date").args(["-d", &format!("{days} days"), "+%F"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

fn add_artefact(shop: &MachineShop, name: &str, certificate: &str, due: &str) {
    let added = shop.run_trued(&["artefact", "add", name, "--certificate", certificate, "--due", due]);
    assert!(added.status.success(), "{}", stderr(&added));
}

/// The built-in machine with the registered artefact; `more`: further keys of `[report]`.
fn shop_with_artefact(more: &str) -> MachineShop {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("\n[simulated]\n", &format!("{REPORT_SECTION}{more}\n[simulated]\n"));
    shop
}

fn assert_refused(output: &Output, words: &[&str]) {
    assert_eq!(output.status.code(), Some(1), "{}", stderr(output));
    for word in words {
        assert!(stderr(output).contains(word), "{word} in {}", stderr(output));
    }
}

fn artefacts_are_added_listed_and_removed() {
    let shop = MachineShop::with_machine_file("");
    let [past, soon, later] = [-1, 10, 400].map(date_in_days);
    add_artefact(&shop, "ring 3", "K-3", &past);
    add_artefact(&shop, "sphere 2", "K-2", &soon);
    let add = ["artefact", "add", ARTEFACT_NAME, "--certificate", "K-1", "--due", &later, "--kind", "cylinder 90 mm"];
    assert!(shop.run_trued(&add).status.success());
    let expected = json!([
        {"name": ARTEFACT_NAME, "kind": "cylinder 90 mm", "certificate": "K-1", "due": later, "state": "valid"},
        {"name": "ring 3", "kind": null, "certificate": "K-3", "due": past, "state": "expired"},
        {"name": "sphere 2", "kind": null, "certificate": "K-2", "due": soon, "state": "due_within_30_days"},
    ]);
    assert_eq!(shop.run_json(&["artefact", "list", "--json"]), expected);
    let listed = String::from_utf8(shop.run_trued(&["artefact", "list"]).stdout).unwrap();
    for (line, words) in listed.lines().zip([
        ["valid", &later, "cylinder 7 (cylinder 90 mm)", "K-1"],
        ["expired", &past, "ring 3", "K-3"],
        ["due within 30 days", &soon, "sphere 2", "K-2"],
    ]) {
        assert!(words.iter().all(|word| line.contains(word)), "{words:?} in {line}");
    }
    assert_eq!(listed.lines().count(), 3, "{listed}");
    for invalid in ["2027-02-29", "31.3.2027", "20270331", ""] {
        let refused = shop.run_trued(&["artefact", "add", "ring 4", "--certificate", "K-4", "--due", invalid]);
        assert_eq!(refused.status.code(), Some(2), "{invalid}: {}", stderr(&refused));
    }
    assert!(shop.run_trued(&["artefact", "remove", "ring 3"]).status.success());
    assert_refused(&shop.run_trued(&["artefact", "remove", "ring 3"]), &["there is no artefact `ring 3`"]);
    let names = shop.run_json(&["artefact", "list", "--json"]);
    let names: Vec<&Value> = names.as_array().unwrap().iter().map(|artefact| &artefact["name"]).collect();
    assert_eq!(names, [ARTEFACT_NAME, "sphere 2"]);
}

fn report_has_the_certificate_of_the_register() {
    let shop = shop_with_artefact("");
    let due = date_in_days(10);
    add_artefact(&shop, ARTEFACT_NAME, "K-2026-114", &due);
    let report = shop.path_text("report.html");
    let run = shop.self_calibration_command().args(["--report", &report]).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    let page = std::fs::read_to_string(report).unwrap();
    assert!(page.contains("K-2026-114") && page.contains(&due), "{page}");
    let plan = shop.run_json(&["plan", "self-calibration", "--json", "--machine", &shop.machine_path()]);
    let expected = json!({"artefact": ARTEFACT_NAME, "certificate": "K-2026-114", "certificate_due": due});
    assert_eq!(plan["report"], expected);
    // The stored run keeps the certificate that was valid when it was measured.
    add_artefact(&shop, ARTEFACT_NAME, "K-2027-1", &date_in_days(400));
    let export = shop.path_text("export");
    assert!(shop.run_trued(&["export", "1", "--to", &export]).status.success());
    let plan = std::fs::read(shop.path("export/run-1-plan.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&plan).unwrap()["report"], expected);
}

/// Whether a client connects to `control` before `command` ends. The connection is closed at once.
fn is_control_connected(control: &TcpListener, mut command: Command) -> (bool, Output) {
    control.set_nonblocking(true).unwrap();
    let child = command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    let waiting = std::thread::spawn(move || child.wait_with_output().unwrap());
    let mut is_connected = false;
    loop {
        // The end is read first: a connection before it is seen below.
        let is_ended = waiting.is_finished();
        match control.accept() {
            Ok(_) => is_connected = true,
            Err(error) if error.kind() == ErrorKind::WouldBlock => sleep(Duration::from_millis(10)),
            Err(error) => panic!("{error}"),
        }
        if is_ended {
            return (is_connected, waiting.join().unwrap());
        }
    }
}

/// The control is a port of this test: it sees each connection.
fn run_with_an_expired_certificate_opens_no_device() {
    let control = TcpListener::bind("127.0.0.1:0").unwrap();
    let shop = shop_with_artefact("");
    let tcp = format!("kind = \"grbl\"\ntcp = \"{}\"", control.local_addr().unwrap());
    shop.replace_in_machine_file("\nkind = \"simulated\"", &format!("\n{tcp}"));
    shop.replace_in_machine_file("\nwire = \"memory\"", "");
    let yesterday = date_in_days(-1);
    add_artefact(&shop, ARTEFACT_NAME, "K-2026-114", &yesterday);
    let (is_connected, refused) = is_control_connected(&control, shop.self_calibration_command());
    assert_refused(&refused, &["K-2026-114", &yesterday, "artefact add 'cylinder 7' --certificate"]);
    assert!(!is_connected);
    assert!(shop.run_states().is_empty());
    // The plan can still be printed, and the next certificate lets the run connect.
    let plan = shop.run_json(&["plan", "self-calibration", "--json", "--machine", &shop.machine_path()]);
    assert_eq!(plan["report"]["certificate_due"], yesterday);
    add_artefact(&shop, ARTEFACT_NAME, "K-2027-1", &date_in_days(400));
    let (is_connected, _) = is_control_connected(&control, shop.self_calibration_command());
    assert!(is_connected);
}

fn certificate_in_machine_file_and_register_is_refused() {
    let (machine_file_due, register_due) = (date_in_days(50), date_in_days(400));
    for key in ["certificate = \"K-2026-114\"".to_owned(), format!("certificate_due = \"{machine_file_due}\"")] {
        let shop = shop_with_artefact(&format!("{key}\n"));
        let machine = shop.machine_path();
        let plan = ["plan", "self-calibration", "--json", "--machine", &machine];
        assert!(shop.run_trued(&plan).status.success());
        add_artefact(&shop, ARTEFACT_NAME, "K-2026-114", &register_due);
        let words = ["[report] states `certificate", "artefact remove 'cylinder 7'"];
        for arguments in [&plan[..], &["check", "--machine", &machine], &["serve", "--check", "--machine", &machine]] {
            assert_refused(&shop.run_trued(arguments), &words);
        }
        assert_refused(&shop.run_self_calibration(), &words);
        assert!(shop.run_states().is_empty());
        // An artefact that is not in the register may state its certificate in the machine file.
        assert!(shop.run_trued(&["artefact", "remove", ARTEFACT_NAME]).status.success());
        assert!(shop.run_trued(&plan).status.success());
    }
}

/// The finding about the report, and the exit code of `trued check`.
fn report_finding(shop: &MachineShop) -> (String, Option<i32>) {
    let output = shop.run_trued(&["check", "--json", "--machine", &shop.machine_path()]);
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(&output)));
    let findings = summary["findings"].as_array().unwrap();
    let of_report: Vec<&Value> = findings.iter().filter(|finding| finding["part"] == "report").collect();
    assert_eq!(of_report.len(), 1, "{summary}");
    (of_report[0].to_string(), output.status.code())
}

fn check_uses_the_certificate_of_the_register() {
    let shop = shop_with_artefact("");
    add_artefact(&shop, ARTEFACT_NAME, "K-2026-114", &date_in_days(400));
    let (finding, exit_code) = report_finding(&shop);
    assert!(finding.contains("\"ok\"") && exit_code == Some(0), "{finding}");
    let yesterday = date_in_days(-1);
    add_artefact(&shop, ARTEFACT_NAME, "K-2026-114", &yesterday);
    let (finding, exit_code) = report_finding(&shop);
    assert!(finding.contains(&yesterday) && finding.contains("trued artefact add"), "{finding}");
    assert_eq!(exit_code, Some(1));
}

/// An expired certificate of an artefact that is not in the register only marks the report.
fn unregistered_artefact_with_an_expired_certificate_is_measured() {
    let yesterday = date_in_days(-1);
    let shop = shop_with_artefact(&format!("certificate = \"K-2026-114\"\ncertificate_due = \"{yesterday}\"\n"));
    add_artefact(&shop, "cylinder 8", "K-8", &yesterday);
    let report = shop.path_text("report.html");
    let run = shop.self_calibration_command().args(["--report", &report]).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    let page = std::fs::read_to_string(report).unwrap();
    assert!(page.contains(&yesterday) && page.contains("expired before this measurement"), "{page}");
}

fn daemon_refuses_starts_until_the_new_certificate_is_entered() {
    let shop = shop_with_artefact("");
    add_artefact(&shop, ARTEFACT_NAME, "K-2026-114", &date_in_days(-1));
    let machine = shop.machine_path();
    assert_refused(&shop.run_trued(&["serve", "--check", "--machine", &machine]), &["K-2026-114", "trued"]);
    let daemon = shop.start_daemon("fast");
    daemon.wait_for_log("no cycle will be started: the certificate `K-2026-114`");
    let (status, refusal) = daemon.http().post_action("start", &crate::support::http::start_request_body());
    assert_eq!((status, refusal["code"].as_str()), (409, Some("refused")), "{refusal}");
    assert!(refusal["remedy"].as_str().unwrap().contains("trued artefact add"), "{refusal}");
    // No acknowledgement is required, and no run has begun.
    assert_eq!(daemon.http().machine_state()["state"], "waiting");
    assert!(shop.run_states().is_empty());

    add_artefact(&shop, ARTEFACT_NAME, "K-2027-1", &date_in_days(400));
    assert!(shop.run_trued(&["serve", "--check", "--machine", &machine]).status.success());
    let started = Instant::now();
    while daemon.http().start_cycle(1) != 202 {
        assert!(started.elapsed() < CONDITION_TIMEOUT, "{}", daemon.log());
        sleep(Duration::from_millis(50));
    }
    daemon.http().wait_for_state("waiting");
    assert_eq!(shop.run_states(), ["finished"]);

    // The certificate expires while the daemon runs.
    add_artefact(&shop, ARTEFACT_NAME, "K-2027-1", &date_in_days(-1));
    daemon.wait_for_log("no cycle will be started: the certificate `K-2027-1`");
    assert_eq!(daemon.http().start_cycle(1), 409);
    assert_eq!(shop.run_states(), ["finished"]);
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 5;
        artefacts_are_added_listed_and_removed,
        report_has_the_certificate_of_the_register,
        run_with_an_expired_certificate_opens_no_device,
        certificate_in_machine_file_and_register_is_refused,
        check_uses_the_certificate_of_the_register,
        unregistered_artefact_with_an_expired_certificate_is_measured,
        daemon_refuses_starts_until_the_new_certificate_is_entered,
    ]
}
