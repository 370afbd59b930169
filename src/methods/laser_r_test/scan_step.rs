//! One scan: two perpendicular lines through the pole that faces the beam, either of dwell points or traversed
//! forward and backward while samples are taken.

use nalgebra::Vector3;

use super::scan_purpose::describe_rotary_position;
use super::setup::LaserSetup;
use super::sphere_model::with_linear_axes;
use crate::MethodRefusal;
use machine::frame::unit_vector;
use machine::record::plan::{Sampling, Scan, Step, StepKind};
use machine::{Axis, Position};

/// Expected position of the sphere and the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpectedGeometry {
    /// The sensor's zero point, spindle frame, mm.
    pub zero_point: Vector3<f64>,
    /// Direction of the beam, spindle frame; not a unit vector if measured.
    pub beam_direction: Vector3<f64>,
    /// Centre of the sphere, table frame, mm.
    pub ball_centre: Vector3<f64>,
    /// Largest possible distance of the sphere from its expected position, mm; 0 until the purpose of the stage is
    /// known.
    pub max_position_error_mm: f64,
}

/// Motion of a scan: with a stop at each point, or continuous at one of two feeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanMotion {
    /// Dwell points with a stop at each.
    Dwell,
    /// Continuous motion at `feed_mm_min`.
    SlowContinuous,
    /// Continuous motion at `fast_feed_mm_min`.
    FastContinuous,
}

/// A scan to be planned.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanRequest {
    pub rotary: Position,
    /// Nominal reading at the pole, mm.
    pub pole_reading_mm: f64,
    pub label: String,
    /// Whether the scan is a reference: repeated at the end and after an interruption.
    pub is_reference: bool,
    pub motion: ScanMotion,
}

/// Plans one scan.
///
/// # Errors
/// The sphere is out of the sensor's range, beyond the incidence limit, on the side of its stem, or out of the
/// axes' travel.
pub fn plan_scan_step(
    setup: &LaserSetup<'_>,
    geometry: &ExpectedGeometry,
    request: &ScanRequest,
) -> Result<Step, MethodRefusal> {
    let half = scan_half_length_mm(setup, geometry, &request.rotary)?;
    check_sensor_range(setup, geometry, request, half)?;
    let path = scan_path(setup, geometry, request, half)?;
    path.iter().try_for_each(|at| check_axis_travel(setup, &request.rotary, at))?;
    let beam = setup.machine_from_spindle(&request.rotary) * unit_vector(geometry.beam_direction).unwrap_or_default();
    let (feed_mm_min, sampling) = feed_and_sampling(setup, request.motion);
    Ok(Step {
        kind: if request.is_reference { StepKind::Reference } else { StepKind::Scan },
        feed_mm_min,
        sensors: vec![setup.sensor.name.clone()],
        normal: (-beam).into(),
        ..Step::scan(request.label.clone(), Scan { path, sampling })
    })
}

fn feed_and_sampling(setup: &LaserSetup<'_>, motion: ScanMotion) -> (f64, Sampling) {
    let settings = setup.settings;
    let (dwell_s, samples) = (settings.dwell_s, settings.samples);
    let continuous = Sampling::Continuous { rate_hz: settings.rate_hz, per_revolution: None };
    match motion {
        ScanMotion::Dwell => (settings.feed_mm_min, Sampling::Dwell { dwell_s, samples }),
        ScanMotion::SlowContinuous => (settings.feed_mm_min, continuous),
        ScanMotion::FastContinuous => (settings.fast_feed_mm_min, continuous),
    }
}

/// Half length of a line, mm: as far as the incidence limit allows for the largest position error of the sphere.
///
/// # Errors
/// The sphere is too small for its position error, or its stem points at the sensor.
fn scan_half_length_mm(
    setup: &LaserSetup<'_>,
    geometry: &ExpectedGeometry,
    rotary: &Position,
) -> Result<f64, MethodRefusal> {
    let radius = setup.ball.radius_mm;
    let half = radius * setup.incidence_limit_rad().sin() - geometry.max_position_error_mm;
    MethodRefusal::require(
        half >= 0.1 * radius,
        format!(
            "at {}: for a sphere of {radius} mm radius with a position error of up to {:.2} mm, the incidence \
                 angle may exceed the limit of {}°",
            describe_rotary_position(rotary),
            geometry.max_position_error_mm,
            setup.sensor.incidence_limit_deg
        ),
        "reduce uncertainty_mm of [artefact] (mount the sphere nearer to its stated position), or use a larger \
             sphere",
    )?;
    let table = setup.chain.machine_from_table(rotary, &[]).rotation;
    let stem = table * unit_vector(Vector3::from(setup.ball.stem)).unwrap_or_default();
    let to_sensor = -(setup.machine_from_spindle(rotary) * unit_vector(geometry.beam_direction).unwrap_or_default());
    let min_angle = (setup.ball.stem_radius_mm / radius).clamp(0.0, 1.0).asin() + setup.incidence_limit_rad();
    MethodRefusal::require(
        stem.angle(&to_sensor) >= min_angle,
        format!("at {} the sphere's stem points at the sensor", describe_rotary_position(rotary)),
        "remove the position from tilt_deg, or correct stem of the sphere",
    )?;
    Ok(half)
}

