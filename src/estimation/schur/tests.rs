use faer::Mat;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::linear_least_squares::{LinearProblem, solve_least_squares};
use crate::nonlinear_least_squares::{NonlinearError, minimise_squares};
use crate::random::seeded_stream;

const COMMON_UNKNOWN_COUNT: usize = 5;
/// Numbers of own unknowns and of rows of each block. They are unequal, and one block has as many unknowns as rows.
const OWN_UNKNOWN_AND_ROW_COUNTS: [(usize, usize); 4] = [(3, 12), (6, 17), (3, 3), (1, 9)];

/// Random rows as blocks, and the same rows as one dense matrix (unknowns: common, then blocks).
fn random_problem(seed: u64) -> (Vec<BlockRows>, Mat<f64>, Vec<f64>) {
    let mut normal = StandardNormal.sample_iter(seeded_stream(seed, &[]));
    let mut next = || -> f64 { normal.next().unwrap() };
    let unknowns = COMMON_UNKNOWN_COUNT + OWN_UNKNOWN_AND_ROW_COUNTS.iter().map(|(own, _)| own).sum::<usize>();
    let total = OWN_UNKNOWN_AND_ROW_COUNTS.iter().map(|(_, rows)| rows).sum();
    let (mut dense, mut values, mut blocks) = (Mat::zeros(total, unknowns), Vec::new(), Vec::new());
    let (mut row, mut first) = (0, COMMON_UNKNOWN_COUNT);
    for (own, count) in OWN_UNKNOWN_AND_ROW_COUNTS {
        let mut rows = BlockRows::zeros(count, own, COMMON_UNKNOWN_COUNT);
        for i in 0..count {
            for j in 0..own {
                dense[(row, first + j)] = next() * 1e3;
                rows.set_own_coefficient(i, j, dense[(row, first + j)]);
            }
            for j in 0..COMMON_UNKNOWN_COUNT {
                dense[(row, j)] = next() * 10_f64.powi(j as i32);
                rows.set_common_coefficient(i, j, dense[(row, j)]);
            }
            values.push(next());
            rows.set_right_side(i, values[row]);
            row += 1;
        }
        first += own;
        blocks.push(rows);
    }
    (blocks, dense, values)
}

#[test]
fn block_solution_equals_dense_solution() {
    let (blocks, dense, values) = random_problem(1);
    let sigma = vec![1.0; values.len()];
    let problem = LinearProblem {
        a: dense.as_ref(),
        y: &values,
        sigma: &sigma,
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let expected = solve_least_squares(&problem).unwrap();
    let (factored, coordinates) = factorise_and_project_right_side(blocks);
    let near = |a: f64, b: f64, size: f64| (a - b).abs() < 1e-11 * size;
    for x in [factored.unknowns_from_coordinates(&coordinates), factored.solve(&values)] {
        for (j, (x, expected_x)) in x.iter().zip(&expected.x).enumerate() {
            assert!(near(*x, *expected_x, expected.covariance[(j, j)].sqrt()), "{j}: {x}");
        }
    }
    let covariance = factored.covariance();
    for i in 0..covariance.nrows() {
        for j in 0..covariance.ncols() {
            let size = (expected.covariance[(i, i)] * expected.covariance[(j, j)]).sqrt();
            assert!(near(covariance[(i, j)], expected.covariance[(i, j)], size), "{i} {j}");
        }
    }
    for (found, expected) in factored.residuals(&values).iter().zip(&expected.residuals) {
        assert!((found - expected).abs() < 1e-12);
    }
    assert_eq!(factored.solution_and_residuals(values.clone()), (factored.solve(&values), factored.residuals(&values)));
    let hat = &dense * &expected.gain;
    for (i, found) in factored.leverage().into_iter().enumerate() {
        assert!((found - hat[(i, i)]).abs() < 1e-12);
    }
    let analyse_rank = factored.analyse_rank().unwrap();
    assert_eq!(analyse_rank.rank, expected.rank);
    assert!((analyse_rank.condition / expected.condition - 1.0).abs() < 1e-10);
    for (j, norm) in factored.column_norms().into_iter().enumerate() {
        assert!((norm / dense.col(j).norm_l2() - 1.0).abs() < 1e-12);
    }
}

/// The column of the second common unknown is a combination of the columns of the first common unknown and of the
/// first unknown of the second block. The rank is 17 of 18, and the null vector is that combination.
#[test]
fn dependent_column_is_found_and_refused() {
    let build = |_: &[f64]| {
        let (mut blocks, dense, _) = random_problem(2);
        let mut row = 0;
        for (block, (_, count)) in blocks.iter_mut().zip(OWN_UNKNOWN_AND_ROW_COUNTS) {
            for i in 0..count {
                block.set_common_coefficient(i, 1, 2.0 * dense[(row, 0)] + dense[(row, COMMON_UNKNOWN_COUNT + 3)]);
                row += 1;
            }
        }
        blocks
    };
    let (factored, _) = factorise_and_project_right_side(build(&[]));
    let analyse_rank = factored.analyse_rank().unwrap();
    assert_eq!((analyse_rank.rank, analyse_rank.nullity), (17, 1));
    let lost = analyse_rank.null_space.col(0);
    assert!((lost[0] / lost[1] + 2.0).abs() < 1e-6 && (lost[COMMON_UNKNOWN_COUNT + 3] / lost[1] + 1.0).abs() < 1e-6);
    let refused = minimise_squares(vec![0.0; 18], build, |_| vec![0.0; 41]);
    assert!(matches!(refused, Err(NonlinearError::Linear(LinearError::RankDeficient(_)))));
}
