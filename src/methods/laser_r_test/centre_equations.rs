//! From dwell points to the sphere's centres and the beam's direction (paper 2, Eqs. 5 and 6): the light spot p =
//! p_c + d·t lies on a sphere of known radius about q′ = q + l. The zero position l is not separable from the
//! position of the sphere here and is part of the centre.
//!
//! The norm of t is left free: it is the sensor's gain. Three heights determine the gain and the direction. An
//! error of the direction shifts all centres alike, as all poses are scanned at one height.

use machine::frame::unit_vector;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::measured_scan::{MeasuredScan, SampleMean};
use super::setup::LaserSetup;
use crate::identification::ObservationEquation;
use estimation::nonlinear_least_squares::{NonlinearError, NonlinearSolution, minimise_squares};
use estimation::schur::BlockRows;

/// Number of unknowns of the beam: its tilt along two perpendicular directions, and the distance per reading minus 1.
pub const BEAM_UNKNOWN_COUNT: usize = 3;
/// Index of the distance per reading minus 1 among the unknowns of the beam. It is the inverse of the sensor's gain:
/// [`gain_deviation`] converts it.
pub const BEAM_DISTANCE_PER_READING_INDEX: usize = 2;

/// A dwell point of the fit.
#[derive(Debug, Clone, Copy)]
pub struct ScanPoint {
    /// Index of the group of scans. All scans of a group have one centre.
    pub group_index: usize,
    /// Displacement of the spindle relative to the table, machine frame, mm.
    pub spindle_displacement_from_table_mm: Vector3<f64>,
    /// Rotation from the spindle frame to the machine frame.
    pub machine_from_spindle: Rotation3<f64>,
    /// Reading of the sensor, mm; 0 for a touch.
    pub reading_mm: f64,
    /// Standard uncertainty of the distance from the centre, mm.
    pub u_mm: f64,
}

/// The fit of all scans.
#[derive(Debug, Clone)]
pub struct CentreEquations {
    /// Nominal direction of the beam and two perpendicular directions. Columns (across, across, along), spindle
    /// frame.
    pub beam_frame: Matrix3<f64>,
    /// Stated distance from the centre to the measured points, mm; for touches with the radius of the stylus ball, and
    /// the initial value of the unknown radius.
    pub radius_mm: f64,
    /// Dwell points, group after group.
    pub scan_points: Vec<ScanPoint>,
    pub group_count: usize,
    /// Whether the beam is unknown. Otherwise `fixed_beam_values` gives the beam.
    pub is_beam_free: bool,
    /// Whether the radius of each scan is unknown. This is the case for a touched sphere, as the radius includes
    /// the probe's pre-travel.
    pub is_radius_free: bool,
    /// Values of the beam unknowns if the beam is not free.
    pub fixed_beam_values: [f64; BEAM_UNKNOWN_COUNT],
}

/// Columns: two directions perpendicular to the beam (nearly X and Y), and the beam.
fn beam_frame(beam: Vector3<f64>) -> Matrix3<f64> {
    let across = unit_vector(Vector3::x() - beam * beam.x).unwrap_or(Vector3::y());
    let second = across.cross(&beam);
    // For a beam that points down, `second` is +Y.
    Matrix3::from_columns(&[across, second, beam])
}

impl CentreEquations {
    /// The fit of one group, with the nominal beam and the stated radius.
    pub fn with_nominal_beam(setup: &LaserSetup<'_>, dwell_points: Vec<ScanPoint>) -> Self {
        Self {
            beam_frame: beam_frame(setup.beam_direction()),
            radius_mm: setup.measuring_radius_mm(),
            scan_points: dwell_points,
            group_count: 1,
            is_beam_free: false,
            is_radius_free: false,
            fixed_beam_values: [0.0; BEAM_UNKNOWN_COUNT],
        }
    }

    /// Number of unknowns of the beam in this fit.
    pub fn beam_unknown_count(&self) -> usize {
        if self.is_beam_free { BEAM_UNKNOWN_COUNT } else { 0 }
    }

    fn unknowns_per_centre(&self) -> usize {
        if self.is_radius_free { 4 } else { 3 }
    }

    /// Index of the first unknown of a centre.
    pub fn first_unknown_index(&self, group: usize) -> usize {
        self.beam_unknown_count() + self.unknowns_per_centre() * group
    }

    fn group_radius_mm(&self, x: &[f64], group: usize) -> f64 {
        if self.is_radius_free { x[self.first_unknown_index(group) + 3] } else { self.radius_mm }
    }

    /// Vector of the beam in the spindle frame. Its norm is the distance per reading, the inverse of the sensor's
    /// gain.
    pub fn beam_vector(&self, x: &[f64]) -> Vector3<f64> {
        let beam = if self.is_beam_free { &x[..BEAM_UNKNOWN_COUNT] } else { &self.fixed_beam_values };
        self.beam_frame * Vector3::new(beam[0], beam[1], 1.0 + beam[2])
    }

    /// Centre of a group, machine frame, relative to the same origin as the displacements of its dwell points.
    pub fn group_centre(&self, x: &[f64], group: usize) -> Vector3<f64> {
        let first = self.first_unknown_index(group);
        Vector3::from_column_slice(&x[first..first + 3])
    }

