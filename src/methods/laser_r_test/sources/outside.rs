//! Sources that no unknown of the model absorbs, with declared magnitudes: squareness of X, Y and Z, form of the
//! sphere, error of the sensor on an inclined surface.

use nalgebra::Vector3;

use super::{DwellPoints, common_source};
use crate::identification::{Effect, UncertaintySource};

impl DwellPoints<'_> {
    /// Squareness errors: X moves in proportion to Y and Z, Y in proportion to Z.
    pub(super) fn squareness_source(&self) -> UncertaintySource {
        const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];
        let sigma = self.setup.plan.machine.squareness_urad * 1e-6;
        let spots = &self.grouped.spots;
        let sum: Vector3<f64> = spots.iter().map(|spot| spot.xyz).sum();
        let mean = sum / spots.len().max(1) as f64;
        let column = |(along, by): (usize, usize)| {
            let spots = spots.iter().zip(&self.normals);
            spots.map(|(spot, n)| n[along] * sigma * (spot.xyz[by] - mean[by])).collect()
        };
        UncertaintySource::new("squareness of X, Y and Z", Effect::Joint(PAIRS.map(column).into()))
    }

    /// Second-degree form error that turns with the table: the radius along a unit vector u changes by uᵀ·S·u, S
    /// symmetric and without trace, of the declared standard deviation along every u.
    pub(super) fn form_source(&self) -> UncertaintySource {
        let sigma = self.setup.settings.form_u_um * 1e-3;
        let groups = &self.grouped.groups;
        let rows = self.grouped.centres.rows.iter().zip(&self.normals);
        let outward = rows.map(|(row, normal)| groups[row.group].machine_from_table.inverse() * normal);
        let outward: Vec<Vector3<f64>> = outward.collect();
        let column = |effect: &dyn Fn(&Vector3<f64>) -> f64| outward.iter().map(|u| sigma * effect(u)).collect();
        // Variances 1 on the diagonal and 1/2 off it, less the trace: the variance along every u is 2/3.
        let own = |k: usize| column(&move |u| 1.5f64.sqrt() * (u[k] * u[k] - 1.0 / 3.0));
        let mixed = |i: usize, j: usize| column(&move |u| 3f64.sqrt() * u[i] * u[j]);
        let columns = [own(0), own(1), own(2), mixed(0, 1), mixed(0, 2), mixed(1, 2)];
        UncertaintySource::new("form of the sphere", Effect::Joint(columns.into()))
    }

    /// Reading error on a surface that is inclined to the beam: one part proportional to the squared tangent of the
    /// inclination, two proportional to the tangent along two perpendicular directions. Each has the declared
    /// standard deviation at 45°.
    pub(super) fn incidence_source(&self) -> UncertaintySource {
        let name = "lean of the surface";
        let sigma = self.setup.sensor.incidence_um * 1e-3;
        // Touches surround the sphere, where the tangent is not bounded.
        if sigma == 0.0 || self.setup.uses_touch_probe() {
            return common_source(name, Effect::Joint(Vec::new()));
        }
        let frame = self.grouped.centres.beam_frame;
        let inclinations = self.grouped.centres.rows.iter().zip(&self.normals).map(|(row, normal)| {
            let n = (row.machine_from_spindle * frame).transpose() * normal;
            // If the surface faces the beam, n is (0, 0, −1).
            [n.x / -n.z, n.y / -n.z]
        });
        let inclinations: Vec<[f64; 2]> = inclinations.collect();
        let column = |effect: fn(&[f64; 2]) -> f64| {
            let rows = inclinations.iter().zip(&self.distance_per_reading);
            rows.map(|(inclination, along)| sigma * along * effect(inclination)).collect()
        };
        let columns = [column(|[x, y]| x * x + y * y), column(|[x, _]| *x), column(|[_, y]| *y)];
        common_source(name, Effect::Joint(columns.into()))
    }
}
