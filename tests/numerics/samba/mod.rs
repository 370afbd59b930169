//! SAMBA end to end: the built-in machine of paper 4, its simulated control over the grbl wire. One machine is
//! measured in a real run with proof and journal; the many seeds, with a smaller design, are measured over the same
//! wire without them. The world is exact and independent of the estimator.

mod coverage;
mod designs;
mod moved_ball;
mod played_series;
mod samba_runs;
mod topologies;

use samba_runs::{MeasuredRun, RunFailed, RunSeries, SambaRunner, SambaWorld};
use testing::population::{event_count_limit, population_size};

const PARAMETER_SYMBOLS_AND_ERROR_KEYS: [(&str, &str); 13] = [
    ("EA0B", "EA0B_urad"),
    ("EC0B", "EC0B_urad"),
    ("EX0C", "EX0C_um"),
    ("EA0C", "EA0C_urad"),
    ("EB0C", "EB0C_urad"),
    ("EB0Z", "EB0Z_urad"),
    ("EA0Y", "EA0Y_urad"),
    ("EC0Y", "EC0Y_urad"),
    ("EY0S", "EY0S_um"),
    ("EX0S", "EX0S_um"),
    ("EXX1", "EXX1_um_per_m"),
    ("EYY1", "EYY1_um_per_m"),
    ("EZZ1", "EZZ1_um_per_m"),
];

/// χ² of the thirteen parameters against the true values, with the stated covariance.
fn chi2_of_parameters(measured: &MeasuredRun) -> f64 {
    let covariance = &measured.estimate.covariance;
    let at: Vec<usize> = PARAMETER_SYMBOLS_AND_ERROR_KEYS
        .iter()
        .map(|(symbol, _)| {
            let place = covariance.symbols.iter().position(|name| name == symbol);
            place.unwrap_or_else(|| panic!("{symbol} has no covariance"))
        })
        .collect();
    let off = faer::Col::from_fn(at.len(), |i| {
        measured.parameter_error(PARAMETER_SYMBOLS_AND_ERROR_KEYS[i].0, PARAMETER_SYMBOLS_AND_ERROR_KEYS[i].1)
    });
    let matrix = faer::Mat::from_fn(at.len(), at.len(), |i, j| covariance.rows[at[i]][at[j]]);
    let solved = samba_runs::solve_linear(&matrix, &off);
    off.iter().zip(solved.iter()).map(|(a, b)| a * b).sum()
}

/// Mean of χ²/13 over the seeds.
fn mean_normalised_chi2(seeds: std::ops::Range<u64>, series: &RunSeries) -> f64 {
    let count = (seeds.end - seeds.start) as f64;
    let each = map_seeds_in_parallel(seeds, |seed| {
        let measured = series.measure(seed);
        chi2_of_parameters(&measured.unwrap_or_else(|RunFailed(why)| panic!("seed {seed}: {why}"))) / 13.0
    });
    each.iter().sum::<f64>() / count
}

/// Results in the order of the seeds. Waiting for a control takes longer than the computation, so there are more
/// threads than cores.
fn map_seeds_in_parallel<T: Send>(seeds: std::ops::Range<u64>, one: impl Fn(u64) -> T + Sync) -> Vec<T> {
    const THREADS: u64 = 6;
    let one = &one;
    let mut all: Vec<(u64, T)> = std::thread::scope(|scope| {
        let part = |k: u64| seeds.clone().filter(move |seed| seed % THREADS == k);
        let each = |k| scope.spawn(move || part(k).map(|seed| (seed, one(seed))).collect::<Vec<_>>());
        let threads: Vec<_> = (0..THREADS).map(each).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    all.sort_by_key(|(seed, _)| *seed);
    all.into_iter().map(|(_, value)| value).collect()
}

#[test]
fn errors_on_the_built_in_machine_are_below_1_7_expanded_uncertainties() {
    let world = SambaWorld::as_built_in().with_key("method.samba.monte_carlo_trials", 100);
    let measured = SambaRunner::new().measure(1, &world);
    assert_eq!(measured.readings.len(), measured.plan.steps.len());
    assert!(measured.estimate.warnings.is_empty(), "{:?}", measured.estimate.warnings);
    for (symbol, key) in PARAMETER_SYMBOLS_AND_ERROR_KEYS {
        let parameter = measured.parameter(symbol);
        let off = measured.parameter_error(symbol, key);
        // Thirteen parameters of one machine: the largest deviation may well exceed U at k = 2.
        assert!(off.abs() < 1.7 * parameter.expanded, "{symbol} off by {off}: {parameter:?}");
        assert!(parameter.identifiable, "{symbol}");
    }
}

/// The budget of the small design, with which 200 machines can be measured in a test.
fn small_series(world: SambaWorld) -> RunSeries {
    RunSeries::new(with_small_design(world).with_key("method.samba.find", "once"))
}

fn with_small_design(world: SambaWorld) -> SambaWorld {
    world.with_key("method.samba.balls", 40).with_key("method.samba.references", false)
}

#[test]
fn chi2_of_worlds_inside_the_model_is_within_bounds() {
    let seeds = population_size(200);
    let mean = mean_normalised_chi2(0..seeds, &small_series(SambaWorld::with_modelled_errors_only()));
    let dof = 13.0 * seeds as f64;
    let (low, high) = estimation::coverage::chi_square_bounds(dof, 0.99).unwrap();
    println!("mean of χ²/13: {mean:.3}, within [{:.3}, {:.3}]", low / dof, high / dof);
    assert!((low / dof..high / dof).contains(&mean), "{mean}");
}

/// Errors outside of the thirteen parameters, one at a time, large enough to matter.
#[test]
fn effects_outside_the_model_are_flagged() {
    let inside = SambaWorld::with_modelled_errors_only;
    let motion = "symbol = 'EXC'\nharmonic = 2\ncos_um = 5.0";
    let sag = "axis = 'B'\nlaw = 'one-minus-cos'\num = [0.0, 0.0, -10.0]";
    let worlds = [
        ("nothing", inside()),
        ("error motion", inside().with_simulated_entry("error_motion", motion)),
        ("sag", inside().with_simulated_entry("sag", sag)),
        ("drift", inside().with_key("machine.drift_um_per_h", 80.0)),
    ];
    const FULL_POPULATION: u64 = 10;
    let seeds = population_size(FULL_POPULATION);
    // The misfit test has a level of 1 %.
    let false_alarms = event_count_limit(seeds, FULL_POPULATION, (0.01, 1));
    for (name, world) in worlds {
        let series = small_series(world).without_declared_drift();
        let flagged = map_seeds_in_parallel(0..seeds, |seed| {
            let measured = series.measure(seed);
            let measured = measured.unwrap_or_else(|RunFailed(why)| panic!("{name} {seed}: {why}"));
            let warnings = &measured.estimate.warnings;
            println!("{name} {seed}: χ²/dof {:.2}", measured.estimate.chi2_per_dof);
            warnings.iter().any(|warning| warning.contains("does not explain"))
        });
        let count = flagged.iter().filter(|flagged| **flagged).count() as u64;
        if name == "nothing" {
            assert!(count <= false_alarms, "{count} of {seeds} flagged without cause");
        } else {
            assert!(count * 10 >= 8 * seeds, "{name}: only {count} of {seeds} flagged");
        }
    }
}
