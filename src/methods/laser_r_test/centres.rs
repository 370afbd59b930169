//! From dwell points to the sphere's centres and the beam's direction (paper 2, Eqs. 5 and 6): the light spot p =
//! p_c + d·t lies on a sphere of known radius about q′ = q + l. The zero position l is not separable from the
//! position of the sphere here and is part of the centre.
//!
//! The norm of t is left free: it is the sensor's gain. Three heights determine the gain and the direction. An
//! error of the direction shifts all centres alike, as all poses are scanned at one height.

use machine::frame::unit_vector;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::spots::Scanned;
use crate::identification::ObservationEquation;
use estimation::nonlinear::{Minimum, NonlinearError, minimise};
use estimation::schur::Rows;

/// Number of unknowns of the beam: its tilt along two perpendicular directions, and its gain less 1.
pub const BEAM: usize = 3;
/// Index of the gain among the unknowns of the beam.
pub const GAIN: usize = 2;

/// A dwell point of the fit.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Index of the centre.
    pub group: usize,
    /// Displacement of the spindle relative to the table, machine frame, mm.
    pub at: Vector3<f64>,
    /// Rotation from the spindle frame to the machine frame.
    pub spindle: Rotation3<f64>,
    pub value: f64,
    /// Standard uncertainty of the distance from the centre, mm.
    pub sigma: f64,
}

/// The fit of all scans.
#[derive(Debug, Clone)]
pub struct Centres {
    /// Nominal direction of the beam and two perpendicular directions. Columns (across, across, along), spindle
    /// frame.
    pub frame: Matrix3<f64>,
    pub radius: f64,
    /// Dwell points, group after group.
    pub rows: Vec<Row>,
    pub groups: usize,
    /// Whether the beam is unknown. If not, it is given by `held`.
    pub free: bool,
    /// Whether the radius of each scan is unknown. This is the case for a touched sphere, as the radius includes
    /// the probe's pre-travel.
    pub round: bool,
    pub held: [f64; BEAM],
}

/// Columns: two directions perpendicular to the beam (nearly X and Y), and the beam.
pub fn frame(beam: Vector3<f64>) -> Matrix3<f64> {
    let across = unit_vector(Vector3::x() - beam * beam.x).unwrap_or(Vector3::y());
    let other = across.cross(&beam);
    // For a beam that points down, `other` is +Y.
    Matrix3::from_columns(&[across, other, beam])
}

impl Centres {
    /// Number of unknowns of the beam in this fit.
    pub fn common(&self) -> usize {
        if self.free { BEAM } else { 0 }
    }

    fn own(&self) -> usize {
        if self.round { 4 } else { 3 }
    }

    /// Index of the first unknown of a centre.
    pub fn first(&self, group: usize) -> usize {
        self.common() + self.own() * group
    }

    fn radius_of(&self, x: &[f64], group: usize) -> f64 {
        if self.round { x[self.first(group) + 3] } else { self.radius }
    }

    /// Vector of the beam in the spindle frame. Its norm is the gain.
    pub fn beam(&self, x: &[f64]) -> Vector3<f64> {
        let beam = if self.free { &x[..BEAM] } else { &self.held };
        self.frame * Vector3::new(beam[0], beam[1], 1.0 + beam[2])
    }

    /// Centre of a group, machine frame, relative to the same origin as [`Row::at`].
    pub fn centre(&self, x: &[f64], group: usize) -> Vector3<f64> {
        let first = self.first(group);
        Vector3::from_column_slice(&x[first..first + 3])
    }

    /// Vector from the centre to the light spot.
    pub fn arm(&self, x: &[f64], row: &Row) -> Vector3<f64> {
        row.at + row.spindle * (self.beam(x) * row.value) - self.centre(x, row.group)
    }

    /// Distances of the dwell points from their spheres, positive outside, unweighted, mm.
    pub fn off(&self, x: &[f64]) -> Vec<f64> {
        let off = |row: &Row| self.arm(x, row).norm() - self.radius_of(x, row.group);
        self.rows.iter().map(off).collect()
    }

    fn blocks(&self, x: &[f64]) -> Vec<Rows> {
        let (common, own) = (self.common(), self.own());
        let of_group = |group: usize| {
            let rows: Vec<&Row> = self.rows.iter().filter(|row| row.group == group).collect();
            let mut block = Rows::zeros(rows.len(), own, common);
            for (i, row) in rows.into_iter().enumerate() {
                let arm = self.arm(x, row);
                let normal = unit_vector(arm).unwrap_or_default();
                block.set_value(i, (self.radius_of(x, group) - arm.norm()) / row.sigma);
                (0..3).for_each(|k| block.set_own(i, k, -normal[k] / row.sigma));
                (3..own).for_each(|k| block.set_own(i, k, -1.0 / row.sigma));
                let across = (row.spindle * self.frame).transpose() * normal * row.value;
                (0..common).for_each(|k| block.set_common(i, k, across[k] / row.sigma));
            }
            block
        };
        (0..self.groups).map(of_group).collect()
    }

    /// # Errors
    /// The samples do not determine all centres or the beam.
    pub fn solve(&self) -> Result<Minimum, NonlinearError> {
        minimise(self.start(), |x| self.blocks(x), |x| self.weighted_change(&self.off(x)))
    }

    /// Initial values: each centre is one radius behind the mean light spot.
    fn start(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.common()];
        for group in 0..self.groups {
            let rows = self.rows.iter().filter(|row| row.group == group);
            let beam = self.frame.column(2);
            let (mut sum, mut count, mut along) = (Vector3::zeros(), 0.0, Vector3::zeros());
            for row in rows {
                sum += row.at + row.spindle * beam * row.value;
                along = row.spindle * beam;
                count += 1.0;
            }
            // The touches surround the centre, so their mean is the initial value.
            let behind = if self.round { Vector3::zeros() } else { along * self.radius };
            x.extend(&(sum / count + behind));
            x.extend(self.round.then_some(self.radius));
        }
        x
    }
}

/// Observations: the distance of each dwell point from its centre.
impl ObservationEquation for Centres {
    fn observations(&self) -> usize {
        self.rows.len()
    }

    fn residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let off: Vec<f64> =
            self.off(x).iter().zip(change).map(|(off, change)| off + change).collect();
        self.weighted_change(&off)
    }

    fn weighted_change(&self, change: &[f64]) -> Vec<f64> {
        change.iter().zip(&self.rows).map(|(change, row)| -change / row.sigma).collect()
    }
}

/// Deviation of the sensor's gain (reading per distance) from 1. The unknown of the fit is the inverse: distance
/// per reading.
pub fn sensor_gain(unknown: f64) -> f64 {
    1.0 / (1.0 + unknown) - 1.0
}

/// Whether these dwell points determine a centre. They do not if all normals lie in one plane, on one great circle.
pub fn fixes_centre(scan: &Scanned, beam: Vector3<f64>, radius: f64) -> bool {
    let points = scan.spots.iter().map(|spot| spot.at + scan.spindle * beam * spot.value);
    let points: Vec<Vector3<f64>> = points.collect();
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let centre = mean + scan.spindle * beam * radius;
    let mut sum = Matrix3::zeros();
    for point in &points {
        let n = unit_vector(*point - centre).unwrap_or_default();
        sum += n * n.transpose();
    }
    points.len() >= 4 && sum.determinant() > FLAT * (points.len() as f64 / 3.0).powi(3)
}

/// Determinant of Σn·nᵀ relative to the largest possible one, below which a scan is flat.
const FLAT: f64 = 1e-5;
