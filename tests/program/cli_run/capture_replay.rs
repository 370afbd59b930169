//! A captured run, and its replay without the machine.

use serde_json::Value;

use super::{
    MachineShop, estimate_without_provenance, simulated_machine_toml, stderr, successful_json_output,
    toml_with_text_replacements,
};

/// Runs `trued run` with these arguments; its standard output is JSON.
fn run_with_arguments(shop: &MachineShop, more: &[&str]) -> std::process::Output {
    let file = shop.path_text("machine.toml");
    let arguments = ["run", "self-calibration", "--json", "--machine", &file];
    shop.trued_command(&[&arguments[..], more].concat()).output().unwrap()
}

pub fn captured_run_replays_to_the_same_result() {
    for wire in ["wire = \"memory\"", "wire = \"pty\""] {
        let shop = MachineShop::with_machine_file(&toml_with_text_replacements(
            &simulated_machine_toml(),
            &[("wire = \"memory\"", wire)],
        ));
        let capture = shop.path_text("a.capture");
        let measured = run_with_arguments(&shop, &["--capture", &capture]);
        assert_eq!(measured.status.code(), Some(0), "{}", stderr(&measured));
        // The machine file now describes another machine: the result must be that of the capture.
        let text = std::fs::read_to_string(shop.path_text("machine.toml")).unwrap();
        let other = text.replace("seed = 1", "seed = 2");
        assert_ne!(text, other);
        std::fs::write(shop.path_text("machine.toml"), other).unwrap();
        let unlike = run_with_arguments(&shop, &[]);
        assert!(
            estimate_without_provenance(&unlike) != estimate_without_provenance(&measured),
            "the test could not fail"
        );
        let replayed = run_with_arguments(&shop, &["--replay", &capture]);
        assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
        let same = estimate_without_provenance(&replayed) == estimate_without_provenance(&measured);
        assert!(same, "{wire}: a replay gives something else");
        assert!(successful_json_output(&replayed)["parameters"].is_array());
        // The journal holds the two measured runs.
        let runs = shop.trued_command(&["runs", "--json"]).output().unwrap();
        let runs: serde_json::Value = serde_json::from_slice(&runs.stdout).unwrap();
        assert_eq!(runs.as_array().map(Vec::len), Some(2), "{runs}");
    }
}

pub fn changed_or_damaged_capture_is_refused_with_reason() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let capture = shop.path_text("a.capture");
    let measured = run_with_arguments(&shop, &["--capture", &capture]);
    assert_eq!(measured.status.code(), Some(0), "{}", stderr(&measured));
    let again = run_with_arguments(&shop, &["--capture", &capture]);
    assert!(stderr(&again).contains("a capture is never overwritten"), "{}", stderr(&again));

    let text = std::fs::read_to_string(&capture).unwrap();
    let refused = |spoilt: &str, words: &[&str]| {
        std::fs::write(shop.path_text("b.capture"), spoilt).unwrap();
        let replayed = run_with_arguments(&shop, &["--replay", &shop.path_text("b.capture")]);
        assert_eq!(replayed.status.code(), Some(1), "{}", stderr(&replayed));
        for word in words {
            assert!(stderr(&replayed).contains(word), "{word}: {}", stderr(&replayed));
        }
    };
    // Change the target of the fortieth touch.
    let (at, line) = text
        .match_indices('\n')
        .filter_map(|(at, _)| {
            let line = text[at + 1..].lines().next()?;
            line.contains(" G38.").then_some((at + 1, line))
        })
        .nth(40)
        .unwrap();
    let command = line.split_once("> ").unwrap().1.trim_end_matches("\\n");
    let elsewhere = [&text[..at], &line.replacen("G38", "G39", 1), &text[at + line.len()..]].concat();
    refused(&elsewhere, &["the replay ended", "the capture has no", command, "G39"]);
    refused(&text[..at], &["the replay ended", "the capture has no", command, "nothing"]);
    refused(&text[..text.len() / 2], &["b.capture, line", "the last line has no line end"]);
    refused(&text.replacen(" 1 < ok", " 1 < \\ok", 1), &["b.capture, line", "unknown escape"]);
    let none = run_with_arguments(&shop, &["--replay", &shop.path_text("none")]);
    assert!(stderr(&none).contains("No such file"), "{}", stderr(&none));
}

/// `tests/data/linuxcnc/`: a short self-calibration of the real LinuxCNC 2.9 on the rig of `tests/peers/linuxcnc`,
/// its estimate as printed then, and the machine file. The true axis was at 50 and -30 µm.
pub fn stored_capture_of_linuxcnc_replays_to_its_estimate() {
    let data = |name: &str| {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/linuxcnc/");
        std::fs::read_to_string(format!("{folder}{name}")).unwrap()
    };
    let shop = MachineShop::with_machine_file(&data("machine.toml"));
    let replay = |talk: &str| {
        let capture = shop.path_text("a.capture");
        std::fs::write(&capture, talk).unwrap();
        run_with_arguments(&shop, &["--replay", &capture])
    };
    let talk = data("self-calibration.capture");
    let replayed = replay(&talk);
    assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
    let parameters = |estimate: &Value| -> Vec<(String, f64)> {
        let all = estimate["parameters"].as_array().unwrap().iter();
        let one = |one: &Value| (one["symbol"].as_str().unwrap().to_owned(), one["value"].as_f64().unwrap());
        all.map(one).collect()
    };
    let (then, now) = (serde_json::from_str(&data("estimate.json")).unwrap(), successful_json_output(&replayed));
    let (then, now) = (parameters(&then), parameters(&now));
    assert_eq!(then.len(), now.len());
    for ((symbol, then), (same, now)) in then.iter().zip(&now) {
        assert_eq!(symbol, same);
        // The touches have the times of the capture instead of the computer's: the drift correction differs, by
        // milliseconds of time.
        assert!((then - now).abs() < 1e-4, "{symbol}: {then}, now {now}");
    }
    assert_eq!((&*then[0].0, &*then[1].0), ("EX0C", "EY0C"));
    assert!((then[0].1 - 50.0).abs() < 1.0 && (then[1].1 + 30.0).abs() < 1.0, "{then:?}");

    // A changed program or answer is detected.
    let refused = |from: &str, to: &str, words: &str| {
        let spoilt = talk.replacen(from, to, 1);
        assert_ne!(spoilt, talk, "{from}");
        let ended = replay(&spoilt);
        assert_eq!(ended.status.code(), Some(1), "{}", stderr(&ended));
        assert!(stderr(&ended).contains(words), "{words}: {}", stderr(&ended));
    };
    refused("(step 3 repeat 0)", "(step 3 repeat 1)", "captured text: `(step 3 repeat 1)`");
    refused("set run", "set walk", "its next command is `set walk`");
    refused("PROBE_VALUE 0", "PROBE_VALUE 1", "step");
    refused("ntouch 3 4 1.000000", "ntouch 3 4 0.000000", "step");
}
