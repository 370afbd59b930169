//! Least-squares fit of the rigid motion from one set of points to another.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Result of the fit: the rigid motion and the deviations that remain.
#[derive(Debug, Clone)]
pub struct RigidFit {
    /// Rotation from the points `from` to the points `to`.
    pub rotation: Rotation3<f64>,
    /// Rotated positions of the points `from` relative to their centroid.
    pub rotated_points_about_centroid: Vec<Vector3<f64>>,
    /// Points `to` less the transformed points `from`.
    pub deviations: Vec<Vector3<f64>>,
    /// Inverse of the inertia matrix of `rotated_points_about_centroid`, each with mass 1; zero if it is singular.
    inverse_inertia: Matrix3<f64>,
}

impl RigidFit {
    /// Fits by singular value decomposition of the covariance of the two sets, which have the same number of points.
    /// If the points are on one line, the rotation about this line is arbitrary.
    pub fn new(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Self {
        let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len().max(1) as f64;
        let (from_mean, to_mean) = (mean(from), mean(to));
        let pairs = from.iter().zip(to);
        let covariance: Matrix3<f64> = pairs.map(|(f, t)| (t - to_mean) * (f - from_mean).transpose()).sum();
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
        let mirror = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
        let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&mirror) * v_t);
        let arms: Vec<Vector3<f64>> = from.iter().map(|f| rotation * (f - from_mean)).collect();
        let deviations = arms.iter().zip(to).map(|(arm, t)| t - to_mean - arm).collect();
        let inertia = |arm: &Vector3<f64>| Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
        let inertia: Matrix3<f64> = arms.iter().map(inertia).sum();
        let inverse_inertia = inertia.try_inverse().unwrap_or_default();
        Self { rotation, rotated_points_about_centroid: arms, deviations, inverse_inertia }
    }

    /// Subtracts from small changes of the deviations, one per point, the part that a small translation and rotation
    /// explains. If the inertia matrix is singular, only the translation is subtracted.
    pub fn subtract_rigid_motion(&self, changes: &mut [Vector3<f64>]) {
        let mean = changes.iter().sum::<Vector3<f64>>() / changes.len().max(1) as f64;
        let moment: Vector3<f64> =
            self.rotated_points_about_centroid.iter().zip(changes.iter()).map(|(arm, change)| arm.cross(change)).sum();
        let turn = self.inverse_inertia * moment;
        for (change, arm) in changes.iter_mut().zip(&self.rotated_points_about_centroid) {
            *change -= mean + turn.cross(arm);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Corners of a box moved by a known motion, one of them 3 µm farther. The fit absorbs a part of the 3 µm, and
    /// the remaining deviations have zero mean and zero moment.
    #[test]
    fn the_motion_of_a_box_is_recovered() {
        let corner =
            |i: usize| Vector3::new((i & 1) as f64 * 100.0, (i >> 1 & 1) as f64 * 60.0, (i >> 2) as f64 * 40.0);
        let from: Vec<Vector3<f64>> = (0..8).map(corner).collect();
        let turn = Rotation3::from_euler_angles(0.3, -0.2, 1.1);
        let mut to: Vec<Vector3<f64>> = from.iter().map(|f| turn * f + Vector3::new(5.0, -7.0, 2.0)).collect();
        let exact = RigidFit::new(&from, &to);
        assert!(exact.deviations.iter().all(|d| d.norm() < 1e-12));
        assert!((exact.rotation.inverse() * turn).angle() < 1e-12);
        to[3].z += 0.003;
        let fit = RigidFit::new(&from, &to);
        let mean: Vector3<f64> = fit.deviations.iter().sum();
        let moment: Vector3<f64> =
            fit.rotated_points_about_centroid.iter().zip(&fit.deviations).map(|(arm, d)| arm.cross(d)).sum();
        assert!(mean.norm() < 1e-12 && moment.norm() < 1e-9, "{mean} {moment}");
        let mut change = vec![Vector3::zeros(); 8];
        change[3].z = 0.003;
        exact.subtract_rigid_motion(&mut change);
        let apart = change.iter().zip(&fit.deviations).map(|(a, b)| (a - b).norm());
        assert!(apart.fold(0.0, f64::max) < 1e-6);
    }
}
