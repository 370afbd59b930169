//! The machine of paper 4 a second way: Eq. (2) as plain matrix products, each error where METHODS
//! section 0 puts it. Nothing of `kinematics`.

use std::collections::BTreeMap;

use glam::{DMat3, DMat4, DVec3, DVec4};

/// B, C, S in rad.
pub type Triple = [f64; 3];

pub struct Truth {
    pub errors: BTreeMap<String, f64>,
    pub tool: DVec3,
}

fn htm(rows: [[f64; 4]; 3]) -> DMat4 {
    let [x, y, z] = rows.map(DVec4::from_array);
    DMat4::from_cols(x, y, z, DVec4::W).transpose()
}

fn d_xyz(x: f64, y: f64, z: f64) -> DMat4 {
    htm([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]])
}

fn d_a(a: f64) -> DMat4 {
    let (s, c) = a.sin_cos();
    htm([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0]])
}

fn d_b(b: f64) -> DMat4 {
    let (s, c) = b.sin_cos();
    htm([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0]])
}

fn d_c(c: f64) -> DMat4 {
    let (s, c) = c.sin_cos();
    htm([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
}

impl Truth {
    fn error(&self, name: &str) -> f64 {
        self.errors.get(name).copied().unwrap_or(0.0)
    }

    /// The stylus on the table with the axes at `xyz` and `triple`.
    pub fn tip(&self, xyz: DVec3, [b, c, s]: Triple) -> DVec3 {
        let e = |name| self.error(name);
        let workpiece = d_xyz(-xyz.x * (1.0 + e("EXX1")), 0.0, 0.0)
            * (d_a(e("EA0B")) * d_c(e("EC0B")) * d_b(-b))
            * (d_xyz(e("EX0C"), 0.0, 0.0) * d_a(e("EA0C")) * d_b(e("EB0C")) * d_c(-c));
        let tool = (d_b(e("EB0Z")) * d_xyz(0.0, 0.0, xyz.z * (1.0 + e("EZZ1"))))
            * (d_a(e("EA0Y")) * d_c(e("EC0Y")) * d_xyz(0.0, xyz.y * (1.0 + e("EYY1")), 0.0))
            * (d_xyz(e("EX0S"), e("EY0S"), 0.0) * d_c(s));
        let in_machine = tool.transform_point3(self.tool);
        let turn = DMat3::from_mat4(workpiece);
        turn.transpose() * (in_machine - workpiece.w_axis.truncate())
    }

    /// Where the axes stand with the stylus-ball centre at `ball`: affine in X, Y, Z, twice for rounding.
    pub fn axes_at(&self, ball: DVec3, triple: Triple) -> DVec3 {
        let origin = self.tip(DVec3::ZERO, triple);
        let column = |axis: DVec3| (self.tip(axis * 100.0, triple) - origin) / 100.0;
        let [x, y, z] = DVec3::AXES.map(column);
        let inverse = DMat3::from_cols(x, y, z).inverse();
        let first = inverse * (ball - origin);
        first + inverse * (ball - self.tip(first, triple))
    }
}
