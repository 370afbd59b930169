//! The laser R-test on the built-in machine of paper 2: errors of its results, and coverage of its uncertainties.

use estimation::coverage::chi_square_bounds;
use machine::record::estimate::Estimate;
use trued::setup::{self, MachineFile};

use crate::support::plan_player;
use testing::population::{population_size, sd_ratio_bounds};

const METHOD: &str = "laser-r-test";
/// Paper 2, Table 5, as in [simulated.errors] of the built-in machine: symbol, value.
const TRUE_LOCATION_ERRORS: [(&str, f64); 5] =
    [("EA0B", -3.5), ("EB0B", -42.0), ("EC0B", -3.5), ("EX0C", -1.0), ("EA0C", 5.2)];

/// The built-in machine with another seed, its text changed by `change`, and these settings.
fn changed_machine(seed: u64, change: impl Fn(String) -> String, settings: &str) -> MachineFile {
    let text = include_str!("../../config/laser.toml");
    let seeded = text.replace("\nseed = 1\n", &format!("\nseed = {seed}\n"));
    assert!(seed == 1 || seeded != text);
    let quick = format!("\n[method.laser-r-test]\nmonte_carlo_trials = 100\n{settings}");
    MachineFile::parse("laser.toml", change(seeded) + &quick).expect("a sound machine file")
}

fn measure_and_identify(file: &MachineFile) -> Estimate {
    let (method, header) = setup::configure_method_and_plan_without_steps(file, METHOD, None).expect("settings");
    let mut world = setup::build_world(file).expect("a world");
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    method.identify(&plan, &readings).expect("an estimate")
}

/// Error of each parameter of [`TRUE_LOCATION_ERRORS`], um and urad, and its standard uncertainty.
fn estimation_errors_and_u(estimate: &Estimate) -> Vec<(f64, f64)> {
    let of = |(symbol, truth): &(&str, f64)| {
        let found = estimate.parameters.iter().find(|parameter| parameter.symbol == *symbol);
        let found = found.unwrap_or_else(|| panic!("no {symbol}"));
        (found.value - truth, found.u)
    };
    TRUE_LOCATION_ERRORS.iter().map(of).collect()
}

/// χ² of the five errors with the stated covariance.
fn estimation_error_chi2(estimate: &Estimate) -> f64 {
    let place = |symbol: &str| {
        let symbols = &estimate.covariance.symbols;
        symbols.iter().position(|name| name == symbol).unwrap_or_else(|| panic!("{symbol}"))
    };
    let at: Vec<usize> = TRUE_LOCATION_ERRORS.iter().map(|(symbol, _)| place(symbol)).collect();
    let off = faer::Col::from_fn(at.len(), |i| estimation_errors_and_u(estimate)[i].0);
    let matrix = faer::Mat::from_fn(at.len(), at.len(), |i, j| estimate.covariance.rows[at[i]][at[j]]);
    let solved = faer::linalg::solvers::Solve::solve(&matrix.partial_piv_lu(), &off);
    off.iter().zip(solved.iter()).map(|(a, b)| a * b).sum()
}

/// One estimate of each world, in order.
fn estimates_in_parallel(worlds: u64, one: impl Fn(u64) -> Estimate + Sync) -> Vec<Estimate> {
    const THREAD_COUNT: u64 = 2;
    let one = &one;
    let part = |k: u64| (worlds * k / THREAD_COUNT..worlds * (k + 1) / THREAD_COUNT).map(one);
    std::thread::scope(|scope| {
        let each = |k| scope.spawn(move || part(k).collect::<Vec<_>>());
        let threads: Vec<_> = (0..THREAD_COUNT).map(each).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("no panic")).collect()
    })
}

