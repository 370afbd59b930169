//! The laser R-test on the built-in machine of paper 2: is what it says true, and as sure as it says?

#[path = "../support/mod.rs"]
mod support;

use trued::estimation::coverage::chi_square_bounds;
use trued::record::estimate::Estimate;
use trued::setup::{self, MachineFile};

const METHOD: &str = "laser-r-test";
/// Paper 2, Table 5, as [simulated.errors] of the built-in machine has it: symbol, value.
const TRUTH: [(&str, f64); 5] =
    [("EA0B", -3.5), ("EB0B", -42.0), ("EC0B", -3.5), ("EX0C", -1.0), ("EA0C", 5.2)];
const WORLDS: u64 = 100;

/// The built-in machine with another seed, what `change` does to its text, and these settings.
fn machine(seed: u64, change: impl Fn(String) -> String, settings: &str) -> MachineFile {
    let text = include_str!("../../config/laser.toml");
    let seeded = text.replace("\nseed = 1\n", &format!("\nseed = {seed}\n"));
    assert!(seed == 1 || seeded != text);
    let quick = format!("\n[method.laser-r-test]\nmonte_carlo_trials = 100\n{settings}");
    MachineFile::parse("laser.toml", change(seeded) + &quick).expect("a sound machine file")
}

fn estimate(file: &MachineFile) -> Estimate {
    let (method, header) = setup::header(file, METHOD, None).expect("settings");
    let mut world = setup::world(file).expect("a world");
    let (plan, readings) = support::measure(&mut world, method.as_ref(), header);
    method.identify(&plan, &readings, &[]).expect("an estimate")
}

/// What is off of each parameter of [`TRUTH`], um and urad, and its standard uncertainty.
fn errors(estimate: &Estimate) -> Vec<(f64, f64)> {
    let of = |(symbol, truth): &(&str, f64)| {
        let found = estimate.parameters.iter().find(|parameter| parameter.symbol == *symbol);
        let found = found.unwrap_or_else(|| panic!("no {symbol}"));
        (found.value - truth, found.u)
    };
    TRUTH.iter().map(of).collect()
}

/// χ² of the five by the stated covariance.
fn chi2(estimate: &Estimate) -> f64 {
    let place = |symbol: &str| {
        let symbols = &estimate.covariance.symbols;
        symbols.iter().position(|name| name == symbol).unwrap_or_else(|| panic!("{symbol}"))
    };
    let at: Vec<usize> = TRUTH.iter().map(|(symbol, _)| place(symbol)).collect();
    let off = faer::Col::from_fn(at.len(), |i| errors(estimate)[i].0);
    let matrix =
        faer::Mat::from_fn(at.len(), at.len(), |i, j| estimate.covariance.rows[at[i]][at[j]]);
    let solved = faer::linalg::solvers::Solve::solve(&matrix.partial_piv_lu(), &off);
    off.iter().zip(solved.iter()).map(|(a, b)| a * b).sum()
}

/// One of each world, in their order.
fn in_parallel(worlds: u64, one: impl Fn(u64) -> Estimate + Sync) -> Vec<Estimate> {
    const THREADS: u64 = 2;
    let one = &one;
    let part = |k: u64| (worlds * k / THREADS..worlds * (k + 1) / THREADS).map(one);
    std::thread::scope(|scope| {
        let each = |k| scope.spawn(move || part(k).collect::<Vec<_>>());
        let threads: Vec<_> = (0..THREADS).map(each).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("no panic")).collect()
    })
}

#[test]
fn u_is_true_over_a_hundred_machines() {
    let all = in_parallel(WORLDS, |seed| estimate(&machine(100 + seed, |text| text, "")));
    let mean = all.iter().map(|estimate| chi2(estimate) / 5.0).sum::<f64>() / WORLDS as f64;
    let dof = 5.0 * WORLDS as f64;
    let (low, high) = chi_square_bounds(dof, 0.99).expect("bounds");
    println!("mean of χ²/5: {mean:.3}, within [{:.3}, {:.3}]", low / dof, high / dof);
    for (number, (symbol, _)) in TRUTH.iter().enumerate() {
        let each: Vec<(f64, f64)> = all.iter().map(|estimate| errors(estimate)[number]).collect();
        let observed = (each.iter().map(|(off, _)| off * off).sum::<f64>() / WORLDS as f64).sqrt();
        let predicted = (each.iter().map(|(_, u)| u * u).sum::<f64>() / WORLDS as f64).sqrt();
        println!("{symbol}: predicted {predicted:.3}, observed {observed:.3}");
        // Of 100 values the standard deviation is known to 7 %.
        assert!((0.85..1.15).contains(&(predicted / observed)), "{symbol}: {predicted} {observed}");
    }
    assert!((low / dof..high / dof).contains(&mean), "{mean}");
}

