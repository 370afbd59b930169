//! The axis position as ISO 230-7 has it: the least-squares circle through the positions of
//! E_total, beside the mean that is the default.

use faer::Mat;

use super::parts::Parts;
use estimation::circle::{Circle, fit_circle};

pub struct AxisCircle {
    /// E_total at each angle of C, first height, mm.
    pub points: Vec<[f64; 2]>,
    pub fitted: Circle,
    /// Standard uncertainty of the centre, mm.
    pub u: [f64; 2],
}

/// `None` where no circle can be fitted: an axis without offset leaves only scatter.
pub fn axis_circle(parts: &Parts<'_>) -> Option<AxisCircle> {
    let (layout, x) = (&parts.fit.layout, &parts.solved.x);
    let points: Vec<[f64; 2]> =
        (0..layout.design.n).map(|i| [x[layout.ex(0, i)], x[layout.ey(0, i)]]).collect();
    let fitted = fit_circle(&points).ok()?;
    let u = circle_uncertainty(parts, &points)?;
    Some(AxisCircle { points, fitted, u })
}

/// Standard uncertainty of the circle's centre by first-order propagation of the covariance of its
/// points (numerical derivative of the fit).
fn circle_uncertainty(parts: &Parts<'_>, points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let n = points.len();
    let start = |symbol: &str| {
        let before = parts.functions.iter().take_while(|f| f.symbol != symbol);
        parts.parameters.len() + before.map(|f| f.points.len()).sum::<usize>()
    };
    let suffix = parts.functions.first()?.symbol.strip_prefix("EXC_total")?;
    let (first_x, first_y) =
        (start(&format!("EXC_total{suffix}")), start(&format!("EYC_total{suffix}")));
    let step = 1e-6;
    let mut slopes = Mat::<f64>::zeros(2, 2 * n);
    for j in 0..2 * n {
        let moved = |by: f64| {
            let mut moved = points.to_vec();
            moved[j % n][j / n] += by;
            fit_circle(&moved).ok()
        };
        let (up, down) = (moved(step)?, moved(-step)?);
        for i in 0..2 {
            slopes[(i, j)] = (up.centre[i] - down.centre[i]) / (2.0 * step);
        }
    }
    let place = |j: usize| if j < n { first_x + j } else { first_y + j - n };
    let of_points =
        Mat::from_fn(2 * n, 2 * n, |i, j| parts.propagated.covariance[(place(i), place(j))]);
    let variance = &slopes * of_points * slopes.transpose();
    Some([variance[(0, 0)].max(0.0).sqrt(), variance[(1, 1)].max(0.0).sqrt()])
}
