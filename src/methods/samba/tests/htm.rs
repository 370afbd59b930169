//! An independent model of the machine of paper 4: Eq. (2) as plain matrix products, with each error where
//! METHODS section 0 places it. It uses nothing of `kinematics`.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// Angles of B, C, S in rad.
pub type Triple = [f64; 3];

pub struct Truth {
    pub errors: BTreeMap<String, f64>,
    pub tool: Vector3<f64>,
}

fn htm(rows: [[f64; 4]; 3]) -> Matrix4<f64> {
    let [x, y, z] = rows.map(Vector4::from);
    Matrix4::from_columns(&[x, y, z, Vector4::w()]).transpose()
}

fn d_xyz(x: f64, y: f64, z: f64) -> Matrix4<f64> {
    htm([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]])
}

fn d_a(a: f64) -> Matrix4<f64> {
    let (s, c) = a.sin_cos();
    htm([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0]])
}

fn d_b(b: f64) -> Matrix4<f64> {
    let (s, c) = b.sin_cos();
    htm([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0]])
}

fn d_c(c: f64) -> Matrix4<f64> {
    let (s, c) = c.sin_cos();
    htm([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
}

impl Truth {
    fn error(&self, name: &str) -> f64 {
        self.errors.get(name).copied().unwrap_or(0.0)
    }

    /// The stylus in the table frame with the axes at `xyz` and `triple`.
    pub fn tip(&self, xyz: Vector3<f64>, [b, c, s]: Triple) -> Vector3<f64> {
        let e = |name| self.error(name);
        let workpiece = d_xyz(-xyz.x * (1.0 + e("EXX1")), 0.0, 0.0)
            * (d_a(e("EA0B")) * d_c(e("EC0B")) * d_b(-b))
            * (d_xyz(e("EX0C"), 0.0, 0.0) * d_a(e("EA0C")) * d_b(e("EB0C")) * d_c(-c));
        let tool = (d_b(e("EB0Z")) * d_xyz(0.0, 0.0, xyz.z * (1.0 + e("EZZ1"))))
            * (d_a(e("EA0Y")) * d_c(e("EC0Y")) * d_xyz(0.0, xyz.y * (1.0 + e("EYY1")), 0.0))
            * (d_xyz(e("EX0S"), e("EY0S"), 0.0) * d_c(s));
        let in_machine = tool.transform_point(&self.tool.into());
        let inverse = workpiece.try_inverse().expect("a rigid motion has an inverse");
        inverse.transform_point(&in_machine).coords
    }

    /// Axis positions with the stylus ball centre at `ball`. The solution is affine in X, Y, Z; the second
    /// step reduces rounding.
    pub fn axes_at(&self, ball: Vector3<f64>, triple: Triple) -> Vector3<f64> {
        let origin = self.tip(Vector3::zeros(), triple);
        let column = |axis: Vector3<f64>| (self.tip(axis * 100.0, triple) - origin) / 100.0;
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(column);
        let inverse = Matrix3::from_columns(&columns).try_inverse().expect("X, Y, Z span space");
        let first = inverse * (ball - origin);
        first + inverse * (ball - self.tip(first, triple))
    }
}
