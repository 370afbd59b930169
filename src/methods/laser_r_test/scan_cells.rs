//! Samples of a continuous scan, grouped by cells of axis positions, so that the fit of all scans stays small. A
//! cell holds the samples of all passes through it, forward and backward.
//!
//! The mean of samples on a sphere lies below its surface: by w²/24R along a path of w, 1.8 um for 0.65 mm on R =
//! 10 mm. Therefore the deviations of the samples from a sphere fitted to this scan alone are averaged, not the
//! samples. The remaining chord error is of third order. Cells without samples get no value.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::centre_equations::{CentreEquations, ScanPoint};
use super::measured_scan::{MeasuredScan, SampleMean};
use super::position_history::TimedSample;
use super::setup::LaserSetup;
use machine::Axis;
use machine::frame::unit_vector;

/// A motion along one line with fewer samples is reported as sparse; its samples are used.
const SPARSE_MOTION_SAMPLE_LIMIT: usize = 10;
/// Minimum cosine of the angle between a line and the velocity of a sample that counts as moving along it.
const MIN_MOTION_COSINE: f64 = 0.95;
/// A smaller width of a cell is replaced by this one, mm.
const CELL_WIDTH_FLOOR_MM: f64 = 0.01;
/// Standard uncertainty of a sample in the fit of the sphere to one scan, mm.
const SAMPLE_STD_U_IN_SPHERE_FIT_MM: f64 = 0.01;

/// One mean for each cell of this scan in the order of time, and the scatter within cells: Σ(sample − mean)² in mm²
/// with its degrees of freedom. The means in `scan` are not used.
pub fn average_samples_by_cell(
    setup: &LaserSetup<'_>,
    scan: &MeasuredScan,
    samples: &[TimedSample],
) -> (Vec<SampleMean>, (f64, usize)) {
    let mut square_sum_and_dof = (0.0, 0);
    let Some(sphere) = FittedScanSphere::fit(setup, scan, samples) else { return (Vec::new(), square_sum_and_dof) };
    let spot = |all: Vec<&TimedSample>| {
        let deviations: Vec<f64> = all.iter().map(|sample| sphere.deviation_mm(sample)).collect::<Option<_>>()?;
        let count = deviations.len() as f64;
        let mean_deviation = deviations.iter().sum::<f64>() / count;
        let mean = |pick: fn(&TimedSample) -> Vector3<f64>| all.iter().map(|s| pick(s)).sum::<Vector3<f64>>() / count;
        let xyz = mean(|sample| sample.xyz);
        let reading_mm = sphere.predicted_reading_mm(xyz)? + mean_deviation;
        square_sum_and_dof.0 += deviations.iter().map(|deviation| (deviation - mean_deviation).powi(2)).sum::<f64>();
        square_sum_and_dof.1 += deviations.len() - 1;
        Some(SampleMean {
            linear_axis_positions_mm: xyz,
            spindle_displacement_from_table_mm: sphere.machine_from_xyz * xyz,
            reading_mm,
            sample_count: deviations.len(),
            time_in_run_s: all.iter().map(|sample| sample.sensor_stamp_s).sum::<f64>() / count,
            velocity: mean(|sample| sample.velocity),
            last_motion_sign: mean(|sample| sample.last_motion_sign),
        })
    };
    let sample_means = group_by_cell(setup, samples).into_iter().filter_map(spot).collect();
    (sample_means, square_sum_and_dof)
}

/// Groups the samples of one scan by cells. The cells are in the order of time.
pub fn group_by_cell<'a>(setup: &LaserSetup<'_>, samples: &'a [TimedSample]) -> Vec<Vec<&'a TimedSample>> {
    let width = (longest_scan_side_mm(samples) / setup.settings.points.max(1) as f64).max(CELL_WIDTH_FLOOR_MM);
    let (mut cells, mut numbers) = (Vec::<Vec<&TimedSample>>::new(), BTreeMap::new());
    for sample in samples {
        let cell_index: [i64; 3] = sample.xyz.map(|mm| (mm / width).floor() as i64).into();
        let number = *numbers.entry(cell_index).or_insert(cells.len());
        match cells.get_mut(number) {
            Some(cell) => cell.push(sample),
            None => cells.push(vec![sample]),
        }
    }
    cells
}

