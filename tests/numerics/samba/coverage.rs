//! Coverage of the stated uncertainty (METHODS section 6), with sources outside of the model that are declared by
//! their size: thirteen parameters and the stylus, compared with the truth in the middle of the measurement.

use super::played_series::PlayedSeries;
use super::samba_runs::{self, MeasuredRun, SambaWorld};
use super::{PARAMETER_SYMBOLS_AND_ERROR_KEYS, with_small_design};
use testing::population::{event_count_limit, population_size, sd_ratio_bounds};

const STYLUS_SYMBOLS: [&str; 3] = ["tool_x", "tool_y", "tool_z"];

/// Name and deviation from the true value, each in the unit of its parameter.
fn deviations_from_truth(measured: &MeasuredRun) -> Vec<(&'static str, f64)> {
    let machine =
        PARAMETER_SYMBOLS_AND_ERROR_KEYS.iter().map(|(symbol, key)| (*symbol, measured.parameter_error(symbol, key)));
    machine.chain(STYLUS_SYMBOLS.into_iter().zip(measured.stylus_error_mm())).collect()
}

/// χ² of the deviations with the stated covariance.
fn chi2_of_parameters_and_stylus(measured: &MeasuredRun) -> f64 {
    let off = deviations_from_truth(measured);
    let covariance = &measured.estimate.covariance;
    let at = |name| covariance.symbols.iter().position(|symbol| symbol == name).unwrap();
    let places: Vec<usize> = off.iter().map(|(name, _)| at(*name)).collect();
    let u: Vec<f64> = places.iter().map(|i| covariance.rows[*i][*i].sqrt()).collect();
    let scaled = faer::Col::from_fn(off.len(), |i| off[i].1 / u[i]);
    let matrix = faer::Mat::from_fn(off.len(), off.len(), |i, j| covariance.rows[places[i]][places[j]] / (u[i] * u[j]));
    let solved = samba_runs::solve_linear(&matrix, &scaled);
    scaled.iter().zip(solved.iter()).map(|(a, b)| a * b).sum()
}

/// All draws are normally distributed, except the rounding of single touches: the sum over the worlds has a χ²
/// distribution. Almost no world may be reported as a misfit, in either direction.
fn check_coverage(name: &str, world: SambaWorld) {
    const FULL_POPULATION: u64 = 200;
    let seeds = population_size(FULL_POPULATION);
    let worlds = PlayedSeries::new(world).measure(0..seeds);
    let dof = (16 * seeds) as f64;
    let mean = worlds.iter().map(chi2_of_parameters_and_stylus).sum::<f64>() / dof;
    let (low, high) = estimation::coverage::chi_square_bounds(dof, 0.99).unwrap();
    let (low, high) = (low / dof, high / dof);
    let told = |what: &str| {
        let says = |m: &&MeasuredRun| m.estimate.warnings.iter().any(|line| line.contains(what));
        worlds.iter().filter(says).count() as u64
    };
    let (above, below) = (told("does not explain"), told("scatter less"));
    let left = worlds.iter().map(|m| m.estimate.chi2_per_dof).sum::<f64>() / seeds as f64;
    println!("{name}: mean of χ²/16 {mean:.3}, within [{low:.3}, {high:.3}]; residuals {left:.3}");
    println!("{name}: {above} called a misfit, {below} too good, of {seeds}");
    for (k, (name, _)) in deviations_from_truth(&worlds[0]).into_iter().enumerate() {
        let square = |m: &MeasuredRun| (deviations_from_truth(m)[k].1 / m.parameter(name).u).powi(2);
        let mean = worlds.iter().map(square).sum::<f64>() / seeds as f64;
        println!("  {name}: {:.3} u", mean.sqrt());
    }
    assert!((low..high).contains(&mean), "{name}: {mean}");
    let misfits = event_count_limit(seeds, FULL_POPULATION, (0.01, 3));
    assert!(above <= misfits && below <= misfits, "{name}: {above} above, {below} below");
}

#[test]
fn coverage_on_the_built_in_machine_with_all_sources() {
    check_coverage("as shipped", SambaWorld::as_built_in());
}

#[test]
fn coverage_on_a_poor_machine() {
    let mut world = with_small_design(SambaWorld::as_built_in())
        .with_key("machine.drift_um_per_h", 10.0)
        .with_key("probe.lobing_um", 1.5);
    for axis in ["X", "Y", "Z"] {
        world = world.with_key(&format!("axes.{axis}.error_motion_um"), 1.5);
    }
    for axis in ["B", "C"] {
        world = world.with_key(&format!("axes.{axis}.error_motion_um"), 1.0);
    }
    check_coverage("poor", world);
}

