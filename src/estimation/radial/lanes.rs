//! Sums over very many points of a circle or sphere for one Gauss–Newton step, several points at once.

use pulp::Arch;

/// Centre and radius of one step, and the frame of the directions. The directions are rotated and reduced by their
/// mean, so that the sums over points on a small cap lose no digits.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepFrame<const D: usize> {
    /// Point that is subtracted first: the differences of neighbouring points are exact.
    pub origin: [f64; D],
    /// Centre relative to the origin.
    pub centre: [f64; D],
    pub radius: f64,
    /// Rotation of the directions. Its rows are orthogonal unit vectors.
    pub rotation: [[f64; D]; D],
    /// Value near the mean of the rotated directions, subtracted from them.
    pub mean: [f64; D],
}

/// Sums with v: rotated direction less the frame's mean, r: distance less radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointSums<const D: usize> {
    pub v: [f64; D],
    /// Entries on and above the diagonal.
    pub vv: [[f64; D]; D],
    pub vr: [f64; D],
    pub r: f64,
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
                let (_, [distance]) = centre_offsets(std::array::from_ref(point), frame);
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
        lanes.add(chunk, frame);
    }
    let mut single = LaneSums::<D, 1>::ZERO;
    for point in rest {
        single.add(std::array::from_ref(point), frame);
    }
    lanes.total().plus(&single.total())
}

/// Sums of each lane.
struct LaneSums<const D: usize, const L: usize> {
    v: [[f64; L]; D],
    vv: [[[f64; L]; D]; D],
    vr: [[f64; L]; D],
    r: [f64; L],
}

impl<const D: usize, const L: usize> LaneSums<D, L> {
    const ZERO: Self = Self { v: [[0.0; L]; D], vv: [[[0.0; L]; D]; D], vr: [[0.0; L]; D], r: [0.0; L] };

    #[inline(always)]
    fn add(&mut self, points: &[[f64; D]; L], frame: &StepFrame<D>) {
        let (mut direction, distance) = centre_offsets(points, frame);
        let r: [f64; L] = std::array::from_fn(|l| distance[l] - frame.radius);
        for along in &mut direction {
            for l in 0..L {
                along[l] /= distance[l];
            }
        }
        let v: [[f64; L]; D] = std::array::from_fn(|row| {
            let mut turned = [-frame.mean[row]; L];
            for (along, share) in direction.iter().zip(frame.rotation[row]) {
                for l in 0..L {
                    turned[l] += share * along[l];
                }
            }
            turned
        });
        for i in 0..D {
            for j in i..D {
                add_products(&mut self.vv[i][j], &v[i], &v[j]);
            }
            add_products(&mut self.vr[i], &v[i], &r);
            add_products(&mut self.v[i], &v[i], &[1.0; L]);
        }
        add_products(&mut self.r, &r, &[1.0; L]);
    }

    fn total(&self) -> PointSums<D> {
        let sum = |lanes: [f64; L]| lanes.into_iter().sum();
        PointSums { v: self.v.map(sum), vv: self.vv.map(|row| row.map(sum)), vr: self.vr.map(sum), r: sum(self.r) }
    }
}

impl<const D: usize> PointSums<D> {
    pub const ZERO: Self = Self { v: [0.0; D], vv: [[0.0; D]; D], vr: [0.0; D], r: 0.0 };

    pub fn plus(mut self, other: &Self) -> Self {
        for i in 0..D {
            self.v[i] += other.v[i];
            self.vr[i] += other.vr[i];
            for j in 0..D {
                self.vv[i][j] += other.vv[i][j];
            }
        }
        self.r += other.r;
        self
    }
}

/// Offsets from the centre, for each coordinate and lane, and their lengths.
#[inline(always)]
fn centre_offsets<const D: usize, const L: usize>(
    points: &[[f64; D]; L],
    frame: &StepFrame<D>,
) -> ([[f64; L]; D], [f64; L]) {
    let offset: [[f64; L]; D] =
        std::array::from_fn(|k| std::array::from_fn(|l| (points[l][k] - frame.origin[k]) - frame.centre[k]));
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
