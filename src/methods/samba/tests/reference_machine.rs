//! An independent model of the machine of paper 4: Eq. (2) as plain matrix products, with each error where
//! METHODS section 0 places it. It uses nothing of `kinematics`.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// Angles of B, C, S in rad.
pub type BcsAnglesRad = [f64; 3];

pub struct ReferenceMachine {
    pub errors: BTreeMap<String, f64>,
    pub tool: Vector3<f64>,
}

fn homogeneous_matrix(rows: [[f64; 4]; 3]) -> Matrix4<f64> {
    let [x, y, z] = rows.map(Vector4::from);
    Matrix4::from_columns(&[x, y, z, Vector4::w()]).transpose()
}

fn translation_matrix(x: f64, y: f64, z: f64) -> Matrix4<f64> {
    homogeneous_matrix([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]])
}

fn rotation_about_x(a: f64) -> Matrix4<f64> {
    let (s, c) = a.sin_cos();
    homogeneous_matrix([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0]])
}

fn rotation_about_y(b: f64) -> Matrix4<f64> {
    let (s, c) = b.sin_cos();
    homogeneous_matrix([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0]])
}

fn rotation_about_z(c: f64) -> Matrix4<f64> {
    let (s, c) = c.sin_cos();
    homogeneous_matrix([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
}

impl ReferenceMachine {
    fn error_value(&self, name: &str) -> f64 {
        self.errors.get(name).copied().unwrap_or(0.0)
    }

    /// The stylus in the table frame with the axes at `xyz` and `bcs_rad`.
    pub fn tip_in_table(&self, xyz: Vector3<f64>, [b, c, s]: BcsAnglesRad) -> Vector3<f64> {
        let e = |name| self.error_value(name);
        let workpiece = translation_matrix(-xyz.x * (1.0 + e("EXX1")), 0.0, 0.0)
            * (rotation_about_x(e("EA0B")) * rotation_about_z(e("EC0B")) * rotation_about_y(-b))
            * (translation_matrix(e("EX0C"), 0.0, 0.0)
                * rotation_about_x(e("EA0C"))
                * rotation_about_y(e("EB0C"))
                * rotation_about_z(-c));
        let tool = (rotation_about_y(e("EB0Z")) * translation_matrix(0.0, 0.0, xyz.z * (1.0 + e("EZZ1"))))
            * (rotation_about_x(e("EA0Y"))
                * rotation_about_z(e("EC0Y"))
                * translation_matrix(0.0, xyz.y * (1.0 + e("EYY1")), 0.0))
            * (translation_matrix(e("EX0S"), e("EY0S"), 0.0) * rotation_about_z(s));
        let in_machine = tool.transform_point(&self.tool.into());
        let inverse = workpiece.try_inverse().expect("a rigid motion has an inverse");
        inverse.transform_point(&in_machine).coords
    }

    /// X, Y, Z that bring the centre of the stylus ball to `ball` (table frame) at the angles B, C, S. The solution is
    /// affine in X, Y, Z; the second step reduces rounding.
    pub fn axis_positions_at_ball(&self, ball: Vector3<f64>, bcs_rad: BcsAnglesRad) -> Vector3<f64> {
        let origin = self.tip_in_table(Vector3::zeros(), bcs_rad);
        let column = |axis: Vector3<f64>| (self.tip_in_table(axis * 100.0, bcs_rad) - origin) / 100.0;
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(column);
        let inverse = Matrix3::from_columns(&columns).try_inverse().expect("X, Y, Z span space");
        let first = inverse * (ball - origin);
        first + inverse * (ball - self.tip_in_table(first, bcs_rad))
    }
}
