//! From dwell points to the sphere's centres and the beam's direction (paper 2, Eqs. 5 and 6): the
//! light spot p = p_c + d·t lies on a sphere of known radius about q′ = q + l. The zero position l is
//! not told from the sphere's place here, and stands in the centre.
//!
//! The norm of t is left free: it is the sensor's gain. Three heights tell it and the direction; what
//! the direction is not known moves all centres alike, as all poses are scanned at one height.

use machine::frame::unit_vector;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::spots::Scanned;
use crate::identification::ObservationEquation;
use estimation::nonlinear::{Minimum, NonlinearError, minimise};
use estimation::schur::Rows;

/// Unknowns of the beam: its lean along two directions across, its gain less 1.
pub const BEAM: usize = 3;
/// Index of the gain among them.
pub const GAIN: usize = 2;

/// A dwell point of the fit.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Index of the centre.
    pub group: usize,
    /// How far the spindle stands from the table, machine frame.
    pub at: Vector3<f64>,
    /// Spindle frame to machine frame.
    pub spindle: Rotation3<f64>,
    pub value: f64,
    /// Standard uncertainty of its distance from the centre, mm.
    pub sigma: f64,
}

/// The fit of all scans.
#[derive(Debug, Clone)]
pub struct Centres {
    /// Nominal direction, and two across: columns (across, across, along), spindle frame.
    pub frame: Matrix3<f64>,
    pub radius: f64,
    /// Group after group.
    pub rows: Vec<Row>,
    pub groups: usize,
    /// Whether the beam is unknown; otherwise it is as in `held`.
    pub free: bool,
    /// Whether the radius of each scan is unknown: that of a touched sphere, with the probe's pre-travel
    /// in it.
    pub round: bool,
    pub held: [f64; BEAM],
}

/// Columns: two directions across the beam, nearly X and Y, and the beam.
pub fn frame(beam: Vector3<f64>) -> Matrix3<f64> {
    let across = unit_vector(Vector3::x() - beam * beam.x).unwrap_or(Vector3::y());
    let other = across.cross(&beam);
    // Of a beam that looks down, other is +Y.
    Matrix3::from_columns(&[across, other, beam])
}

impl Centres {
    /// Unknowns of the beam.
    pub fn common(&self) -> usize {
        if self.free { BEAM } else { 0 }
    }

    fn own(&self) -> usize {
        if self.round { 4 } else { 3 }
    }

    /// Where a centre's unknowns begin.
    pub fn first(&self, group: usize) -> usize {
        self.common() + self.own() * group
    }

    fn radius_of(&self, x: &[f64], group: usize) -> f64 {
        if self.round { x[self.first(group) + 3] } else { self.radius }
    }

    /// The beam, its norm the gain: spindle frame.
    pub fn beam(&self, x: &[f64]) -> Vector3<f64> {
        let beam = if self.free { &x[..BEAM] } else { &self.held };
        self.frame * Vector3::new(beam[0], beam[1], 1.0 + beam[2])
    }

    /// Centre of a group, machine frame as [`Row::at`].
    pub fn centre(&self, x: &[f64], group: usize) -> Vector3<f64> {
        let first = self.first(group);
        Vector3::from_column_slice(&x[first..first + 3])
    }

    /// From the centre to the light spot.
    pub fn arm(&self, x: &[f64], row: &Row) -> Vector3<f64> {
        row.at + row.spindle * (self.beam(x) * row.value) - self.centre(x, row.group)
    }

    /// Unweighted, outside the sphere: mm.
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
    /// Samples that do not fix all centres, or the beam.
    pub fn solve(&self) -> Result<Minimum, NonlinearError> {
        minimise(self.start(), |x| self.blocks(x), |x| self.weighted_change(&self.off(x)))
    }

    /// A radius behind the mean light spot.
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
            // Touches stand all around.
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

/// What the sensor says of a distance, less 1: the fit's unknown is the distance of what it says.
pub fn sensor_gain(unknown: f64) -> f64 {
    1.0 / (1.0 + unknown) - 1.0
}

/// Whether these dwell points fix a centre: not if the normals lie in one plane through it, all on one
/// great circle.
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

/// Determinant of Σn·nᵀ of a flat scan, against the greatest possible.
const FLAT: f64 = 1e-5;
