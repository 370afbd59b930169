//! Grouping of the scans that measure the same centre.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::centre_equations::{CentreEquations, ScanPoint, determines_centre};
use super::measured_scan::{MeasuredScan, SampleMean};
use super::observe::ObservedScans;
use super::scan_purpose::ScanPurpose;
use super::settings::count_different_heights;
use super::setup::LaserSetup;
use super::sphere_model::with_linear_axes;
use crate::MethodRefusal;
use crate::identification::declared_sources;
use machine::{Axis, Position};

/// Assumed standard deviation of one sample if none is declared or observed, mm.
const DEFAULT_SAMPLE_STD_DEV_MM: f64 = 1e-3;
/// A smaller standard uncertainty of a dwell point is replaced by this one, which limits its weight, mm.
const SCAN_POINT_STD_U_FLOOR_MM: f64 = 1e-6;

/// Pose of a group of scans that determine one centre of the sphere.
#[derive(Debug, Clone)]
pub struct PoseGroup {
    /// Label of the first scan of the group.
    pub label: String,
    /// Positions of all rotary axes.
    pub rotary: Position,
    /// Matrix from X, Y, Z to the displacement of the spindle relative to the table, machine frame.
    pub machine_from_xyz: Matrix3<f64>,
    /// Inverse of `machine_from_xyz`.
    pub xyz_from_machine: Matrix3<f64>,
    /// Rotation from the table frame to the machine frame.
    pub machine_from_table: Rotation3<f64>,
}

/// Equations for the centres. A row is a dwell point or a cell.
pub struct GroupedScans {
    pub groups: Vec<PoseGroup>,
    pub centre_equations: CentreEquations,
    /// Axis positions, samples and time of each row.
    pub sample_means: Vec<SampleMean>,
    /// For each row, the index of its scan in [`ObservedScans::scans`] and of the dwell point in the scan, from 0.
    pub row_scan_and_point_indices: Vec<(usize, usize)>,
    /// Largest number of different heights in one group. Three or more determine the beam.
    pub max_heights_per_group: usize,
}

/// Standard deviation of one sample, mm: declared, or else observed; with continuous scans the larger of both.
pub fn sample_std_dev_mm(setup: &LaserSetup<'_>, observed: &ObservedScans) -> f64 {
    let declared = setup.sensor.noise_um.map(|um| um * 1e-3);
    let observed_mm = observed.sample_scatter_mm();
    match (declared, observed_mm, &observed.latency) {
        // In motion, the jitter of both clocks adds to the scatter.
        (Some(declared), Some(observed_mm), Some(_)) => declared.max(observed_mm),
        _ => declared.or(observed_mm).unwrap_or(DEFAULT_SAMPLE_STD_DEV_MM),
    }
}

/// A group with its scans and their indices.
type GroupWithScans<'a> = (PoseGroup, Vec<(usize, &'a MeasuredScan)>);

/// Groups the scans: those for the beam direction at one pose share a group, each other scan is a group of its own.
/// Search and latency scans, and dwell scans beside continuous ones, are used only if there are no others. Scans that
/// do not determine a centre are removed and reported in `skipped_scans`.
///
/// # Errors
/// No scan is left, or the linear axes do not span space.
pub fn group_scans(setup: &LaserSetup<'_>, observed: &mut ObservedScans) -> Result<GroupedScans, MethodRefusal> {
    let radius = setup.measuring_radius_mm();
    let is_flat = |scan: &MeasuredScan| !determines_centre(scan, setup.beam_direction(), radius);
    let flat_scans = observed.scans.extract_if(.., |scan| is_flat(scan)).map(|scan| {
        format!("{}: the samples lie nearly on one great circle and do not determine the centre", scan.label)
    });
    observed.skipped_scans.extend(flat_scans);
    // Scans used for the latency are not used a second time. If there are continuous scans, dwell scans are not
    // used either: their lost motion is unknown.
    let has_continuous = observed.latency.is_some();
    let is_dwell = |scan: &MeasuredScan| scan.sample_means.iter().all(|spot| spot.velocity == Vector3::zeros());
    let is_auxiliary = |scan: &MeasuredScan| {
        matches!(scan.purpose, ScanPurpose::Search | ScanPurpose::Latency) || has_continuous && is_dwell(scan)
    };
    let has_pose_scans = observed.scans.iter().any(|scan| !is_auxiliary(scan));
    let all = observed.scans.iter().enumerate();
    let used = all.filter(|(_, scan)| !has_pose_scans || !is_auxiliary(scan));
    let mut members: Vec<GroupWithScans<'_>> = Vec::new();
    for (index, scan) in used {
        let is_same_pose = |(group, scans): &&mut GroupWithScans<'_>| {
            scan.purpose == ScanPurpose::BeamDirection
                && scans.iter().all(|(_, other)| other.purpose == ScanPurpose::BeamDirection)
                && group.rotary == scan.rotary_positions
        };
        match members.iter_mut().find(is_same_pose) {
            Some((_, scans)) => scans.push((index, scan)),
            None => members.push((pose_group(setup, scan)?, vec![(index, scan)])),
        }
    }
    if members.is_empty() {
        return Err(no_scans_refusal(observed));
    }
    Ok(assemble_scan_points(setup, observed, members))
}

