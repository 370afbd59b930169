//! The contract of `plan --json` and `identify`: an independent program plays the machine from the plan's JSON
//! alone, with its own geometry (intersection of a line and a circle), and feeds the readings back.

use crate::support::harness::{Pool, Trials, trials};
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// True position of the C axis, mm.
const TRUE_AXIS_MM: [f64; 2] = [0.040, -0.025];
const FEW_TRIALS_SETTINGS: &str = "\n[method.self-calibration]\nmonte_carlo_trials = 1000\n";
/// Centre of the part at C = 0, mm.
const PART_CENTRE_MM: [f64; 2] = [0.25, 0.15];

fn run_trued(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trued")).args(arguments).output().expect("the program starts")
}

fn json_number(value: &Value, path: &[&str]) -> f64 {
    let found = path.iter().fold(value, |v, key| &v[*key]);
    found.as_f64().unwrap_or_else(|| panic!("no number at {path:?}"))
}

/// Axis positions X, Y, Z at the contact of one touch, mm, with the part turned about the true axis: the ball
/// touches its flank, or its top face.
fn axis_positions_at_true_contact(plan: &Value, step: &Value) -> [f64; 3] {
    let height = json_number(step, &["from", "Z"]);
    if json_number(&step["normal"][2], &[]) > 0.5 {
        let [top, ball] = [["artefact", "height_mm"], ["probe", "ball_radius_mm"]].map(|path| json_number(plan, &path));
        let z = top + ball - plan["machine"]["tool_mm"][2].as_f64().unwrap();
        assert!(json_number(step, &["to", "Z"]) < z && z < height, "step {} misses", step["id"]);
        return [json_number(step, &["from", "X"]), json_number(step, &["from", "Y"]), z];
    }
    let tool: Vec<f64> = (0..3).map(|i| plan["machine"]["tool_mm"][i].as_f64().unwrap()).collect();
    let sense = match plan["machine"]["axes"]["C"]["positive"].as_str().unwrap() {
        "iso" => 1.0,
        _ => -1.0,
    };
    let c = sense * json_number(step, &["from", "C"]).to_radians();
    // C positive turns the part clockwise seen from +Z (ISO 841, workpiece side).
    let (dx, dy) = (PART_CENTRE_MM[0] - TRUE_AXIS_MM[0], PART_CENTRE_MM[1] - TRUE_AXIS_MM[1]);
    let centre = [TRUE_AXIS_MM[0] + c.cos() * dx + c.sin() * dy, TRUE_AXIS_MM[1] - c.sin() * dx + c.cos() * dy];
    let reach = json_number(plan, &["artefact", "radius_mm"]) + json_number(plan, &["probe", "ball_radius_mm"]);
    let start: Vec<f64> = ["X", "Y"].iter().zip(&tool).map(|(a, t)| json_number(step, &["from", a]) + t).collect();
    let end: Vec<f64> = ["X", "Y"].iter().zip(&tool).map(|(a, t)| json_number(step, &["to", a]) + t).collect();
    let way = [end[0] - start[0], end[1] - start[1]];
    let off = [start[0] - centre[0], start[1] - centre[1]];
    let a = way[0] * way[0] + way[1] * way[1];
    let b = way[0] * off[0] + way[1] * off[1];
    let s = (-b - (b * b - a * (off[0] * off[0] + off[1] * off[1] - reach * reach)).sqrt()) / a;
    assert!((0.0..=1.0).contains(&s), "step {} misses the part", step["id"]);
    [start[0] + s * way[0] - tool[0], start[1] + s * way[1] - tool[1], height]
}

/// Readings with columns in a different order, including rotary axes and times.
fn played_readings_csv(plan: &Value) -> String {
    let mut csv = "# trued-readings 1\n# played by another program\n".to_owned();
    csv.push_str("t_s,c_deg,step,repeat,y_mm,x_mm,z_mm,b_deg,temp_room_c\n");
    let steps = plan["steps"].as_array().unwrap().iter();
    // A prompt moves nothing.
    let moves = steps.filter(|step| step["kind"] != "prompt");
    for (i, step) in moves.enumerate() {
        let [x, y, z] = axis_positions_at_true_contact(plan, step);
        let (b, c) = (json_number(step, &["from", "B"]), json_number(step, &["from", "C"]));
        let id = step["id"].as_u64().unwrap();
        writeln!(csv, "{},{c},{id},0,{y},{x},{z},{b},20.5", 5 * i).unwrap();
    }
    csv
}

fn write_file(folder: &Path, name: &str, text: &str) -> String {
    let file = folder.join(name);
    std::fs::write(&file, text).unwrap();
    file.display().to_string()
}

