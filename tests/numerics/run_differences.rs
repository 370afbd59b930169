//! Two runs of one simulated machine: coverage of the U of their difference.

use methods::decision::function_difference::function_differences;
use methods::decision::parameter_difference::{common_sources, parameter_differences};
use trued::setup::{self, MachineFile};

use crate::support::plan_player;
use testing::population::{is_full_test_run, population_size};

/// A machine without drift, so that the compared values do not change between the runs. Lobing is the largest source.
fn drift_free_machine(seed: u64) -> MachineFile {
    let mut text = include_str!("../../config/simulated.toml").to_owned();
    for (from, to) in [
        ("seed = 1", format!("seed = {seed}")),
        ("drift_um_per_h = 5.0", "drift_um_per_h = 0.0".to_owned()),
        ("lobing_um = 0.3", "lobing_um = 2.0".to_owned()),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, &to);
    }
    text.push_str("\n[method.self-calibration]\nmonte_carlo_trials = 100\n");
    MachineFile::parse("world.toml", text).expect("a sound machine file")
}

#[test]
fn coverage_of_differences_with_common_sources() {
    let worlds = population_size(200);
    // 4 parameters for each world; 95.45 % expected, ± 3 standard deviations of the binomial distribution.
    let shares = if is_full_test_run() { 0.93..=0.977 } else { 0.88..=1.0 };
    let (mut held, mut count, mut points_held, mut points) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..worlds {
        let file = drift_free_machine(seed);
        let (method, header) =
            setup::configure_method_and_plan_without_steps(&file, "self-calibration", None).expect("settings");
        let mut world = setup::build_world(&file).expect("a world");
        let [first, second] = [(); 2].map(|()| {
            let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header.clone());
            method.identify(&plan, &readings).expect("an estimate")
        });
        let common = common_sources(&first, &second);
        assert_eq!(common, ["stylus offset", "probe lobing", "error motions of X, Y and Z"]);
        let found = parameter_differences(&first, &second, &common);
        let independent = parameter_differences(&first, &second, &[]);
        for (one, wide) in found.iter().zip(&independent).take(4) {
            assert!(one.expanded < wide.expanded, "{}", one.symbol);
            held += f64::from(u8::from(!one.significant));
            count += 1.0;
        }
        for function in function_differences(&first, &second, 2.0) {
            points_held += function.agreeing_point_count() as f64;
            points += function.x.len() as f64;
        }
    }
    let (share, of_points) = (held / count, points_held / points);
    println!("{share:.4} of the parameters and {of_points:.4} of the points agree, {worlds} worlds");
    assert!(shares.contains(&share), "{share}");
    // The u of the points are treated as independent, although they are not: U is too large.
    assert!(of_points >= *shares.start(), "{of_points}");
}
