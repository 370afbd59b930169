//! Whether the stated uncertainty is true: worlds whose sources are declared by magnitude only.

mod support;

use trued::base::Axis;
use trued::record::estimate::Estimate;
use trued::setup::{self, MachineFile};

const WORLDS: u64 = 200;

/// The built-in machine with other keys (each replaces the value of the named key).
fn machine(changes: &[(&str, &str)]) -> MachineFile {
    let mut text = include_str!("../config/simulated.toml").to_owned();
    for (key, value) in changes {
        let before = text.clone();
        let lines = text.lines().map(|line| match line.split_once('=') {
            Some((name, _)) if name.trim() == *key => format!("{key} = {value}\n"),
            _ => format!("{line}\n"),
        });
        text = lines.collect();
        assert_ne!(text, before, "{key} changes nothing");
    }
    text.push_str("\n[method.self-calibration]\nmonte_carlo_trials = 100\n");
    MachineFile::parse("world.toml", text).expect("a sound machine file")
}

/// Estimate and truth (um, um, um/m, urad) of one world.
fn estimate(file: &MachineFile) -> (Estimate, [f64; 4]) {
    let (method, header) = setup::header(file, "self-calibration", None).expect("settings");
    let mut world = setup::world(file).expect("a world");
    let (plan, readings) = support::measure(&mut world, method.as_ref(), header);
    let estimate = method.identify(&plan, &readings, &[]).expect("an estimate");
    let cycle: Vec<f64> = readings.iter().skip(4).map(|reading| reading.t_s).collect();
    let middle = (cycle[0] + cycle[cycle.len() - 1]) / 2.0;
    let [x, y] = world.true_axis_mm(Axis::C, 50.0, middle);
    (estimate, [x * 1e3, y * 1e3, 0.0, 0.0])
}

/// χ² of the four parameters against the truth, by the stated covariance.
fn chi2(estimate: &Estimate, truth: [f64; 4]) -> f64 {
    let symbols = ["EX0C", "EY0C", "EYY1-EXX1", "EC0Y"];
    assert_eq!(estimate.covariance.symbols, symbols);
    let off: Vec<f64> =
        estimate.parameters.iter().zip(truth).take(4).map(|(p, t)| p.value - t).collect();
    let rows = &estimate.covariance.rows;
    let matrix = glam::DMat4::from_cols_array_2d(&std::array::from_fn(|i| {
        std::array::from_fn(|j| rows[j][i])
    }));
    let off = glam::DVec4::from_slice(&off);
    off.dot(matrix.inverse() * off)
}

/// Mean over the worlds of χ²/4; its 99 % bounds follow from χ² with 4·200 degrees of freedom.
fn mean_normalised_chi2(changes: &[(&str, &str)]) -> f64 {
    let mut sum = 0.0;
    for seed in 0..WORLDS {
        let seed = (1000 + seed).to_string();
        let mut all = vec![("seed", seed.as_str())];
        all.extend_from_slice(changes);
        let (estimate, truth) = estimate(&machine(&all));
        sum += chi2(&estimate, truth) / 4.0;
    }
    sum / WORLDS as f64
}

fn bounds() -> (f64, f64) {
    let dof = 4.0 * WORLDS as f64;
    let (low, high) = trued::estimation::coverage::chi_square_bounds(dof, 0.99).expect("bounds");
    (low / dof, high / dof)
}

#[test]
fn regress_u_is_true_with_all_sources() {
    let (low, high) = bounds();
    let mean = mean_normalised_chi2(&[]);
    assert!((low..high).contains(&mean), "mean normalised χ² {mean} outside [{low}, {high}]");
}

#[test]
fn regress_u_is_true_on_a_machine_with_poor_axes() {
    let (low, high) = bounds();
    let mean = mean_normalised_chi2(&[
        ("error_motion_um", "3.0"),
        ("error_wavelength_mm", "60.0"),
        ("drift_um_per_h", "60.0"),
        ("lobing_um", "1.5"),
        ("stylus_offset_um", "1.0"),
    ]);
    assert!((low..high).contains(&mean), "mean normalised χ² {mean} outside [{low}, {high}]");
}