#[test]
fn uncertainty_covers_the_truth_of_many_machines() {
    const FULL_POPULATION: u64 = 100;
    let worlds = population_size(FULL_POPULATION);
    // With 100 values the standard deviation is known to 7 %.
    let (low_ratio, high_ratio) = sd_ratio_bounds(worlds, FULL_POPULATION, (1.0 / 1.15, 1.0 / 0.85));
    let all = estimates_in_parallel(worlds, |seed| measure_and_identify(&changed_machine(100 + seed, |text| text, "")));
    let mean = all.iter().map(|estimate| estimation_error_chi2(estimate) / 5.0).sum::<f64>() / worlds as f64;
    let dof = 5.0 * worlds as f64;
    let (low, high) = chi_square_bounds(dof, 0.99).expect("bounds");
    println!("mean of χ²/5: {mean:.3}, within [{:.3}, {:.3}]", low / dof, high / dof);
    for (number, (symbol, _)) in TRUE_LOCATION_ERRORS.iter().enumerate() {
        let each: Vec<(f64, f64)> = all.iter().map(|estimate| estimation_errors_and_u(estimate)[number]).collect();
        let observed = (each.iter().map(|(off, _)| off * off).sum::<f64>() / worlds as f64).sqrt();
        let predicted = (each.iter().map(|(_, u)| u * u).sum::<f64>() / worlds as f64).sqrt();
        println!("{symbol}: predicted {predicted:.3}, observed {observed:.3}");
        let ratio = observed / predicted;
        assert!((low_ratio..high_ratio).contains(&ratio), "{symbol}: {predicted} {observed}");
    }
    assert!((low / dof..high / dof).contains(&mean), "{mean}");
}

/// Adds undeclared errors to the machine file: lost motion of X and Y, and a latency of the sensor.
fn with_latency_and_lost_motion(text: String) -> String {
    let sensor = "zero_offset_um = [210.0";
    assert!(text.contains(sensor));
    let late = text.replace(sensor, &format!("clock_late_ms = 4.3\n{sensor}"));
    late + "\n[simulated.backlash_um]\nX = 3.0\nY = 2.0\n"
}

#[test]
fn coverage_of_continuous_scans_and_their_latency() {
    let worlds = population_size(40);
    let settings = "sampling = \"continuous\"\nrate_hz = 250.0\n";
    let all = estimates_in_parallel(worlds, |seed| {
        measure_and_identify(&changed_machine(100 + seed, with_latency_and_lost_motion, settings))
    });
    let chi2 = all.iter().map(estimation_error_chi2).sum::<f64>();
    let (low, high) = chi_square_bounds(5.0 * worlds as f64, 0.99).expect("bounds");
    println!("χ² {chi2:.0}, within [{low:.0}, {high:.0}]");
    let (low_1, high_1) = chi_square_bounds(worlds as f64, 0.99).expect("bounds");
    let mut beyond = Vec::new();
    for (symbol, truth) in [("latency", 4.3), ("reversal_X", 3.0), ("reversal_Y", 2.0)] {
        let of = |estimate: &Estimate| {
            let found = estimate.parameters.iter().find(|p| p.symbol == symbol);
            found.map_or((f64::NAN, 1.0), |found| (found.value - truth, found.u))
        };
        let each: Vec<(f64, f64)> = all.iter().map(of).collect();
        let one = each.iter().map(|(off, u)| (off / u).powi(2)).sum::<f64>();
        let mean = each.iter().map(|(off, _)| off).sum::<f64>() / worlds as f64;
        println!("{symbol}: χ² {one:.0} of {worlds}, mean off {mean:.5}, u {:.5}", each[0].1);
        beyond.extend((!(low_1..high_1).contains(&one)).then_some((symbol, one)));
    }
    assert!((low..high).contains(&chi2) && beyond.is_empty(), "{chi2} {beyond:?}");
}

/// Errors outside of the model's unknowns: a text of the machine file, its replacement, and the line of the budget.
/// The form of the sphere is set separately for the world and for the method.
const UNMODELLED_EFFECTS: [(&str, &str, &str); 3] = [
    ("squareness_urad = 0.0\n", "squareness_urad = 4.0\n", "squareness of X, Y and Z"),
    ("linearity_um = 0.5\n", "linearity_um = 0.5\nincidence_um = 0.4\n", "lean of the surface"),
    ("radius_mm = 10.0\n", "", "form of the sphere"),
];
const ADDED_BALL_FORM_UM: f64 = 0.4;

fn with_added_ball_form(text: String) -> String {
    // In addition to a small undeclared form.
    let told = text.replace("ball_form_um = 0.05\n", &format!("ball_form_um = {}\n", ADDED_BALL_FORM_UM + 0.05));
    assert_ne!(told, text);
    told
}

