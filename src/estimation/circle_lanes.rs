//! Least-squares circles of many point sets at once, for Monte Carlo.

use pulp::{Arch, Simd, WithSimd};

/// Fits the least-squares (Gauss) circle of ISO 230-7 to every lane: point p of set i is
/// `(x[p][i], y[p][i])`. Writes centre and radius of set i to element i of `circles`.
///
/// Algebraic start, then `steps` undamped Gauss–Newton steps (4 suffice for sets that look like a
/// circle at all; [`fit_circle`](super::circle::fit_circle) is the careful way). Where there is no
/// circle the result is not a number. All slices have the same length; what is longer is ignored.
pub fn fit_circles(x: &[&[f64]], y: &[&[f64]], steps: usize, circles: [&mut [f64]; 3]) {
    Arch::new().dispatch(Fit { x, y, steps, circles });
}

struct Fit<'a> {
    x: &'a [&'a [f64]],
    y: &'a [&'a [f64]],
    steps: usize,
    circles: [&'a mut [f64]; 3],
}

impl WithSimd for Fit<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let shortest = self.x.iter().chain(self.y).map(|column| column.len()).min().unwrap_or(0);
        let sets = self.circles.iter().map(|column| column.len()).fold(shortest, usize::min);
        let [cx, cy, radius] = self.circles;
        for start in (0..sets).step_by(S::F64_LANES) {
            let lanes = start..sets.min(start + S::F64_LANES);
            let point = |p: usize| {
                let of = |columns: &[&[f64]]| load(simd, &columns[p][lanes.clone()]);
                [of(self.x), of(self.y)]
            };
            let points = self.x.len().min(self.y.len());
            let circle = fit(simd, points, point, self.steps);
            simd.partial_store_f64s(&mut cx[lanes.clone()], circle[0]);
            simd.partial_store_f64s(&mut cy[lanes.clone()], circle[1]);
            simd.partial_store_f64s(&mut radius[lanes.clone()], circle[2]);
        }
    }
}

/// A full register where there are enough values, else what there is and zeros.
#[inline(always)]
fn load<S: Simd>(simd: S, values: &[f64]) -> S::f64s {
    let (full, _) = S::as_simd_f64s(values);
    full.first().copied().unwrap_or_else(|| simd.partial_load_f64s(values))
}

#[inline(always)]
fn fit<S: Simd>(
    simd: S,
    points: usize,
    point: impl Fn(usize) -> [S::f64s; 2],
    steps: usize,
) -> [S::f64s; 3] {
    let [mut cx, mut cy] = algebraic_centre(simd, points, &point);
    let (zero, share) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0 / points as f64));
    // A point on the centre has no direction; so it divides by a tiny number, not by 0.
    let tiny = simd.splat_f64s(f64::MIN_POSITIVE);
    let mut radius = zero;
    for step in 0..=steps {
        let mut normal = Normal::new(simd);
        let (mut ux_sum, mut uy_sum, mut distances) = (zero, zero, zero);
        for p in 0..points {
            let [x, y] = point(p);
            let (dx, dy) = (simd.sub_f64s(x, cx), simd.sub_f64s(y, cy));
            let yy = simd.mul_add_e_f64s(dy, dy, tiny);
            let distance = simd.sqrt_f64s(simd.mul_add_e_f64s(dx, dx, yy));
            distances = simd.add_f64s(distances, distance);
            if step == steps {
                continue;
            }
            let inverse = simd.div_f64s(simd.splat_f64s(1.0), distance);
            let (ux, uy) = (simd.mul_f64s(dx, inverse), simd.mul_f64s(dy, inverse));
            (ux_sum, uy_sum) = (simd.add_f64s(ux_sum, ux), simd.add_f64s(uy_sum, uy));
            // The direction times the distance is the offset itself.
            normal.add(simd, ux, uy, [dx, dy]);
        }
        radius = simd.mul_f64s(distances, share);
        if step < steps {
            // Directions and distances less their means: the radius is eliminated.
            let (mx, my) = (simd.mul_f64s(ux_sum, share), simd.mul_f64s(uy_sum, share));
            normal.reduce(simd, [ux_sum, uy_sum], [mx, my], distances);
            let [sx, sy] = normal.solve(simd);
            (cx, cy) = (simd.add_f64s(cx, sx), simd.add_f64s(cy, sy));
        }
    }
    [cx, cy, radius]
}

