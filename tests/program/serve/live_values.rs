//! A run that waits for the operator shows the values of its sensors: to programs, on the page and at a terminal.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::http::{HTTP_SECTION, MACHINE_API_PATH, start_request_body};
use crate::support::machine_shop::MachineShop;

/// Number of live values to observe: enough to show that journal and log do not grow.
const OBSERVED_VALUE_COUNT: usize = 6;

/// The built-in machine with sensors, under the name that the client uses.
fn shop_with_sensors() -> MachineShop {
    let file = include_str!("../../../config/multiprobe.toml");
    let cycle = "[serve]\nmin_interval_s = 0.0\n[[serve.cycle]]\nnumber = 1\nmethod = \"multiprobe\"\n";
    let shop = MachineShop::with_machine_file(&format!("{file}\n{cycle}{HTTP_SECTION}"));
    shop.replace_in_machine_file("simulated machine with sensors about its table", "simulated five-axis machine");
    shop
}

/// Total size of the files in the state folder, bytes.
fn folder_size_bytes(folder: &Path) -> u64 {
    let files = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().metadata().unwrap());
    files.filter(|about| about.is_file()).map(|about| about.len()).sum()
}

/// Programs and the page get new values continuously; journal and log do not.
pub fn live_values_are_sent_over_http_and_not_stored() {
    let shop = shop_with_sensors();
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    let asked = http.wait_until_machine_state(|machine| machine["asked"]["live"].is_object());
    let (live, log) = (&asked["asked"]["live"], daemon.log());
    let names: Vec<&Value> = live["sensors"].as_array().unwrap().iter().map(|one| &one["sensor"]).collect();
    assert_eq!(names, ["x1", "y1", "r1", "x2", "y2", "r2", "z1"]);
    for sensor in live["sensors"].as_array().unwrap() {
        assert_eq!((&sensor["target_mm"], &sensor["failure"]), (&json!(0.0), &Value::Null));
        assert!(sensor["value_mm"].as_f64().unwrap().abs() < 0.3, "{sensor}");
    }
    let page = http.get_text(&MACHINE_API_PATH[7..]);
    assert!(page.contains("<th scope=\"row\">r2</th>") && page.contains("% of -0.3 to 0.3 mm"), "{page}");
    let part = http.get_text(&format!("{}/sensors", &MACHINE_API_PATH[7..]));
    assert!(part.contains("<th scope=\"row\">z1</th>") && !part.contains("<html"), "{part}");

    let bytes = folder_size_bytes(&shop.state_folder());
    let (mut stream, at) = (http.connect(), http.port);
    write!(stream, "GET {MACHINE_API_PATH}/events HTTP/1.1\r\nHost: localhost:{at}\r\n\r\n").unwrap();
    let lines = BufReader::new(stream).lines().map(Result::unwrap);
    let data = lines.filter_map(|line| line.strip_prefix("data: ").map(str::to_owned));
    let values = data.map(|data| {
        let standing: Value = serde_json::from_str(&data).unwrap();
        standing["asked"]["live"]["sensors"][0]["value_mm"].as_f64().unwrap()
    });
    let mut values: Vec<f64> = values.take(OBSERVED_VALUE_COUNT).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    assert!(values.len() > OBSERVED_VALUE_COUNT / 2, "{values:?}");
    assert_eq!((folder_size_bytes(&shop.state_folder()), daemon.log()), (bytes, log));
    assert_eq!(http.post_action("hold", &json!({})).0, 202);
    let held = http.wait_for_state("held");
    assert_eq!(held["asked"], Value::Null);
}

/// The run is started without a daemon, and while a daemon has the machine.
pub fn live_values_are_shown_at_a_terminal() {
    let shop = shop_with_sensors();
    interrupt_run_after_live_values(&shop);
    assert_eq!(shop.run_states(), ["held"]);
    let shop = self::shop_with_sensors();
    let daemon = shop.start_daemon("fast");
    interrupt_run_after_live_values(&shop);
    daemon.http().wait_for_state("held");
}

/// Ctrl-C holds the run after values have been shown several times.
fn interrupt_run_after_live_values(shop: &MachineShop) {
    let machine = shop.machine_path();
    let command = shop.trued_command(&["run", "multiprobe", "--machine", &machine, "--acknowledge", "Ada"]);
    let words = [command.get_program()].into_iter().chain(command.get_args());
    let words: Vec<String> = words.map(|word| format!("'{}'", word.to_string_lossy())).collect();
    let mut script = Command::new("script");
    // Without `exec`, dash, which Ctrl-C interrupts too, returns 130.
    let words = format!("exec {}", words.join(" "));
    script.args(["--quiet", "--return", "--command", &words, "/dev/null"]);
    script.env("SHELL", "/bin/sh").env("TERM", "xterm");
    let mut child = script.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut keys = child.stdin.take().unwrap();
    let mut shown = child.stdout.take().unwrap();
    let (mut seen, mut is_stopped, started) = (String::new(), false, Instant::now());
    let mut some = [0; 4096];
    while let Ok(count @ 1..) = shown.read(&mut some) {
        seen.push_str(&String::from_utf8_lossy(&some[..count]));
        if !is_stopped && seen.matches("  r2 ").count() > OBSERVED_VALUE_COUNT {
            is_stopped = true;
            keys.write_all(b"\x03").unwrap();
        }
        assert!(started.elapsed() < Duration::from_secs(120), "{seen}");
    }
    assert_eq!(child.wait().unwrap().code(), Some(5), "{seen}");
    assert!(seen.contains("Press Enter") && seen.contains("target +0.00000"), "{seen}");
}
