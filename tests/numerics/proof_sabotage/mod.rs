//! Rendered programs of real plans: all are proven unchanged; each modified one is refused, and the refusal names
//! the line.

mod ball_sabotages;
mod program_sabotages;
mod rendered_plan;

use machine::record::artefact::Artefact;
use machine::{Axis, Position};
use planning::proof::ProofRefusal;
use rendered_plan::{GRBLHAL_MACHINE_TOML, LINUXCNC_MACHINE_TOML, RenderedPlan, SIMULATED_MACHINE_TOML};

/// Seed of the first program and modification; it selects the modified step.
const BASE_SEED: u64 = 20_250_314;

fn toml_with_replacement(file: &str, from: &str, to: &str) -> String {
    assert!(file.contains(from), "{from}");
    file.replacen(from, to, 1)
}

fn toml_with_self_calibration_settings(file: &str, settings: &str) -> String {
    if file.contains("[method.self-calibration]\n") && !file.contains("# [method.self-calibration]") {
        let head = "[method.self-calibration]\n";
        return toml_with_replacement(file, head, &format!("{head}{settings}\n"));
    }
    format!("{file}\n[method.self-calibration]\n{settings}\n")
}

/// Name, machine file, dialect.
fn machines_and_dialects() -> Vec<(&'static str, String, &'static str)> {
    let table_side = toml_with_replacement(SIMULATED_MACHINE_TOML, "V[w-C-B-b-Y-X-Z-(C)-t]", "w-C-B-X-F-Y-Z-S-t");
    let sure = toml_with_replacement(SIMULATED_MACHINE_TOML, "uncertainty_mm = 2.0", "uncertainty_mm = 0.2");
    let post = "[[keepout]]\nname = \"post\"\nmin_mm = [180, 150, -50]\nmax_mm = [250, 250, 400]\n";
    let fenced = format!("{SIMULATED_MACHINE_TOML}\n{post}");
    let clamp = "[[solid]]\nname = \"clamp\"\non = \"table\"\nfrom_mm = [70, -10, 0]\nto_mm = [110, 10, 130]\n";
    let clamped = format!("{SIMULATED_MACHINE_TOML}\n{clamp}");
    let mirrored = toml_with_replacement(
        SIMULATED_MACHINE_TOML,
        "[axes.C]\npositive = \"iso\"",
        "[axes.C]\npositive = \"reversed\"",
    );
    vec![
        ("simulated, grbl", SIMULATED_MACHINE_TOML.to_owned(), "grbl"),
        ("simulated, linuxcnc", SIMULATED_MACHINE_TOML.to_owned(), "linuxcnc"),
        ("follow", toml_with_self_calibration_settings(SIMULATED_MACHINE_TOML, "spindle = \"follow\""), "linuxcnc"),
        (
            "heights",
            toml_with_self_calibration_settings(SIMULATED_MACHINE_TOML, "positions = 12\nheights_mm = [20, 80]"),
            "grbl",
        ),
        ("not located", toml_with_self_calibration_settings(&sure, "locate = false"), "linuxcnc"),
        (
            "far off",
            toml_with_self_calibration_settings(SIMULATED_MACHINE_TOML, "standoff_mm = 1.5\nsearch_mm = 3.0"),
            "grbl",
        ),
        (
            "close by",
            toml_with_self_calibration_settings(SIMULATED_MACHINE_TOML, "standoff_mm = 0.2\nsearch_mm = 0.4"),
            "grbl",
        ),
        ("linuxcnc", LINUXCNC_MACHINE_TOML.to_owned(), "linuxcnc"),
        ("linuxcnc in grbl", LINUXCNC_MACHINE_TOML.to_owned(), "grbl"),
        ("grblhal", GRBLHAL_MACHINE_TOML.to_owned(), "grbl"),
        ("grblhal in linuxcnc", GRBLHAL_MACHINE_TOML.to_owned(), "linuxcnc"),
        ("X on the table's side", table_side, "grbl"),
        ("a post", fenced, "grbl"),
        ("a clamp higher than the part", clamped, "linuxcnc"),
        ("C reversed", mirrored, "grbl"),
    ]
}

