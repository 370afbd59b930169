//! The proof before each motion, and its messages to the user.

use serde_json::Value;

use super::{
    MachineShop, assert_stderr_has, simulated_machine_toml, stderr, successful_json_output, toml_with_text_replacements,
};

/// A clamp on the table, in the path of the first approach and lower than the part.
const CLAMP_SECTION: &str = "\n[[solid]]\nname = \"clamp\"\non = \"table\"\n\
                     from_mm = [46, -10, 0]\nto_mm = [70, 10, 80]\n";

pub fn plan_states_the_least_clearance_and_program_is_complete() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let file = shop.path_text("machine.toml");
    let plan = ["plan", "self-calibration", "--machine", &file];
    let program = shop.run_trued(&[&plan[..], &["--gcode", "grbl"]].concat());
    assert_eq!(program.status.code(), Some(0), "{}", stderr(&program));
    // The ball's radius minus the stem's, minus the overtravel of the ball after contact.
    let proven = "motions; smallest clearance 1.35 mm between stylus stem and artefact, line 52, step 1 \
        (locate/P000)";
    assert!(stderr(&program).contains(proven), "{}", stderr(&program));
    assert!(stderr(&program).contains("not checked: the path of lines 7 to 10"));
    let text = String::from_utf8(program.stdout).unwrap();
    assert!(text.starts_with('(') && !text.contains("proven"));
    let touch = text.lines().nth(51).unwrap();
    assert!(touch.starts_with("N1 G38.3 X"), "{touch}");
    let words = shop.run_trued(&plan);
    assert!(String::from_utf8_lossy(&words.stdout).contains(proven));
}

pub fn colliding_program_is_refused_with_step_line_and_bodies() {
    let shop = MachineShop::with_machine_file(&(simulated_machine_toml() + CLAMP_SECTION));
    let file = shop.path_text("machine.toml");
    let plan = shop.run_trued(&["plan", "self-calibration", "--machine", &file, "--gcode", "grbl"]);
    assert_eq!(plan.status.code(), Some(1));
    assert!(plan.stdout.is_empty());
    let why = "step 1 (locate/P000), line 51: stylus ball would come within 0.000 mm of clamp";
    assert!(stderr(&plan).contains(why), "{}", stderr(&plan));
    let run = shop.run_self_calibration();
    assert_eq!(run.status.code(), Some(1), "{}", stderr(&run));
    let stage = "the collision check refuses stage `locate the part`: step 1 (locate/P000), line 51: stylus \
        ball";
    assert_stderr_has(&run, &[stage, "nothing has moved", "[[solid]]"]);
    assert_eq!(shop.run_states(), ["failed"]);
    assert!(shop.exported_reading_steps().is_empty());
}

/// The machine file states neither stylus nor solids: the run is measured all the same, and the report names what
/// was not checked.
pub fn report_draws_clearances_and_lists_unchecked_bodies() {
    let bare =
        toml_with_text_replacements(&simulated_machine_toml(), &[("stem_radius_mm = 1.5", "stem_radius_mm = 0.0")]);
    let shop = MachineShop::with_machine_file(&bare);
    assert!(successful_json_output(&shop.run_self_calibration())["parameters"].is_array());
    let report = shop.path_text("report.html");
    let shown = shop.run_trued(&["show", "1", "--report", &report]);
    assert_eq!(shown.status.code(), Some(0), "{}", stderr(&shown));
    let page = std::fs::read_to_string(report).unwrap();
    let (_, proven) = page.split_once("Collision check before the motions").expect("the section");
    let (proven, _) = proven.split_once("</section>").unwrap();
    for words in ["<svg", "clearance / mm", "<li>stylus stem</li>", "touch"] {
        assert!(proven.contains(words), "{words}");
    }
    let touches = shop.exported_reading_steps().len();
    // A mark is a line of no length with round ends.
    assert_eq!(proven.matches("h0").count(), touches, "a mark for each touch");
    let events = shop.run_trued(&["show", "1", "--json"]);
    assert!(serde_json::from_slice::<Value>(&events.stdout).is_ok());
}