/// Longest side of the range of the scan, mm.
fn longest_scan_side_mm(samples: &[TimedSample]) -> f64 {
    let xyz = || samples.iter().map(|sample| sample.xyz);
    let most = xyz().fold(Vector3::repeat(f64::NEG_INFINITY), |most, xyz| most.sup(&xyz));
    let least = xyz().fold(Vector3::repeat(f64::INFINITY), |least, xyz| least.inf(&xyz));
    (most - least).max()
}

/// Sphere of the stated radius whose centre is fitted to one scan alone, with the nominal beam.
pub struct FittedScanSphere {
    /// Matrix from X, Y, Z to the machine frame.
    machine_from_xyz: Matrix3<f64>,
    /// Fitted centre, machine frame; it includes the sensor's zero position.
    centre_mm: Vector3<f64>,
    radius_mm: f64,
    /// Direction of the beam, machine frame.
    beam_direction: Vector3<f64>,
}

impl FittedScanSphere {
    /// Fits the sphere to the samples of a scan. `None`: they do not determine the sphere.
    pub fn fit(setup: &LaserSetup<'_>, scan: &MeasuredScan, samples: &[TimedSample]) -> Option<Self> {
        let machine_from_spindle = scan.machine_from_spindle;
        let machine_from_xyz = setup.machine_from_xyz(&scan.rotary_positions);
        let row = |sample: &TimedSample| ScanPoint {
            group_index: 0,
            spindle_displacement_from_table_mm: machine_from_xyz * sample.xyz,
            machine_from_spindle,
            reading_mm: sample.reading_mm,
            u_mm: SAMPLE_STD_U_IN_SPHERE_FIT_MM,
        };
        let centres = CentreEquations::with_nominal_beam(setup, samples.iter().map(row).collect());
        let centre = centres.group_centre(&centres.solve().ok()?.x, 0);
        let beam = machine_from_spindle * setup.beam_direction();
        Some(Self { machine_from_xyz, centre_mm: centre, radius_mm: setup.measuring_radius_mm(), beam_direction: beam })
    }

    /// Measured minus predicted reading. `None`: the beam misses the sphere.
    pub fn deviation_mm(&self, sample: &TimedSample) -> Option<f64> {
        Some(sample.reading_mm - self.predicted_reading_mm(sample.xyz)?)
    }

    /// Reading of the sensor at these positions of X, Y, Z. `None`: the beam misses the sphere.
    fn predicted_reading_mm(&self, xyz: Vector3<f64>) -> Option<f64> {
        let from_centre = self.machine_from_xyz * xyz - self.centre_mm;
        let half = from_centre.dot(&self.beam_direction);
        let root = half * half - from_centre.norm_squared() + self.radius_mm * self.radius_mm;
        (root > 0.0).then(|| -half - root.sqrt())
    }

    /// Derivatives of [`predicted_reading_mm`](Self::predicted_reading_mm) by X, Y, Z.
    pub fn reading_gradient(&self, xyz: Vector3<f64>) -> Option<Vector3<f64>> {
        let normal =
            self.machine_from_xyz * xyz + self.beam_direction * self.predicted_reading_mm(xyz)? - self.centre_mm;
        Some(self.machine_from_xyz.transpose() * (-normal / normal.dot(&self.beam_direction)))
    }
}

/// Descriptions of the motions along `path` (X, Y, Z) that have too few samples.
pub fn describe_sparse_motions(path: &[Vector3<f64>], samples: &[TimedSample]) -> Vec<String> {
    let mut sparse: Vec<String> = Vec::new();
    for pair in path.windows(2) {
        let Some(direction) = unit_vector(pair[1] - pair[0]) else { continue };
        let along = |sample: &&TimedSample| {
            unit_vector(sample.velocity).unwrap_or_default().dot(&direction) > MIN_MOTION_COSINE
        };
        let count = samples.iter().filter(along).count();
        let description = format!("only {count} samples along {}", axis_with_sign(direction));
        if count < SPARSE_MOTION_SAMPLE_LIMIT && !sparse.contains(&description) {
            sparse.push(description);
        }
    }
    sparse
}

/// Name of the axis with the largest motion, with its sign.
fn axis_with_sign(direction: Vector3<f64>) -> String {
    let components = Axis::LINEAR.into_iter().zip(direction.iter().copied());
    let longest = components.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    longest.map_or_else(String::new, |(axis, part)| format!("{}{axis}", if part < 0.0 { '-' } else { '+' }))
}