/// The programs of [`machines_and_dialects`], and two that measure balls.
fn render_all_plans() -> Vec<(String, RenderedPlan)> {
    let round = machines_and_dialects()
        .into_iter()
        .map(|(name, file, dialect)| (name.to_owned(), RenderedPlan::new(&file, "self-calibration", dialect)));
    let balls =
        ["linuxcnc", "grbl-m19"].map(|dialect| (format!("balls, {dialect}"), ball_sabotages::render_dome(dialect)));
    round.chain(balls).collect()
}

/// A position high above the middle, with all axes at zero.
fn parking_position(rendered: &RenderedPlan) -> Position {
    let axes = rendered.plan.machine.axes.iter();
    axes.map(|(axis, spec)| (*axis, if *axis == Axis::Z { spec.max } else { 0.0 })).collect()
}

#[test]
fn no_program_as_rendered_is_refused() {
    let samba = RenderedPlan::new(ball_sabotages::SAMBA_MACHINE_TOML, "samba", "grbl-m19");
    for (name, rendered) in render_all_plans().into_iter().chain([("samba".to_owned(), samba)]) {
        for stands in [None, Some(parking_position(&rendered))] {
            let proof = rendered
                .prove(&rendered.program_lines, stands.as_ref())
                .unwrap_or_else(|refusal| panic!("{name}: {refusal}"));
            assert_eq!(proof.steps.len(), rendered.plan.steps.len(), "{name}");
            let nearest = proof.nearest.expect("bodies were looked at");
            assert!(nearest.clearance_mm > 0.1, "{name}: {nearest:?}");
            // The proof lists what it did not check: the first path, if the start is unknown.
            let blind = proof.unchecked_items.iter().any(|text| text.contains("the path of lines"));
            assert_eq!(blind, stands.is_none(), "{name}: {:?}", proof.unchecked_items);
            assert_eq!(proof.unchecked_items.len(), usize::from(blind), "{name}");
        }
    }
}

/// splitmix64.
fn draw_number(seed: u64) -> u64 {
    let mut z = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Modifies `rendered` at a random step to which the modification applies. Returns the step, and what is wrong: the
/// text is empty if the program is refused with one of the expected lines.
fn sabotage_random_step(rendered: &RenderedPlan, act: program_sabotages::Sabotage, seed: u64) -> Option<(u32, String)> {
    let steps = rendered.plan.steps.len() as u64 - 2;
    (0..20).find_map(|attempt| {
        let id = (draw_number(seed + 1000 * attempt) % steps) as u32;
        let mut lines = rendered.program_lines.clone();
        let (low, high) = act(rendered, &mut lines, id)?;
        // For example, a touch from above has no Y to swap with X.
        if lines == rendered.program_lines {
            return None;
        }
        let wrong = match rendered.prove(&lines, None) {
            Ok(_) => "it is proven".to_owned(),
            Err(ProofRefusal { line, .. }) if (low + 1..=high + 1).contains(&line) => String::new(),
            Err(refusal) => {
                format!("named instead of lines {}..={}: {refusal}", low + 1, high + 1)
            }
        };
        Some((id, wrong))
    })
}

#[test]
fn every_sabotage_is_refused_and_its_line_named() {
    let mut count = 0;
    let mut unseen = Vec::new();
    for (number, (name, rendered)) in render_all_plans().into_iter().enumerate() {
        let of_balls = matches!(rendered.plan.artefact, Artefact::Balls(_));
        let more: &[_] = if of_balls { &ball_sabotages::BALL_SABOTAGES } else { &[] };
        let all = program_sabotages::SABOTAGES.iter().chain(&program_sabotages::EXTRA_SABOTAGES).chain(more);
        for (kind, (what, act)) in all.enumerate() {
            // Each kind in every third program; those of balls in both.
            if !of_balls && (number + kind) % 3 != 0 {
                continue;
            }
            let seed = BASE_SEED + 100 * number as u64 + kind as u64;
            let Some((step, wrong)) = sabotage_random_step(&rendered, *act, seed) else { continue };
            count += 1;
            if !wrong.is_empty() {
                unseen.push(format!("{name}, step {step}, {what}: {wrong}"));
            }
        }
    }
    println!("{count} sabotages");
    assert!(unseen.is_empty(), "{} of {count}:\n{}", unseen.len(), unseen.join("\n"));
    assert!(count >= 60, "{count}");
}