fn readings_of_another_program_are_identified() {
    let folder = tempfile::tempdir().unwrap();
    let printed = run_trued(&["plan", "self-calibration", "--json"]);
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    let plan: Value = serde_json::from_slice(&printed.stdout).unwrap();
    assert_eq!(plan["trued_plan"], 1);

    let plan_file = write_file(folder.path(), "plan.json", &String::from_utf8_lossy(&printed.stdout));
    let csv_file = write_file(folder.path(), "readings.csv", &played_readings_csv(&plan));
    let identified =
        run_trued(&["identify", "self-calibration", "--plan", &plan_file, "--readings", &csv_file, "--json"]);
    assert!(identified.status.success(), "{}", String::from_utf8_lossy(&identified.stderr));
    let estimate: Value = serde_json::from_slice(&identified.stdout).unwrap();
    for (symbol, truth) in [("EX0C", TRUE_AXIS_MM[0]), ("EY0C", TRUE_AXIS_MM[1])] {
        let parameters = estimate["parameters"].as_array().unwrap();
        let found = parameters.iter().find(|p| p["symbol"] == symbol).unwrap();
        assert_eq!(found["unit"], "um");
        let off = json_number(found, &["value"]) - truth * 1e3;
        // Exact geometry; the remaining error is of third order in the offsets.
        assert!(off.abs() < 0.2, "{symbol} is off by {off} um");
    }
}

/// A plan of the built-in machine with few Monte Carlo trials.
fn plan_with_few_trials(folder: &Path) -> Output {
    let text = include_str!("../../config/simulated.toml").to_owned() + FEW_TRIALS_SETTINGS;
    let machine = write_file(folder, "quick.toml", &text);
    run_trued(&["plan", "self-calibration", "--machine", &machine, "--json"])
}

fn identify(folder: &Path, plan_file: &str, csv: &str) -> (Output, Value) {
    let csv_file = write_file(folder, "other.csv", csv);
    let output = run_trued(&["identify", "self-calibration", "--plan", plan_file, "--readings", &csv_file, "--json"]);
    let estimate = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output, estimate)
}

fn u_of_axis(estimate: &Value) -> f64 {
    json_number(&estimate["parameters"][0], &["u"])
}

/// Readings without times must not give a smaller U. A full turn added to C changes nothing. Readings that are all
/// excluded, that lack one time, and a plan without normals are refused.
fn unusual_readings_are_identified_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let printed = plan_with_few_trials(folder.path());
    let plan: Value = serde_json::from_slice(&printed.stdout).unwrap();
    let plan_file = write_file(folder.path(), "plan.json", &String::from_utf8_lossy(&printed.stdout));
    let good = played_readings_csv(&plan);
    let (_, timed) = identify(folder.path(), &plan_file, &good);

    let rows = good.lines().enumerate().map(|(i, line)| match line.split_once(',') {
        Some((_, rest)) if i >= 2 => format!("{rest}\n"),
        _ => format!("{line}\n"),
    });
    let (_, untimed) = identify(folder.path(), &plan_file, &rows.collect::<String>());
    assert!(u_of_axis(&untimed) >= 0.99 * u_of_axis(&timed), "{} {}", u_of_axis(&untimed), u_of_axis(&timed));
    assert!(untimed["warnings"].to_string().contains("no times"));

    let turned: String = good
        .lines()
        .map(|line| match line.split(',').collect::<Vec<_>>()[..] {
            [t, "45", ref rest @ ..] => format!("{t},405,{}\n", rest.join(",")),
            _ => format!("{line}\n"),
        })
        .collect();
    assert_ne!(turned, good);
    let (_, turned) = identify(folder.path(), &plan_file, &turned);
    assert!((u_of_axis(&turned) - u_of_axis(&timed)).abs() < 1e-9);

    let flagged = good.replace("temp_room_c", "flag").replace(",20.5", ",excluded");
    let (output, _) = identify(folder.path(), &plan_file, &flagged);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("all readings are flagged"));

    let (output, _) = identify(folder.path(), &plan_file, &good.replacen("\n25,", "\n,", 1));
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("t_s"));

    let crooked = String::from_utf8_lossy(&printed.stdout).replacen(
        "\"normal\": [\n        1.0",
        "\"normal\": [\n        0.0",
        9,
    );
    let crooked_file = write_file(folder.path(), "crooked.json", &crooked);
    let (output, _) = identify(folder.path(), &crooked_file, &good);
    assert_eq!(output.status.code(), Some(1), "a plan without normals");
}

