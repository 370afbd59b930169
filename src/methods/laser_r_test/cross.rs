//! One scan: two perpendicular lines through the pole that faces the beam, either of dwell points or traversed
//! forward and backward while samples are taken.

use nalgebra::Vector3;

use super::bench::LaserSetup;
use super::label::in_words;
use super::model::placed;
use crate::Refused;
use machine::frame::unit_vector;
use machine::record::plan::{Sampling, Scan, Step, StepKind};
use machine::{Axis, Position};

/// Expected position of the sphere and the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The sensor's zero point, spindle frame.
    pub zero: Vector3<f64>,
    /// Direction of the beam, spindle frame.
    pub beam: Vector3<f64>,
    /// Centre of the sphere, table frame.
    pub ball: Vector3<f64>,
    /// Largest distance of the sphere from its expected position, mm.
    pub position_uncertainty_mm: f64,
}

/// Motion of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanMotion {
    /// Dwell points with a stop at each.
    Rests,
    /// Continuous motion at the first feed.
    Slow,
    /// Continuous motion at the second feed.
    Fast,
}

/// A scan to be planned.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanRequest {
    pub rotary: Position,
    /// Nominal reading at the pole, mm.
    pub height_mm: f64,
    pub label: String,
    /// Whether the scan is a reference: repeated at the end and after an interruption.
    pub reference: bool,
    pub walk: ScanMotion,
}

/// # Errors
/// The sphere is out of the sensor's range, beyond the incidence limit, on the side of its stem, or out of the
/// axes' travel.
pub fn step(bench: &LaserSetup<'_>, place: &Place, wanted: &ScanRequest) -> Result<Step, Refused> {
    let half = half_mm(bench, place, &wanted.rotary)?;
    check_range(bench, place, wanted, half)?;
    let path = path(bench, place, wanted, half)?;
    path.iter().try_for_each(|at| check_travel(bench, &wanted.rotary, at))?;
    let beam = bench.spindle(&wanted.rotary) * unit_vector(place.beam).unwrap_or_default();
    let (feed_mm_min, sampling) = settled(bench, wanted.walk);
    Ok(Step {
        kind: if wanted.reference { StepKind::Reference } else { StepKind::Scan },
        feed_mm_min,
        sensors: vec![bench.sensor.name.clone()],
        normal: (-beam).into(),
        ..Step::scan(wanted.label.clone(), Scan { path, sampling })
    })
}

fn settled(bench: &LaserSetup<'_>, walk: ScanMotion) -> (f64, Sampling) {
    let settings = bench.settings;
    let (dwell_s, samples) = (settings.dwell_s, settings.samples);
    let continuous = Sampling::Continuous { rate_hz: settings.rate_hz, per_revolution: None };
    match walk {
        ScanMotion::Rests => (settings.feed_mm_min, Sampling::Dwell { dwell_s, samples }),
        ScanMotion::Slow => (settings.feed_mm_min, continuous),
        ScanMotion::Fast => (settings.fast_feed_mm_min, continuous),
    }
}

/// Half length of a line, mm: as far as the incidence limit allows for the largest position error of the sphere.
fn half_mm(bench: &LaserSetup<'_>, place: &Place, rotary: &Position) -> Result<f64, Refused> {
    let radius = bench.ball.radius_mm;
    let half = radius * bench.limit().sin() - place.position_uncertainty_mm;
    if half < 0.1 * radius {
        return Err(Refused {
            why: format!(
                "at {} a sphere of {radius} mm that may stand {:.2} mm off could meet the beam beyond the \
                 incidence limit of {}°",
                in_words(rotary),
                place.position_uncertainty_mm,
                bench.sensor.incidence_limit_deg
            ),
            instead:
                "lower uncertainty_mm of [artefact] (set the sphere up nearer to where the file \
                      says), or take a larger sphere"
                    .to_owned(),
        });
    }
    let table = bench.chain.machine_from_table(rotary, &[]).rotation;
    let stem = table * unit_vector(Vector3::from(bench.ball.stem)).unwrap_or_default();
    let towards = -(bench.spindle(rotary) * unit_vector(place.beam).unwrap_or_default());
    let free = (bench.ball.stem_radius_mm / radius).clamp(0.0, 1.0).asin() + bench.limit();
    if stem.angle(&towards) < free {
        return Err(Refused {
            why: format!("at {} the sphere's stem points at the sensor", in_words(rotary)),
            instead: "take the position out of tilt_deg, or correct stem of the sphere".to_owned(),
        });
    }
    Ok(half)
}