/// Minimiser of Σ(|p − c|² − r²)², on points reduced to their mean (Kåsa 1976).
#[inline(always)]
fn algebraic_centre<S: Simd>(
    simd: S,
    points: usize,
    point: &impl Fn(usize) -> [S::f64s; 2],
) -> [S::f64s; 2] {
    let share = simd.splat_f64s(1.0 / points as f64);
    let zero = simd.splat_f64s(0.0);
    let (mut mx, mut my) = (zero, zero);
    for p in 0..points {
        let [x, y] = point(p);
        (mx, my) = (simd.add_f64s(mx, x), simd.add_f64s(my, y));
    }
    (mx, my) = (simd.mul_f64s(mx, share), simd.mul_f64s(my, share));
    let half = simd.splat_f64s(0.5);
    let mut normal = Normal::new(simd);
    for p in 0..points {
        let [x, y] = point(p);
        let (x, y) = (simd.sub_f64s(x, mx), simd.sub_f64s(y, my));
        let square = simd.mul_add_e_f64s(x, x, simd.mul_f64s(y, y));
        let value = simd.mul_f64s(half, square);
        normal.add(simd, x, y, [simd.mul_f64s(x, value), simd.mul_f64s(y, value)]);
    }
    let [x, y] = normal.solve(simd);
    [simd.add_f64s(mx, x), simd.add_f64s(my, y)]
}

/// Normal equations of two unknowns in every lane.
struct Normal<S: Simd> {
    xx: S::f64s,
    xy: S::f64s,
    yy: S::f64s,
    right: [S::f64s; 2],
}

impl<S: Simd> Normal<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = simd.splat_f64s(0.0);
        Self { xx: zero, xy: zero, yy: zero, right: [zero; 2] }
    }

    #[inline(always)]
    fn add(&mut self, simd: S, x: S::f64s, y: S::f64s, right: [S::f64s; 2]) {
        self.xx = simd.mul_add_e_f64s(x, x, self.xx);
        self.xy = simd.mul_add_e_f64s(x, y, self.xy);
        self.yy = simd.mul_add_e_f64s(y, y, self.yy);
        self.right[0] = simd.add_f64s(self.right[0], right[0]);
        self.right[1] = simd.add_f64s(self.right[1], right[1]);
    }

    /// Takes the means out: sums of products less sum × mean.
    #[inline(always)]
    fn reduce(&mut self, simd: S, sum: [S::f64s; 2], mean: [S::f64s; 2], values: S::f64s) {
        self.xx = simd.sub_f64s(self.xx, simd.mul_f64s(sum[0], mean[0]));
        self.xy = simd.sub_f64s(self.xy, simd.mul_f64s(sum[0], mean[1]));
        self.yy = simd.sub_f64s(self.yy, simd.mul_f64s(sum[1], mean[1]));
        self.right[0] = simd.sub_f64s(self.right[0], simd.mul_f64s(values, mean[0]));
        self.right[1] = simd.sub_f64s(self.right[1], simd.mul_f64s(values, mean[1]));
    }

    #[inline(always)]
    fn solve(&self, simd: S) -> [S::f64s; 2] {
        let cross = |a, b, c, d| simd.sub_f64s(simd.mul_f64s(a, b), simd.mul_f64s(c, d));
        let [x, y] = self.right;
        let inverse =
            simd.div_f64s(simd.splat_f64s(1.0), cross(self.xx, self.yy, self.xy, self.xy));
        [
            simd.mul_f64s(cross(x, self.yy, y, self.xy), inverse),
            simd.mul_f64s(cross(y, self.xx, x, self.xy), inverse),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circle::fit_circle;

    /// Eleven sets (not a multiple of any lane count) against the careful scalar fit.
    #[test]
    fn regress_lanes_agree_with_the_scalar_fit() {
        let sets = 11;
        let coordinate = |p: usize, i: usize, turn: f64| {
            let angle = 0.8 * p as f64 + 0.3 * i as f64 + turn;
            angle.cos() * (2.0 + 0.1 * ((p * 7 + i * 3) % 5) as f64) + i as f64 - 3.0 * turn
        };
        let column = |p: usize, turn: f64| -> Vec<f64> {
            (0..sets).map(|i| coordinate(p, i, turn)).collect()
        };
        let x: Vec<Vec<f64>> = (0..8).map(|p| column(p, 0.0)).collect();
        let y: Vec<Vec<f64>> = (0..8).map(|p| column(p, -std::f64::consts::FRAC_PI_2)).collect();
        let xs: Vec<&[f64]> = x.iter().map(Vec::as_slice).collect();
        let ys: Vec<&[f64]> = y.iter().map(Vec::as_slice).collect();
        let (mut cx, mut cy, mut radius) = ([0.0; 11], [0.0; 11], [0.0; 11]);
        fit_circles(&xs, &ys, 12, [&mut cx, &mut cy, &mut radius]);
        for i in 0..sets {
            let points: Vec<[f64; 2]> = (0..8).map(|p| [x[p][i], y[p][i]]).collect();
            let careful = fit_circle(&points).unwrap();
            assert!((careful.centre[0] - cx[i]).abs() < 1e-9, "{i}");
            assert!((careful.centre[1] - cy[i]).abs() < 1e-9, "{i}");
            assert!((careful.radius - radius[i]).abs() < 1e-9, "{i}");
        }
    }
}