/// Machine file with one of [`UNMODELLED_EFFECTS`] in the world and in the budget.
fn machine_with_effect((from, to, _): (&str, &str, &str), seed: u64) -> MachineFile {
    let change = |text: String| match to {
        "" => with_added_ball_form(text),
        to => {
            assert!(text.contains(from));
            text.replacen(from, to, 1)
        }
    };
    match to {
        "" => changed_machine(seed, change, &format!("form_u_um = {ADDED_BALL_FORM_UM}\n")),
        _ => changed_machine(seed, change, ""),
    }
}

/// METHODS, section 6: switching a source off changes its line of the budget and the scatter by the same amount.
/// Each world is measured with and without it, everything else being equal.
#[test]
fn unmodelled_effects_scatter_as_their_budget_lines() {
    const FULL_POPULATION: u64 = 40;
    let worlds = population_size(FULL_POPULATION);
    let (low, high) = sd_ratio_bounds(worlds, FULL_POPULATION, (0.8, 1.2));
    let without =
        estimates_in_parallel(worlds, |seed| measure_and_identify(&changed_machine(300 + seed, |text| text, "")));
    for source in UNMODELLED_EFFECTS {
        let with = estimates_in_parallel(worlds, |seed| measure_and_identify(&machine_with_effect(source, 300 + seed)));
        let (mut sum, mut seen) = (0.0, 0.0);
        for (number, parameter) in with[0].parameters.iter().enumerate() {
            let line = parameter.budget.iter().find(|line| line.source == source.2);
            let predicted = line.expect("a line").u;
            // A contribution that is small against the rest is not tested.
            if predicted > 0.2 * parameter.u {
                let value = |estimate: &Estimate| estimate.parameters[number].value;
                let pairs = with.iter().zip(&without);
                let square = pairs.map(|(on, off)| (value(on) - value(off)).powi(2)).sum::<f64>();
                let ratio = (square / worlds as f64).sqrt() / predicted;
                println!("{}, {}: {ratio:.2}, u {predicted:.5}", source.2, parameter.symbol);
                sum += ratio * ratio;
                seen += 1.0;
            }
        }
        let ratio = (sum / seen).sqrt();
        println!("{}: {ratio:.3}, within [{low:.3}, {high:.3}]", source.2);
        assert!((low..high).contains(&ratio), "{}: {ratio}", source.2);
    }
}

/// The same sensor with two to six waves over the range, and without: the difference agrees with its line of the
/// budget.
#[test]
fn linearity_error_scatters_as_its_budget_line() {
    const FULL_POPULATION: u64 = 40;
    let worlds = population_size(FULL_POPULATION);
    let (low, high) = sd_ratio_bounds(worlds, FULL_POPULATION, (0.75, 1.25));
    let file = |is_straight: bool, seed: u64| {
        let change = |text: String| {
            let text = text.replacen("linearity_um = 0.5", "linearity_um = 1.5", 1);
            let keys = if is_straight { "linearity = []\n" } else { "" };
            text.replacen("zero_offset_um = [210.0", &format!("{keys}zero_offset_um = [210.0"), 1)
        };
        changed_machine(seed, change, "")
    };
    let straight = estimates_in_parallel(worlds, |seed| measure_and_identify(&file(true, 300 + seed)));
    let curved = estimates_in_parallel(worlds, |seed| measure_and_identify(&file(false, 300 + seed)));
    let (mut sum, mut seen) = (0.0, 0.0);
    for (number, parameter) in curved[0].parameters.iter().enumerate() {
        let line = parameter.budget.iter().find(|line| line.source == "linearity of the sensor");
        let predicted = line.map_or(0.0, |line| line.u);
        if predicted > 0.2 * parameter.u {
            let value = |estimate: &Estimate| estimate.parameters[number].value;
            let pairs = curved.iter().zip(&straight);
            let square = pairs.map(|(on, off)| (value(on) - value(off)).powi(2)).sum::<f64>();
            let ratio = (square / worlds as f64).sqrt() / predicted;
            println!("{}: {ratio:.2}, u {predicted:.5}", parameter.symbol);
            sum += ratio * ratio;
            seen += 1.0;
        }
    }
    let ratio = (sum / seen).sqrt();
    println!("{ratio:.3}, within [{low:.3}, {high:.3}]");
    assert!((low..high).contains(&ratio), "{ratio}");
}