fn check_range(
    bench: &LaserSetup<'_>,
    place: &Place,
    wanted: &ScanRequest,
    half: f64,
) -> Result<(), Refused> {
    let radius = bench.ball.radius_mm;
    // Largest distance from the pole, for the largest position error of the sphere.
    let reach = (half + place.position_uncertainty_mm).min(radius);
    let sag = radius - (radius * radius - reach * reach).sqrt();
    let [least, most] = bench.sensor.range_mm;
    let (lowest, highest) = (
        wanted.height_mm - place.position_uncertainty_mm,
        wanted.height_mm + sag + place.position_uncertainty_mm,
    );
    if lowest >= least && highest <= most {
        return Ok(());
    }
    Err(Refused {
        why: format!(
            "at {} the sphere may be out of the sensor's range: readings of {lowest:.2} to {highest:.2} mm \
             could come, the range is {least} to {most} mm",
            in_words(&wanted.rotary)
        ),
        instead: "choose heights_mm nearer to the middle of the range, lower uncertainty_mm of [artefact], \
                  or correct range_mm of the sensor"
            .to_owned(),
    })
}

fn path(
    bench: &LaserSetup<'_>,
    place: &Place,
    wanted: &ScanRequest,
    half: f64,
) -> Result<Vec<Position>, Refused> {
    let rotary = &wanted.rotary;
    let centre = super::parameters::expected(&bench.chain, rotary, place.zero, place.ball)?;
    let axes_for = bench.axes_for(rotary)?;
    // In continuous motion the scan moves along the axes alone. Slow motion along the tilt of the beam would hide
    // the lost motion of the axes.
    let beam = match wanted.walk {
        ScanMotion::Rests => unit_vector(place.beam).unwrap_or_default(),
        _ => bench.beam(),
    };
    let beam = bench.spindle(rotary) * beam;
    let along = unit_vector(Vector3::x() - beam * beam.x).unwrap_or(Vector3::y());
    let above = -beam * (bench.ball.radius_mm + wanted.height_mm);
    let points = bench.settings.points;
    let line = |direction: Vector3<f64>| {
        let share = move |k: usize| 2.0 * k as f64 / (points - 1) as f64 - 1.0;
        (0..points).map(move |k| above + direction * (half * share(k)))
    };
    let across = along.cross(&beam);
    let end = |way: Vector3<f64>| above + way * half;
    let offsets: Vec<Vector3<f64>> = match wanted.walk {
        ScanMotion::Rests => line(along).chain(line(across)).collect(),
        // Each line goes from the pole to both ends and back. Every section is traversed in both directions, so
        // that effects proportional to velocity cancel.
        _ => [0.0 * along, along, -along, 0.0 * along, across, -across, 0.0 * along]
            .map(end)
            .to_vec(),
    };
    let at = |by: Vector3<f64>| placed(rotary, centre + axes_for * by).as_written();
    Ok(offsets.into_iter().map(at).collect())
}

fn check_travel(bench: &LaserSetup<'_>, rotary: &Position, at: &Position) -> Result<(), Refused> {
    for (axis, value) in at.iter() {
        let Some(spec) = bench.plan.machine.axes.get(&axis) else { continue };
        let value = axis.to_edge(value);
        if !(spec.min - 1e-9..=spec.max + 1e-9).contains(&value) {
            return Err(Refused {
                why: format!(
                    "at {} {axis} would have to go to {value:.3}, outside [{}, {}]",
                    in_words(rotary),
                    spec.min,
                    spec.max
                ),
                instead: match axis {
                    Axis::X | Axis::Y | Axis::Z => {
                        "take the position out of tilt_deg and turn_deg, set the sphere up elsewhere, or \
                         correct zero_mm of the sensor"
                    }
                    _ => "take the position out of tilt_deg and turn_deg",
                }
                .to_owned(),
            });
        }
    }
    Ok(())
}
