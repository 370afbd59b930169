//! Chase-the-ball: the sphere's centre from touches instead of sensor samples.

use super::parameter_selection;
use super::scan_purpose::{ScanPurpose, describe_rotary_position};
use super::scan_step::{ExpectedGeometry, ScanRequest};
use super::setup::LaserSetup;
use super::sphere_model::with_linear_axes;
use crate::MethodRefusal;
use machine::frame::Point;
use machine::record::artefact::Ball;
use machine::record::plan::{Step, StepKind};
use planning::{BallMeasurementRequest, BallTouchMode, TouchAccess};

/// Number of touches that measure one centre of the sphere.
const TOUCHES_PER_MEASUREMENT: usize = 5;
/// Clearance before the expected contact, and overtravel of a slow touch, in addition to the position uncertainty
/// of the sphere, mm.
const CLEARANCE_MM: f64 = 0.2;

/// The touches of one measurement, without step numbers.
///
/// # Errors
/// The sphere cannot be touched at this position.
pub fn ball_touch_steps(
    setup: &LaserSetup<'_>,
    geometry: &ExpectedGeometry,
    purpose: ScanPurpose,
    request: &ScanRequest,
) -> Result<Vec<Step>, MethodRefusal> {
    let refused = |why: String| {
        MethodRefusal::new(
            format!("at {}: {why}", describe_rotary_position(&request.rotary)),
            "remove the position from tilt_deg and turn_deg, or mount the sphere at another position",
        )
    };
    let access = TouchAccess::new(setup.plan, &setup.plan.artefact).map_err(|why| refused(why.to_string()))?;
    // Centre of the sphere for which the stated stylus has the same axis positions as the measured stylus.
    let xyz =
        parameter_selection::nominal_xyz(&setup.chain, &request.rotary, geometry.zero_point, geometry.ball_centre)?;
    let at = with_linear_axes(&request.rotary, xyz);
    let centre = setup.chain.tip_in_table(&at, Point::from_vec(setup.zero_point()), &[]).mm;
    let ball = Ball { centre_mm: centre.into(), ..setup.ball.clone() };
    let mode = match purpose {
        ScanPurpose::Search => {
            BallTouchMode::Search { uncertainty_mm: setup.balls.uncertainty_mm, standoff_mm: CLEARANCE_MM }
        }
        _ => {
            let margin_mm = setup.settings.max_position_error_mm + CLEARANCE_MM;
            BallTouchMode::Measure { standoff_mm: margin_mm, search_mm: margin_mm }
        }
    };
    let kind = if request.is_reference { StepKind::Reference } else { StepKind::Touch };
    let ball_request = BallMeasurementRequest {
        ball: &ball,
        rotary: &request.rotary,
        touch_mode: mode,
        touch_count: TOUCHES_PER_MEASUREMENT,
    };
    let label = |touch: &str| format!("{}/{touch}", request.label);
    access.touch_steps(&ball_request, &setup.plan.probe, kind, label).map_err(|why| refused(why.to_string()))
}