/// Each bad file, with a part of the message that names the error. No error is silently accepted.
fn bad_readings_are_refused_with_the_error_named() {
    let folder = tempfile::tempdir().unwrap();
    let printed = plan_with_few_trials(folder.path());
    let plan: Value = serde_json::from_slice(&printed.stdout).unwrap();
    let plan_file = write_file(folder.path(), "plan.json", &String::from_utf8_lossy(&printed.stdout));
    let good = played_readings_csv(&plan);
    let line = |n: usize| good.lines().nth(n).unwrap().to_owned();
    let cases = [
        ("a missing step", good.replace(&format!("{}\n", line(20)), ""), "step 17 ("),
        ("a duplicate", format!("{good}{}\n", line(20)), "occurs already in line 21"),
        ("NaN", good.replacen(",20.5", ",NaN", 1), "line 4"),
        ("a truncated line", good[..good.len() - 30].to_owned(), "line"),
        ("an unknown column", good.replacen("x_mm", "x_mmm", 1), "x_mm"),
    ];
    for (what, csv, named) in cases {
        let csv_file = write_file(folder.path(), "bad.csv", &csv);
        let refused = run_trued(&["identify", "self-calibration", "--plan", &plan_file, "--readings", &csv_file]);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{what}: {said}");
        assert!(said.contains(named), "{what}: {said}");
    }
}

/// With prompts the plan is the same, with numbers that continue after them; the identification is the same to the
/// last digit.
fn prompts_shift_step_ids_and_keep_the_estimate() {
    let folder = tempfile::tempdir().unwrap();
    let prompts = "\n[[prompt]]\ntext = \"part and stylus are clean (100 %)\"\n\
                   [[prompt]]\ntext = \"its cap is off\"\nmethods = [\"laser-r-test\", \"self-calibration\"]\n";
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    for (config, method, count) in [
        ("simulated", "self-calibration", 2),
        ("simulated", "latch-delay", 1),
        ("samba", "samba", 1),
        ("laser", "laser-r-test", 2),
    ] {
        let quick = if method == "self-calibration" { FEW_TRIALS_SETTINGS } else { "" };
        let text = std::fs::read_to_string(configs.join(format!("{config}.toml"))).unwrap() + quick;
        for beside in std::fs::read_dir(&configs).unwrap().map(|file| file.unwrap().path()) {
            std::fs::copy(&beside, folder.path().join(beside.file_name().unwrap())).unwrap();
        }
        let plain = write_file(folder.path(), &format!("{config}.toml"), &text);
        let asking = write_file(folder.path(), &format!("{config}-asking.toml"), &(text + prompts));
        let plan = |machine: &str| {
            let printed = run_trued(&["plan", method, "--machine", machine, "--json"]);
            assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
            serde_json::from_slice::<Value>(&printed.stdout).unwrap()
        };
        let (mut without, with) = (plan(&plain), plan(&asking));
        let steps = with["steps"].as_array().unwrap();
        for (id, prompt) in steps[..count].iter().enumerate() {
            assert_eq!((&prompt["id"], &prompt["kind"]), (&id.into(), &"prompt".into()));
            assert_eq!((&prompt["from"], &prompt["stage"]), (&prompt["to"], &0.into()));
            assert!(prompt["text"].is_string());
        }
        for step in without["steps"].as_array_mut().unwrap() {
            step["id"] = (step["id"].as_u64().unwrap() + count as u64).into();
        }
        assert!(without["steps"].as_array().unwrap()[..] == steps[count..], "{method}");

        let program = run_trued(&["plan", method, "--machine", &asking, "--gcode", "linuxcnc"]);
        let told = String::from_utf8_lossy(&program.stderr);
        assert!(program.status.success() && told.contains("collision check passed:"), "{told}");
        let program = String::from_utf8(program.stdout).unwrap();
        assert!(program.contains("(MSG,part and stylus are clean  100   )\nN0 M0\n"), "{program}");
        assert_eq!(program.matches(" M0\n").count(), count);
        if method != "self-calibration" {
            continue;
        }
        let identified = |machine: &str, plan: &Value, more: &[&str]| {
            let csv = write_file(folder.path(), "readings.csv", &played_readings_csv(plan));
            let file = write_file(folder.path(), "plan.json", &plan.to_string());
            let files = ["--plan", &file, "--readings", &csv, "--json", "--machine", machine];
            let files = if more.is_empty() { &files[..] } else { &files[2..] };
            let found = run_trued(&[&["identify", method], files].concat());
            assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
            let mut found: Value = serde_json::from_slice(&found.stdout).unwrap();
            // The plans differ, and so does the provenance.
            found.as_object_mut().unwrap().remove("provenance").unwrap();
            found
        };
        let original = identified(&plain, &plan(&plain), &[]);
        assert_eq!(original, identified(&plain, &with, &[]), "by the plan alone");
        assert_eq!(original, identified(&asking, &with, &["its machine file"]));
    }
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 25;
        readings_of_another_program_are_identified,
        unusual_readings_are_identified_or_refused,
        bad_readings_are_refused_with_the_error_named,
        prompts_shift_step_ids_and_keep_the_estimate,
    ]
}