fn pose_group(setup: &LaserSetup<'_>, scan: &MeasuredScan) -> Result<PoseGroup, MethodRefusal> {
    let (label, rotary) = (scan.label.clone(), scan.rotary_positions.clone());
    let (machine_from_xyz, xyz_from_machine) = (setup.machine_from_xyz(&rotary), setup.xyz_from_machine(&rotary)?);
    let machine_from_table = setup.chain.machine_from_table(&rotary, &[]).rotation;
    Ok(PoseGroup { label, machine_from_xyz, xyz_from_machine, machine_from_table, rotary })
}

fn no_scans_refusal(observed: &ObservedScans) -> MethodRefusal {
    let mut why = match observed.skipped_scans.as_slice() {
        [] => "there are no readings of the sphere".to_owned(),
        [first, ..] => format!("no scan determines the sphere: {first}"),
    };
    if let Some(excluded) = observed.describe_excluded_samples() {
        why = format!("{why}; {excluded}");
    }
    MethodRefusal::new(
        why,
        "check centre_mm of the sphere and zero_mm, direction and range_mm of the sensor; scan along two lines that \
         cross at the pole",
    )
}

fn assemble_scan_points(
    setup: &LaserSetup<'_>,
    observed: &ObservedScans,
    members: Vec<GroupWithScans<'_>>,
) -> GroupedScans {
    let (noise, resolution) = (sample_std_dev_mm(setup, observed), coarsest_resolution_std_u_mm(setup));
    let (mut groups, mut rows, mut sample_means) = (Vec::new(), Vec::new(), Vec::new());
    let (mut row_origins, mut most) = (Vec::new(), 0);
    for (group, scans) in members {
        let poles: Vec<f64> = scans.iter().map(|(_, scan)| smallest_reading_mm(scan)).collect();
        most = most.max(count_different_heights(&poles));
        for (number, scan) in scans {
            for (point, spot) in scan.sample_means.iter().enumerate() {
                let u_mm = (noise / (spot.sample_count as f64).sqrt()).hypot(resolution).max(SCAN_POINT_STD_U_FLOOR_MM);
                let SampleMean { spindle_displacement_from_table_mm: displacement_mm, reading_mm, .. } = *spot;
                let (group, machine_from_spindle) = (groups.len(), scan.machine_from_spindle);
                rows.push(ScanPoint {
                    group_index: group,
                    spindle_displacement_from_table_mm: displacement_mm,
                    machine_from_spindle,
                    reading_mm,
                    u_mm,
                });
                sample_means.push(*spot);
                row_origins.push((number, point));
            }
        }
        groups.push(group);
    }
    let centres = CentreEquations {
        group_count: groups.len(),
        is_beam_free: most >= 3 && !setup.uses_touch_probe(),
        is_radius_free: setup.uses_touch_probe(),
        ..CentreEquations::with_nominal_beam(setup, rows)
    };
    GroupedScans {
        groups,
        centre_equations: centres,
        sample_means,
        row_scan_and_point_indices: row_origins,
        max_heights_per_group: most,
    }
}

/// Smallest reading of a scan, mm. It is measured near the pole.
fn smallest_reading_mm(scan: &MeasuredScan) -> f64 {
    scan.sample_means.iter().map(|spot| spot.reading_mm).fold(f64::INFINITY, f64::min)
}

/// Coarsest display resolution of the linear axes as a standard uncertainty, mm.
fn coarsest_resolution_std_u_mm(setup: &LaserSetup<'_>) -> f64 {
    let along = |axis: Axis| declared_sources::resolution_u_mm(setup.plan, axis.nominal_direction());
    Axis::LINEAR.into_iter().map(along).fold(0.0, f64::max)
}

impl GroupedScans {
    /// Mean time of the samples of a group, s.
    pub fn mean_time_of_group_s(&self, group: usize) -> f64 {
        let rows = self.centre_equations.scan_points.iter().zip(&self.sample_means);
        let times: Vec<f64> =
            rows.filter(|(row, _)| row.group_index == group).map(|(_, mean)| mean.time_in_run_s).collect();
        times.iter().sum::<f64>() / times.len() as f64
    }
}

impl PoseGroup {
    /// Positions of all axes with the zero point at a centre given in the machine frame.
    pub fn axis_positions(&self, centre: Vector3<f64>) -> Position {
        with_linear_axes(&self.rotary, self.xyz_from_machine * centre)
    }
}