fn check_sensor_range(
    setup: &LaserSetup<'_>,
    geometry: &ExpectedGeometry,
    request: &ScanRequest,
    half_length_mm: f64,
) -> Result<(), MethodRefusal> {
    let radius = setup.ball.radius_mm;
    // Largest distance from the pole, for the largest position error of the sphere.
    let reach = (half_length_mm + geometry.max_position_error_mm).min(radius);
    let sag = radius - (radius * radius - reach * reach).sqrt();
    let [least, most] = setup.sensor.range_mm;
    let lowest = request.pole_reading_mm - geometry.max_position_error_mm;
    let highest = request.pole_reading_mm + sag + geometry.max_position_error_mm;
    MethodRefusal::require(
        lowest >= least && highest <= most,
        format!(
            "at {} the sphere may be out of the sensor's range: the expected readings are {lowest:.2} to {highest:.2} \
             mm, the range is {least} to {most} mm",
            describe_rotary_position(&request.rotary)
        ),
        "choose heights_mm nearer to the middle of the range, reduce uncertainty_mm of [artefact], or correct range_mm \
         of the sensor",
    )
}

/// Dwell points of both lines, or corner points of the continuous path.
fn scan_path(
    setup: &LaserSetup<'_>,
    geometry: &ExpectedGeometry,
    request: &ScanRequest,
    half_length_mm: f64,
) -> Result<Vec<Position>, MethodRefusal> {
    let rotary = &request.rotary;
    let centre =
        super::parameter_selection::nominal_xyz(&setup.chain, rotary, geometry.zero_point, geometry.ball_centre)?;
    let xyz_from_machine = setup.xyz_from_machine(rotary)?;
    // In continuous motion the scan moves along the axes alone. Slow motion along the tilt of the beam would hide
    // the lost motion of the axes.
    let beam = match request.motion {
        ScanMotion::Dwell => unit_vector(geometry.beam_direction).unwrap_or_default(),
        _ => setup.beam_direction(),
    };
    let beam = setup.machine_from_spindle(rotary) * beam;
    let along = unit_vector(Vector3::x() - beam * beam.x).unwrap_or(Vector3::y());
    let above = -beam * (setup.ball.radius_mm + request.pole_reading_mm);
    let across = along.cross(&beam);
    let points = setup.settings.points;
    let shares = (0..points).map(|k| 2.0 * k as f64 / (points - 1) as f64 - 1.0);
    let offsets: Vec<Vector3<f64>> = match request.motion {
        ScanMotion::Dwell => [along, across]
            .into_iter()
            .flat_map(|line| shares.clone().map(move |share| line * (half_length_mm * share)))
            .collect(),
        // Each line goes from the pole to both ends and back. Every section is traversed in both directions, so
        // that effects proportional to velocity cancel.
        _ => [0.0 * along, along, -along, 0.0 * along, across, -across, 0.0 * along]
            .map(|end| end * half_length_mm)
            .to_vec(),
    };
    let position = |offset: Vector3<f64>| {
        with_linear_axes(rotary, centre + xyz_from_machine * (above + offset)).rounded_to_file_resolution()
    };
    Ok(offsets.into_iter().map(position).collect())
}

fn check_axis_travel(setup: &LaserSetup<'_>, rotary: &Position, at: &Position) -> Result<(), MethodRefusal> {
    for (axis, value) in at.iter() {
        let Some(spec) = setup.plan.machine.axes.get(&axis) else { continue };
        let value = axis.to_mm_or_deg(value);
        MethodRefusal::require(
            (spec.min - 1e-9..=spec.max + 1e-9).contains(&value),
            format!(
                "at {} the scan needs {axis} {value:.3}, outside its limits [{}, {}]",
                describe_rotary_position(rotary),
                spec.min,
                spec.max
            ),
            match axis {
                Axis::X | Axis::Y | Axis::Z => {
                    "remove the position from tilt_deg and turn_deg, mount the sphere at another position, or correct \
                     zero_mm of the sensor"
                }
                _ => "remove the position from tilt_deg and turn_deg",
            },
        )?;
    }
    Ok(())
}
