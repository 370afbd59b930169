//! Sums over very many points of a circle or sphere for one Gauss–Newton step, several points at once.

use pulp::Arch;

/// Centre and radius of one step, and the frame of the directions. The directions are rotated and reduced by their
/// mean, so that the sums over points on a small cap lose no digits.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepFrame<const D: usize> {
    /// Point that is subtracted first: the differences of neighbouring points are exact.
    pub origin: [f64; D],
    /// Centre relative to the origin.
    pub centre_from_origin: [f64; D],
    pub radius: f64,
    /// Rotation of the directions. Its rows are orthogonal unit vectors.
    pub rotation: [[f64; D]; D],
    /// Approximate mean of the rotated directions, which is subtracted from them.
    pub mean_direction: [f64; D],
}

/// Sums over points. Direction: the rotated direction less the frame's mean. Residual: the distance less the radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointSums<const D: usize> {
    pub direction_sum: [f64; D],
    /// Sums of products of direction components; only the entries on and above the diagonal are used.
    pub direction_product_sum: [[f64; D]; D],
    /// Sum of direction times residual.
    pub direction_residual_sum: [f64; D],
    pub residual_sum: f64,
}

/// Number of points per vector register.
const LANE_COUNT: usize = 4;

pub(super) fn sum_points<const D: usize>(points: &[[f64; D]], frame: &StepFrame<D>) -> PointSums<D> {
    Arch::new().dispatch(
        #[inline(always)]
        || sum_points_in_lanes(points, frame),
    )
}

/// Computes the distances from the centre less the radius.
pub(super) fn compute_residuals<const D: usize>(points: &[[f64; D]], frame: &StepFrame<D>, residuals: &mut [f64]) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
            for (point, residual) in points.iter().zip(residuals) {
                let (_, [distance]) = offsets_and_distances_from_centre(std::array::from_ref(point), frame);
                *residual = distance - frame.radius;
            }
        },
    );
}

#[inline(always)]
fn sum_points_in_lanes<const D: usize>(points: &[[f64; D]], frame: &StepFrame<D>) -> PointSums<D> {
    let (whole, rest) = points.as_chunks::<LANE_COUNT>();
    let mut lanes = LaneSums::<D, LANE_COUNT>::ZERO;
    for chunk in whole {
        lanes.add_points(chunk, frame);
    }
    let mut single = LaneSums::<D, 1>::ZERO;
    for point in rest {
        single.add_points(std::array::from_ref(point), frame);
    }
    lanes.sum_over_lanes().plus(&single.sum_over_lanes())
}

/// The sums of `PointSums`, one for each lane.
struct LaneSums<const D: usize, const L: usize> {
    direction_sum: [[f64; L]; D],
    direction_product_sum: [[[f64; L]; D]; D],
    direction_residual_sum: [[f64; L]; D],
    residual_sum: [f64; L],
}

impl<const D: usize, const L: usize> LaneSums<D, L> {
    const ZERO: Self = Self {
        direction_sum: [[0.0; L]; D],
        direction_product_sum: [[[0.0; L]; D]; D],
        direction_residual_sum: [[0.0; L]; D],
        residual_sum: [0.0; L],
    };

    #[inline(always)]
    fn add_points(&mut self, points: &[[f64; D]; L], frame: &StepFrame<D>) {
        let (mut direction, distance) = offsets_and_distances_from_centre(points, frame);
        let r: [f64; L] = std::array::from_fn(|l| distance[l] - frame.radius);
        for along in &mut direction {
            for l in 0..L {
                along[l] /= distance[l];
            }
        }
        let v: [[f64; L]; D] = std::array::from_fn(|row| {
            let mut turned = [-frame.mean_direction[row]; L];
            for (along, share) in direction.iter().zip(frame.rotation[row]) {
                for l in 0..L {
                    turned[l] += share * along[l];
                }
            }
            turned
        });
        for i in 0..D {
            for j in i..D {
                add_products(&mut self.direction_product_sum[i][j], &v[i], &v[j]);
            }
            add_products(&mut self.direction_residual_sum[i], &v[i], &r);
            add_products(&mut self.direction_sum[i], &v[i], &[1.0; L]);
        }
        add_products(&mut self.residual_sum, &r, &[1.0; L]);
    }

    fn sum_over_lanes(&self) -> PointSums<D> {
        let sum = |lanes: [f64; L]| lanes.into_iter().sum();
        PointSums {
            direction_sum: self.direction_sum.map(sum),
            direction_product_sum: self.direction_product_sum.map(|row| row.map(sum)),
            direction_residual_sum: self.direction_residual_sum.map(sum),
            residual_sum: sum(self.residual_sum),
        }
    }
}

impl<const D: usize> PointSums<D> {
    pub const ZERO: Self = Self {
        direction_sum: [0.0; D],
        direction_product_sum: [[0.0; D]; D],
        direction_residual_sum: [0.0; D],
        residual_sum: 0.0,
    };

    pub fn plus(mut self, other: &Self) -> Self {
        for i in 0..D {
            self.direction_sum[i] += other.direction_sum[i];
            self.direction_residual_sum[i] += other.direction_residual_sum[i];
            for j in 0..D {
                self.direction_product_sum[i][j] += other.direction_product_sum[i][j];
            }
        }
        self.residual_sum += other.residual_sum;
        self
    }
}

/// Offsets of the points from the centre, for each coordinate and lane, and the distances.
#[inline(always)]
fn offsets_and_distances_from_centre<const D: usize, const L: usize>(
    points: &[[f64; D]; L],
    frame: &StepFrame<D>,
) -> ([[f64; L]; D], [f64; L]) {
    let offset: [[f64; L]; D] = std::array::from_fn(|k| {
        std::array::from_fn(|l| (points[l][k] - frame.origin[k]) - frame.centre_from_origin[k])
    });
    let mut square = [0.0; L];
    for along in &offset {
        add_products(&mut square, along, along);
    }
    (offset, square.map(f64::sqrt))
}

#[inline(always)]
fn add_products<const L: usize>(sums: &mut [f64; L], a: &[f64; L], b: &[f64; L]) {
    for l in 0..L {
        sums[l] += a[l] * b[l];
    }
}
