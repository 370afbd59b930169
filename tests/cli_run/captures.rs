//! A run captured, and replayed without its machine.

use super::{Shop, changed, estimate, machine, said};

/// `trued run` with these, and its standard output as JSON.
fn run(shop: &Shop, more: &[&str]) -> std::process::Output {
    let file = shop.file("machine.toml");
    let arguments = ["run", "self-calibration", "--json", "--machine", &file];
    shop.command(&[&arguments[..], more].concat()).output().unwrap()
}

#[test]
fn a_captured_run_replays_to_the_same_bytes_without_the_machine() {
    for wire in ["wire = \"memory\"", "wire = \"pty\""] {
        let shop = Shop::new(&changed(&machine(), &[("wire = \"memory\"", wire)]));
        let capture = shop.file("a.capture");
        let measured = run(&shop, &["--capture", &capture]);
        assert_eq!(measured.status.code(), Some(0), "{}", said(&measured));
        // The machine is another one now: what comes out is what was captured.
        let text = std::fs::read_to_string(shop.file("machine.toml")).unwrap();
        let other = text.replace("seed = 1", "seed = 2");
        assert_ne!(text, other);
        std::fs::write(shop.file("machine.toml"), other).unwrap();
        let unlike = run(&shop, &[]);
        assert!(unlike.stdout != measured.stdout, "the test could not fail");
        let replayed = run(&shop, &["--replay", &capture]);
        assert_eq!(replayed.status.code(), Some(0), "{}", said(&replayed));
        assert!(replayed.stdout == measured.stdout, "{wire}: a replay gives something else");
        assert!(estimate(&replayed)["parameters"].is_array());
        // The journal holds the two measured runs.
        let runs = shop.command(&["runs", "--json"]).output().unwrap();
        let runs: serde_json::Value = serde_json::from_slice(&runs.stdout).unwrap();
        assert_eq!(runs.as_array().map(Vec::len), Some(2), "{runs}");
    }
}

#[test]
fn a_capture_that_does_not_fit_is_told_in_words() {
    let shop = Shop::new(&machine());
    let capture = shop.file("a.capture");
    let measured = run(&shop, &["--capture", &capture]);
    assert_eq!(measured.status.code(), Some(0), "{}", said(&measured));
    let again = run(&shop, &["--capture", &capture]);
    assert!(said(&again).contains("a capture is never overwritten"), "{}", said(&again));

    let text = std::fs::read_to_string(&capture).unwrap();
    let refused = |spoilt: &str, words: &[&str]| {
        std::fs::write(shop.file("b.capture"), spoilt).unwrap();
        let replayed = run(&shop, &["--replay", &shop.file("b.capture")]);
        assert_eq!(replayed.status.code(), Some(1), "{}", said(&replayed));
        for word in words {
            assert!(said(&replayed).contains(word), "{word}: {}", said(&replayed));
        }
    };
    // The fortieth touch goes elsewhere.
    let (at, line) = text
        .match_indices('\n')
        .filter_map(|(at, _)| {
            let line = text[at + 1..].lines().next()?;
            line.contains(" G38.").then_some((at + 1, line))
        })
        .nth(40)
        .unwrap();
    let command = line.split_once("> ").unwrap().1.trim_end_matches("\\n");
    let elsewhere =
        [&text[..at], &line.replacen("G38", "G39", 1), &text[at + line.len()..]].concat();
    refused(&elsewhere, &["the replay ended", "the capture does not know", command, "G39"]);
    refused(&text[..at], &["the replay ended", "the capture does not know", command, "nothing"]);
    refused(&text[..text.len() / 2], &["b.capture, line", "the line does not end"]);
    refused(&text.replacen(" 1 < ok", " 1 < \\ok", 1), &["b.capture, line", "unknown escape"]);
    let none = run(&shop, &["--replay", &shop.file("none")]);
    assert!(said(&none).contains("No such file"), "{}", said(&none));
}
