//! Agreement of the runs, and coverage of a population.

use nalgebra::DMatrix;
use rand_distr::{Distribution, StandardNormal};

use super::{SYMBOLS, TestRun, combine};
use estimation::random::seeded_stream;
use machine::record::estimate::Verdict;

/// Own scatter and a stylus offset with different effects in three runs: U covers the truth in 95.45 % of the
/// populations, and 1 % of them are rejected.
#[test]
fn combined_u_covers_a_population_with_a_shared_source() {
    let mut rng = seeded_stream(7, &[1]);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    let truth = [40.0, -15.0];
    let effects = [[2.0, 0.5], [2.0, -0.5], [1.0, 1.5]];
    let own_u = [0.8, 1.2, 1.0];
    let (mut covered, mut rejected, trials) = ([0, 0], 0, 3000);
    for _ in 0..trials {
        let offset = draw();
        let run = |(index, number): (usize, i64), noise: [f64; 2]| {
            let value = |k: usize| truth[k] + effects[index][k] * offset + own_u[index] * noise[k];
            let own = DMatrix::identity(2, 2) * own_u[index] * own_u[index];
            let run = TestRun::new(number, &SYMBOLS[..2], &[value(0), value(1)], &own);
            run.with_source("stylus offset", &[&effects[index]])
        };
        let runs: Vec<TestRun> = (0..3).zip(1..).map(|index| run(index, [draw(), draw()])).collect();
        let combined = combine(&runs).unwrap();
        rejected += usize::from(!combined.consistency.is_consistent());
        for (k, own) in combined.estimate.parameters.iter().enumerate() {
            covered[k] += usize::from((own.value - truth[k]).abs() <= own.expanded);
        }
    }
    // 2863 expected, standard deviation 11; 30 expected, standard deviation 5.5.
    assert!(covered.iter().all(|count| (2825..=2901).contains(count)), "{covered:?}");
    assert!((8..=46).contains(&rejected), "{rejected}");
}

fn runs_with_change(values: &[f64]) -> Vec<TestRun> {
    let run = |(number, value): (i64, &f64)| {
        TestRun::new(number, &SYMBOLS[..2], &[*value, 3.0], &DMatrix::identity(2, 2))
            .with_source("stylus offset", &[&[2.0, 0.0]])
    };
    (11..).zip(values).map(run).collect()
}

#[test]
fn changed_machine_is_named() {
    let combined = combine(&runs_with_change(&[5.0, 5.5, 25.0, 4.8])).unwrap();
    assert_eq!(combined.estimate.verdict, Verdict::UndecidedModel);
    let disagreeing = &combined.consistency.disagreeing_runs;
    assert_eq!((disagreeing.len(), disagreeing[0].deviation.run), (1, 13));
    assert_eq!(disagreeing[0].others, [11, 12, 14]);
    let warning = &combined.estimate.warnings[0];
    assert!(
        warning.starts_with("run 13 contradicts the combination of the runs 11, 12, 14: EX0C deviates by 19.9"),
        "{warning}"
    );
    let two = combine(&runs_with_change(&[5.0, 25.0])).unwrap();
    assert_eq!(two.consistency.disagreeing_runs.len(), 1);
    assert!(two.estimate.warnings[0].contains("contradicts run 1"), "{:?}", two.estimate.warnings);
    // Two changed runs of five.
    let names = combine(&runs_with_change(&[5.0, 45.0, 5.2, 25.0, 4.8])).unwrap().consistency.disagreeing_runs;
    assert_eq!(names.iter().map(|one| one.deviation.run).collect::<Vec<_>>(), [12, 14]);
}

#[test]
fn order_of_the_runs_does_not_matter() {
    let runs = runs_with_change(&[5.0, 6.0, 7.0]);
    let expected = combine(&runs).unwrap();
    for order in [[0, 2, 1], [1, 0, 2], [2, 1, 0]] {
        assert_eq!(combine(&order.map(|index| runs[index].clone())).unwrap(), expected);
    }
    assert_eq!(expected.estimate.verdict, Verdict::None);
}
