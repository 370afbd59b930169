//! The command `trued run` while a daemon has the machine.

use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::MachineShop;

/// The command requests the cycle from the daemon, and ends as if it had measured itself.
pub fn trued_run_requests_the_cycle_from_a_running_daemon() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let machine = shop.machine_path();
    let run = |method: &str, more: &[&str]| {
        let output = shop.run_trued(&[&["run", method, "--machine", &machine], more].concat());
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), told, String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (code, told, _) = run("self-calibration", &[]);
    assert!(code == Some(2) && told.contains("no operator has confirmed"), "{code:?} {told}");
    let (code, told, _) = run("latch-delay", &["--acknowledge", "Ada"]);
    assert!(code == Some(1) && told.contains("none of its cycles has the method latch-delay"), "{told}");
    let (code, told, _) = run("self-calibration", &["--acknowledge", "Ada", "--repeat", "2"]);
    assert!(code == Some(1) && told.contains("--repeat"), "{told}");
    let (code, told, _) = run("self-calibration", &["--acknowledge", "Ada", "--speed", "fast"]);
    assert!(code == Some(1) && told.contains("--speed"), "{told}");
    assert!(shop.run_states().is_empty());
    let (code, told, said) = run("self-calibration", &["--acknowledge", "Ada", "--json"]);
    assert_eq!(code, Some(0), "{told}");
    let estimate: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(estimate, shop.run_json(&["show", "1", "--json"]));
    assert_eq!(shop.run_states(), ["finished"]);
    assert!(daemon.log().contains("cycle 1 is started by Ada"));
}

/// A machine file that differs from the daemon's is not ignored, whether it is another file or the same file after
/// a change; an identical copy is accepted.
pub fn other_machine_file_is_refused() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let _daemon = shop.start_daemon("fast");
    let run = |machine: &str| {
        let measure = ["run", "self-calibration", "--acknowledge", "Ada", "--machine", machine];
        let output = shop.run_trued(&measure);
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (own, copy) = (shop.machine_path(), shop.path_text("copy.toml"));
    std::fs::copy(&own, &copy).unwrap();
    shop.replace_in_machine_file("EX0C_um = 500.0", "EX0C_um = 5.0");
    let (code, told) = run(&own);
    assert!(
        code == Some(1)
            && told.contains(
                "differs from the machine file that the running daemon has \
        read"
            ),
        "{told}"
    );
    assert!(told.contains(&own) && told.contains("restart the daemon"), "{told}");
    let built_in = shop.run_trued(&["run", "self-calibration", "--acknowledge", "Ada"]);
    let told = String::from_utf8_lossy(&built_in.stderr);
    assert!(built_in.status.code() == Some(1) && told.contains("the built-in machine"), "{told}");
    assert!(shop.run_states().is_empty());
    let (code, told) = run(&copy);
    assert_eq!(code, Some(0), "{told}");
    assert_eq!(shop.run_states(), ["finished"]);
}

/// Without a page there is no interface for the request: the message names the process that has the machine.
pub fn run_beside_a_daemon_without_page_names_its_process() {
    let shop = MachineShop::with_serve("[serve.line]\ntcp = \"127.0.0.1:9\"\n");
    let daemon = shop.start_daemon("fast");
    let output = shop.run_trued(&["run", "self-calibration", "--machine", &shop.machine_path()]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(told.contains(&format!("in use by process {}", daemon.child.id())), "{told}");
}
