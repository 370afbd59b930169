//! A probe is qualified, and later runs with it subtract its map.

use super::{MachineShop, assert_stderr_has, successful_json_output, toml_with_text_replacements};

/// Settings for few touches. Two azimuths fewer would not be enough for the orders of the map.
const FEW_TOUCHES_SETTINGS: &str = "azimuths = 14\nrepeats = 2\nspindle_deg = [0.0]";

pub fn later_run_requires_and_subtracts_the_map_of_its_own_probe() {
    let ball = toml_with_text_replacements(
        include_str!("../../../config/probe-qualification.toml"),
        &[("azimuths = 24\nrepeats = 3", FEW_TOUCHES_SETTINGS)],
    );
    let part = toml_with_text_replacements(
        include_str!("../../../config/simulated.toml"),
        &[
            (
                "name = \"simulated five-axis machine\"",
                "name = \"simulated machine with a precision sphere on its table\"",
            ),
            ("[probe]", "[probe]\nstylus = \"50 mm, ball 6 mm\"\nqualified_within_days = 30.0"),
        ],
    );
    let part = format!("{part}\n[method.self-calibration]\nmonte_carlo_trials = 1000\n");
    let shop = MachineShop::with_machine_file(&ball);
    let own = shop.path("part.toml");
    std::fs::write(&own, &part).unwrap();
    let run = || shop.run_trued(&["run", "self-calibration", "--json", "--machine", own.to_str().unwrap()]);

    let refused = run();
    assert_eq!(refused.status.code(), Some(1));
    assert_stderr_has(
        &refused,
        &["qualified_within_days requires a qualification", "run probe-qualification` with a precision sphere"],
    );

    successful_json_output(&shop.run_trued(&[
        "run",
        "probe-qualification",
        "--json",
        "--machine",
        &shop.machine_path(),
    ]));
    let later = successful_json_output(&run());
    let gauge = later["gauge"].to_string();
    assert!(gauge.contains("is subtracted: orders 3, 4, 5, 6; order 2 is included"), "{gauge}");
    assert_eq!(later["priors"].as_array().unwrap().len(), 1);

    std::fs::write(&own, part.replace("50 mm, ball 6 mm", "a new one")).unwrap();
    let refused = run();
    assert_eq!(refused.status.code(), Some(1));
    assert_stderr_has(&refused, &["the qualification was made with a probe, stylus or machine that differs"]);
}