/// What a file does not say: X and Y lose motion, and the sensor tells late of what it saw.
fn late(text: String) -> String {
    let sensor = "zero_offset_um = [210.0";
    assert!(text.contains(sensor));
    let late = text.replace(sensor, &format!("clock_late_ms = 4.3\n{sensor}"));
    late + "\n[simulated.backlash_um]\nX = 3.0\nY = 2.0\n"
}

#[test]
#[ignore = "open: not seen to end yet; the first time the latency did not settle"]
fn u_is_true_of_continuous_scans_and_of_their_latency() {
    const OF: u64 = 40;
    let settings = "sampling = \"continuous\"\nrate_hz = 250.0\n";
    let all = in_parallel(OF, |seed| estimate(&machine(100 + seed, late, settings)));
    let chi2 = all.iter().map(chi2).sum::<f64>();
    let (low, high) = chi_square_bounds(5.0 * OF as f64, 0.99).expect("bounds");
    println!("χ² {chi2:.0}, within [{low:.0}, {high:.0}]");
    let (low_1, high_1) = chi_square_bounds(OF as f64, 0.99).expect("bounds");
    let mut beyond = Vec::new();
    for (symbol, truth) in [("latency", 4.3), ("reversal_X", 3.0), ("reversal_Y", 2.0)] {
        let of = |estimate: &Estimate| {
            let found = estimate.parameters.iter().find(|p| p.symbol == symbol);
            found.map_or((f64::NAN, 1.0), |found| (found.value - truth, found.u))
        };
        let each: Vec<(f64, f64)> = all.iter().map(of).collect();
        let one = each.iter().map(|(off, u)| (off / u).powi(2)).sum::<f64>();
        let mean = each.iter().map(|(off, _)| off).sum::<f64>() / OF as f64;
        println!("{symbol}: χ² {one:.0} of {OF}, mean off {mean:.5}, u {:.5}", each[0].1);
        beyond.extend((!(low_1..high_1).contains(&one)).then_some((symbol, one)));
    }
    assert!((low..high).contains(&chi2) && beyond.is_empty(), "{chi2} {beyond:?}");
}

/// Few poses, so that a run is short.
const SHORT: &str = "\n[method.laser-r-test]\ntilt_deg = [-60.0, 60.0]\nturn_deg = [120.0, 240.0]\n\
                     monte_carlo_trials = 100\n";

/// A folder with a machine file of these settings, and the program run there.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new(settings: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let text = include_str!("../../config/laser.toml").to_owned() + settings;
        std::fs::write(folder.path().join("laser.toml"), text).expect("written");
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn says(&self, arguments: &[&str]) -> Vec<u8> {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_trued"));
        let output = command.args(arguments).output().expect("started");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
        output.stdout
    }
}

/// Through the program: control, sensor, proof, journal.
#[test]
fn a_run_says_the_same_twice_and_is_near_the_truth() {
    let desk = Desk::new(SHORT);
    let (file, first) = (desk.path("laser.toml"), desk.path("first"));
    let run = |state| desk.says(&["run", METHOD, "--json", "--machine", &file, "--state", state]);
    let said = run(&first);
    assert_eq!(said, run(&desk.path("second")));
    let estimate: Estimate = serde_json::from_slice(&said).expect("an estimate");
    assert!(estimate.warnings.is_empty(), "{:?}", estimate.warnings);
    for ((off, u), (symbol, _)) in errors(&estimate).iter().zip(TRUTH) {
        assert!(off.abs() < 4.0 * u, "{symbol} is off by {off}, u {u}");
    }
    // By its readings alone: where the axes stood counts, not where a plan of today would send them.
    desk.says(&["export", "1", "--state", &first, "--to", &desk.path("")]);
    let readings = desk.path("run-1-readings.csv");
    let again =
        desk.says(&["identify", METHOD, "--json", "--readings", &readings, "--machine", &file]);
    let again: Estimate = serde_json::from_slice(&again).expect("an estimate");
    for ((one, u), (other, _)) in errors(&estimate).iter().zip(errors(&again)) {
        assert!((one - other).abs() < 0.01 * u, "{one} {other}");
    }
}

#[test]
fn the_same_machine_may_be_touched_instead() {
    let desk = Desk::new(&format!("{SHORT}by = \"probe\"\n"));
    let file = desk.path("laser.toml");
    let state = desk.path("state");
    let said = desk.says(&["run", METHOD, "--json", "--machine", &file, "--state", &state]);
    let estimate: Estimate = serde_json::from_slice(&said).expect("an estimate");
    for ((off, u), (symbol, _)) in errors(&estimate).iter().zip(TRUTH) {
        assert!(off.abs() < 4.0 * u, "{symbol} is off by {off}, u {u}");
    }
}