type SourceSwitch = fn(SambaWorld, bool) -> SambaWorld;

fn with_axis_key(world: SambaWorld, key: &str, axes: &[&str], value: f64) -> SambaWorld {
    axes.iter().fold(world, |world, axis| world.with_key(&format!("axes.{axis}.{key}"), value))
}

/// The sources that can be declared, by their name in the budget, each with its switch; a declared repeatability,
/// and a certificate without any uncertainty, cannot be zero.
const SOURCE_SWITCHES: [(&str, SourceSwitch); 8] = [
    ("repeatability of a touch", |w, on| w.with_key("probe.repeatability_um", if on { 1.0 } else { 0.05 })),
    ("resolution", |w, on| with_axis_key(w, "resolution_um", &["X", "Y", "Z"], if on { 3.0 } else { 0.0 })),
    ("probe lobing", |w, on| w.with_key("probe.lobing_um", if on { 3.0 } else { 0.0 })),
    ("error motions of X, Y and Z", |w, on| {
        with_axis_key(w, "error_motion_um", &["X", "Y", "Z"], if on { 1.0 } else { 0.0 })
    }),
    ("error motions of rotary axes", |w, on| {
        with_axis_key(w, "error_motion_um", &["B", "C"], if on { 1.0 } else { 0.0 })
    }),
    ("thermal drift", |w, on| w.with_key("machine.drift_um_per_h", if on { 10.0 } else { 0.0 })),
    ("certified length", |w, on| w.with_bar("u_mm", if on { 0.002 } else { 1e-7 })),
    ("temperature of the certified length", |w, on| w.with_bar("u_temperature_k", if on { 5.0 } else { 0.0 })),
];

/// One source alone: its budget line equals the observed scatter, over all parameters for which it is prominent
/// together, and approximately for each of them.
#[test]
fn each_budget_line_equals_the_scatter_of_its_source() {
    const FULL_POPULATION: u64 = 60;
    let seeds = population_size(FULL_POPULATION);
    let one = sd_ratio_bounds(seeds, FULL_POPULATION, (0.7, 1.3));
    let all_of_source = sd_ratio_bounds(seeds, FULL_POPULATION, (0.8, 1.2));
    let all = with_small_design(SambaWorld::as_built_in()).with_key("simulated.ball_form_um", 0.0);
    let usual = PlayedSeries::new(all.clone()).measure(0..1).remove(0);
    for line in &usual.parameter("EX0C").budget {
        let listed = SOURCE_SWITCHES.iter().any(|(name, _)| *name == line.source);
        assert!(listed, "{} is not looked at", line.source);
    }
    for (name, _) in SOURCE_SWITCHES {
        let alone = SOURCE_SWITCHES.iter().fold(all.clone(), |w, (other, set)| set(w, *other == name));
        let worlds = PlayedSeries::new(alone).measure(0..seeds);
        let line = |m: &MeasuredRun, symbol: &str| {
            let lines = &m.parameter(symbol).budget;
            lines.iter().find(|line| line.source == name).map_or(0.0, |line| line.u)
        };
        let weight = |symbol: &str| line(&worlds[0], symbol) / usual.parameter(symbol).u;
        let most = deviations_from_truth(&usual).iter().map(|(s, _)| weight(s)).fold(0.0, f64::max);
        let (mut sum, mut count) = (0.0, 0.0);
        for (k, (symbol, _)) in deviations_from_truth(&usual).into_iter().enumerate() {
            if weight(symbol) < 0.3 * most {
                continue;
            }
            let square = |m: &MeasuredRun| (deviations_from_truth(m)[k].1 / line(m, symbol)).powi(2);
            let mean = worlds.iter().map(square).sum::<f64>() / seeds as f64;
            println!("{name}: {symbol} seen {:.3} of its line", mean.sqrt());
            assert!((one.0..=one.1).contains(&mean.sqrt()), "{name}, {symbol}: {}", mean.sqrt());
            (sum, count) = (sum + mean, count + 1.0);
        }
        let ratio = f64::sqrt(sum / count);
        let (low, high) = all_of_source;
        println!(
            "source {name} alone: rms deviation from truth is {ratio:.3} of its budget lines, allowed {low:.3} to {high:.3}"
        );
        assert!((low..=high).contains(&ratio), "{name}: {ratio}");
    }
}
