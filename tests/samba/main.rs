//! SAMBA end to end: the built-in machine of paper 4, its simulated control over the grbl wire, the
//! real run with proof and journal. The world is exact and knows nothing of the estimator.

mod bench;

use bench::{Bench, Measured, World};

const SYMBOLS: [(&str, &str); 13] = [
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

/// χ² of the thirteen parameters against the truth, by the stated covariance.
fn chi2(measured: &Measured) -> f64 {
    let covariance = &measured.estimate.covariance;
    let at: Vec<usize> = SYMBOLS
        .iter()
        .map(|(symbol, _)| {
            let place = covariance.symbols.iter().position(|name| name == symbol);
            place.unwrap_or_else(|| panic!("{symbol} has no covariance"))
        })
        .collect();
    let off = faer::Col::from_fn(at.len(), |i| measured.error(SYMBOLS[i].0, SYMBOLS[i].1));
    let matrix = faer::Mat::from_fn(at.len(), at.len(), |i, j| covariance.rows[at[i]][at[j]]);
    let solved = bench::solve(&matrix, &off);
    off.iter().zip(solved.iter()).map(|(a, b)| a * b).sum()
}

/// Mean of χ²/13 over the seeds.
fn mean_chi2(seeds: u64, world: &World) -> f64 {
    let all = (0..seeds).map(|seed| chi2(&Bench::new().measure(seed, world)) / 13.0);
    all.sum::<f64>() / seeds as f64
}

#[test]
fn the_built_in_machine_is_measured_as_it_is() {
    let measured = Bench::new().measure(1, &World::as_built_in());
    for (symbol, key) in SYMBOLS {
        let parameter = measured.parameter(symbol);
        let off = measured.error(symbol, key);
        // Three expanded uncertainties: 13 parameters of one machine.
        assert!(off.abs() < 1.5 * parameter.expanded, "{symbol} off by {off}: {parameter:?}");
        assert!(parameter.identifiable, "{symbol}");
    }
}
