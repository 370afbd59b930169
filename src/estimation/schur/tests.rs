use faer::Mat;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::base::random::stream;
use crate::estimation::linear::{LinearProblem, solve};

const COMMON: usize = 5;
/// Own unknowns and rows of the blocks: unequal, one of them tight.
const SHAPES: [(usize, usize); 4] = [(3, 12), (6, 17), (3, 3), (1, 9)];

/// Random rows, and the same as one dense matrix (unknowns: common, then blocks).
fn random_problem(seed: u64) -> (Vec<Rows>, Mat<f64>, Vec<f64>) {
    let mut normal = StandardNormal.sample_iter(stream(seed, &[]));
    let mut next = || -> f64 { normal.next().unwrap() };
    let unknowns = COMMON + SHAPES.iter().map(|(own, _)| own).sum::<usize>();
    let total = SHAPES.iter().map(|(_, rows)| rows).sum();
    let (mut dense, mut values, mut blocks) = (Mat::zeros(total, unknowns), Vec::new(), Vec::new());
    let (mut row, mut first) = (0, COMMON);
    for (own, count) in SHAPES {
        let mut rows = Rows::zeros(count, own, COMMON);
        for i in 0..count {
            for j in 0..own {
                dense[(row, first + j)] = next() * 1e3;
                rows.set_own(i, j, dense[(row, first + j)]);
            }
            for j in 0..COMMON {
                dense[(row, j)] = next() * 10_f64.powi(j as i32);
                rows.set_common(i, j, dense[(row, j)]);
            }
            values.push(next());
            rows.set_value(i, values[row]);
            row += 1;
        }
        first += own;
        blocks.push(rows);
    }
    (blocks, dense, values)
}

#[test]
fn regress_as_a_dense_solve() {
    let (blocks, dense, values) = random_problem(1);
    let sigma = vec![1.0; values.len()];
    let problem = LinearProblem {
        a: dense.as_ref(),
        y: &values,
        sigma: &sigma,
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let expected = solve(&problem).unwrap();
    let (factored, coordinates) = factor(blocks);
    let near = |a: f64, b: f64, size: f64| (a - b).abs() < 1e-11 * size;
    for x in [factored.unknowns_at(&coordinates), factored.solve(&values)] {
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
    for (found, expected) in factored.remainder(&values).iter().zip(&expected.residuals) {
        assert!((found - expected).abs() < 1e-12);
    }
    let hat = &dense * &expected.gain;
    for (i, found) in factored.leverage().into_iter().enumerate() {
        assert!((found - hat[(i, i)]).abs() < 1e-12);
    }
    let survey = factored.survey().unwrap();
    assert_eq!(survey.rank, expected.rank);
    assert!((survey.condition / expected.condition - 1.0).abs() < 1e-10);
    for (j, norm) in factored.column_norms().into_iter().enumerate() {
        assert!((norm / dense.col(j).norm_l2() - 1.0).abs() < 1e-12);
    }
}

/// The second common unknown moves every row as the first unknown of the second block and the first
/// common one do: rank 17 of 18, and the null vector is that combination.
#[test]
fn regress_a_lost_direction_is_found_and_refused() {
    let build = |_: &[f64]| {
        let (mut blocks, dense, _) = random_problem(2);
        let mut row = 0;
        for (block, (_, count)) in blocks.iter_mut().zip(SHAPES) {
            for i in 0..count {
                block.set_common(i, 1, 2.0 * dense[(row, 0)] + dense[(row, COMMON + 3)]);
                row += 1;
            }
        }
        blocks
    };
    let (factored, _) = factor(build(&[]));
    let survey = factored.survey().unwrap();
    assert_eq!((survey.rank, survey.nullity), (17, 1));
    let lost = survey.null_space.col(0);
    assert!(
        (lost[0] / lost[1] + 2.0).abs() < 1e-6 && (lost[COMMON + 3] / lost[1] + 1.0).abs() < 1e-6
    );
    let refused = minimise(vec![0.0; 18], build, |_| vec![0.0; 41]);
    assert!(matches!(refused, Err(NonlinearError::Linear(LinearError::RankDeficient(_)))));
}

/// Points on lines through a common origin, at distances of their own: y = o + d_i·t, quadratic.
#[test]
fn regress_a_curved_model_is_followed_to_its_minimum() {
    let truth = [1.5, 0.7, 2.0, -1.0];
    let model = |x: &[f64], block: usize, t: f64| (x[0] * t).sin() + x[1] * x[2 + block] * t;
    let times: Vec<f64> = (1..8).map(|i| f64::from(i) * 0.2).collect();
    let noise = |block: usize, i: usize| 1e-3 * ((block * 7 + i) as f64 * 1.7).sin();
    // The product needs a second view of x[1]: the last row of each block.
    let values = |x: &[f64], block: usize| -> Vec<f64> {
        times.iter().map(|t| model(x, block, *t)).chain([x[1]]).collect()
    };
    let residuals = |x: &[f64]| -> Vec<f64> {
        (0..2)
            .flat_map(|block| {
                let pairs = values(&truth, block).into_iter().zip(values(x, block));
                let rest = pairs.enumerate().map(move |(i, (m, v))| m + noise(block, i) - v);
                rest.collect::<Vec<_>>()
            })
            .collect()
    };
    let rows = |x: &[f64]| {
        let y = residuals(x);
        let per_block = y.chunks(8).enumerate().map(|(block, y)| {
            let mut rows = Rows::zeros(8, 1, 2);
            for (i, y) in y.iter().enumerate() {
                rows.set_value(i, *y);
            }
            for (i, t) in times.iter().enumerate() {
                rows.set_common(i, 0, t * (x[0] * t).cos());
                rows.set_common(i, 1, x[2 + block] * t);
                rows.set_own(i, 0, x[1] * t);
            }
            rows.set_common(7, 1, 1.0);
            rows
        });
        per_block.collect()
    };
    let found = minimise(vec![1.3, 0.9, 1.5, -0.5], rows, residuals).unwrap();
    // At the minimum the gradient is zero: no first-order change lowers the sum of squares.
    let sum = |x: &[f64]| residuals(x).iter().map(|r| r * r).sum::<f64>();
    for j in 0..4 {
        let at = |h: f64| {
            let mut x = found.x.clone();
            x[j] += h;
            sum(&x)
        };
        assert!((at(1e-4) - at(-1e-4)).abs() < 1e-11, "{j}: {:e}", at(1e-4) - at(-1e-4));
        assert!(at(1e-4) > sum(&found.x));
    }
    assert!((found.x[0] - truth[0]).abs() < 1e-2);
}