    /// Vector from the centre of the sphere to the light spot, or to the stylus centre of a touch; machine frame, mm.
    pub fn centre_to_spot(&self, x: &[f64], row: &ScanPoint) -> Vector3<f64> {
        row.spindle_displacement_from_table_mm + row.machine_from_spindle * (self.beam_vector(x) * row.reading_mm)
            - self.group_centre(x, row.group_index)
    }

    /// Distances of the dwell points from their spheres, positive outside, unweighted, mm.
    pub fn surface_deviations_mm(&self, x: &[f64]) -> Vec<f64> {
        let deviation = |row: &ScanPoint| self.centre_to_spot(x, row).norm() - self.group_radius_mm(x, row.group_index);
        self.scan_points.iter().map(deviation).collect()
    }

    /// Linearised, weighted rows at the unknowns `x`, one block per group; the beam is common to all blocks.
    fn row_blocks(&self, x: &[f64]) -> Vec<BlockRows> {
        let (common, own) = (self.beam_unknown_count(), self.unknowns_per_centre());
        let group_rows = |group: usize| {
            let rows: Vec<&ScanPoint> = self.scan_points.iter().filter(|row| row.group_index == group).collect();
            let mut block = BlockRows::zeros(rows.len(), own, common);
            for (i, row) in rows.into_iter().enumerate() {
                let arm = self.centre_to_spot(x, row);
                let normal = unit_vector(arm).unwrap_or_default();
                block.set_right_side(i, (self.group_radius_mm(x, group) - arm.norm()) / row.u_mm);
                (0..3).for_each(|k| block.set_own_coefficient(i, k, -normal[k] / row.u_mm));
                (3..own).for_each(|k| block.set_own_coefficient(i, k, -1.0 / row.u_mm));
                let across = (row.machine_from_spindle * self.beam_frame).transpose() * normal * row.reading_mm;
                (0..common).for_each(|k| block.set_common_coefficient(i, k, across[k] / row.u_mm));
            }
            block
        };
        (0..self.group_count).map(group_rows).collect()
    }

    /// # Errors
    /// The samples do not determine all centres or the beam.
    pub fn solve(&self) -> Result<NonlinearSolution, NonlinearError> {
        minimise_squares(
            self.initial_values(),
            |x| self.row_blocks(x),
            |x| self.weighted_residual_change(&self.surface_deviations_mm(x)),
        )
    }

    /// Initial values: each centre is one radius behind the mean light spot.
    fn initial_values(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.beam_unknown_count()];
        let beam = self.beam_frame.column(2);
        for group in 0..self.group_count {
            let (mut sum, mut count, mut along) = (Vector3::zeros(), 0.0, Vector3::zeros());
            for row in self.scan_points.iter().filter(|row| row.group_index == group) {
                sum += row.spindle_displacement_from_table_mm + row.machine_from_spindle * beam * row.reading_mm;
                along = row.machine_from_spindle * beam;
                count += 1.0;
            }
            // The touches surround the centre, so their mean is the initial value.
            let centre_offset = if self.is_radius_free { Vector3::zeros() } else { along * self.radius_mm };
            x.extend(&(sum / count + centre_offset));
            x.extend(self.is_radius_free.then_some(self.radius_mm));
        }
        x
    }
}

/// Observations: the distance of each dwell point from its centre.
impl ObservationEquation for CentreEquations {
    fn observation_count(&self) -> usize {
        self.scan_points.len()
    }

    fn weighted_residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let deviations: Vec<f64> =
            self.surface_deviations_mm(x).iter().zip(change).map(|(deviation, change)| deviation + change).collect();
        self.weighted_residual_change(&deviations)
    }

    fn weighted_residual_change(&self, change: &[f64]) -> Vec<f64> {
        change.iter().zip(&self.scan_points).map(|(change, row)| -change / row.u_mm).collect()
    }
}

/// Deviation of the sensor's gain (reading per distance) from 1. The unknown of the fit is the inverse: distance
/// per reading.
pub fn gain_deviation(unknown: f64) -> f64 {
    1.0 / (1.0 + unknown) - 1.0
}

/// Whether these dwell points determine a centre. They do not if there are fewer than four, or if all normals lie in
/// one plane, on one great circle.
pub fn determines_centre(scan: &MeasuredScan, beam: Vector3<f64>, radius: f64) -> bool {
    let light_spot = |spot: &SampleMean| {
        spot.spindle_displacement_from_table_mm + scan.machine_from_spindle * beam * spot.reading_mm
    };
    let points: Vec<Vector3<f64>> = scan.sample_means.iter().map(light_spot).collect();
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let centre = mean + scan.machine_from_spindle * beam * radius;
    let mut sum = Matrix3::zeros();
    for point in &points {
        let n = unit_vector(*point - centre).unwrap_or_default();
        sum += n * n.transpose();
    }
    points.len() >= 4 && sum.determinant() > MIN_NORMAL_DETERMINANT * (points.len() as f64 / 3.0).powi(3)
}

/// Minimum determinant of Σn·nᵀ relative to the largest possible one. Below it a scan counts as flat.
const MIN_NORMAL_DETERMINANT: f64 = 1e-5;
