//! Evaluation of the touches of one ball: its centre, diameter and form.

use nalgebra::{Matrix3, Vector3};

use estimation::sphere::{FittedSphere, SphereError, fit_sphere};
use machine::kinematics::{KinematicChain, KinematicsError};
use machine::record::machine::{Machine, Probe};
use machine::{Position, frame::Point};

/// Measurement of one ball at one rotary position.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredBall {
    /// X, Y, Z at which the stylus-ball centre coincides with the ball's centre, and the rotary axes.
    pub axis_positions_at_centre: Position,
    /// Centre of the ball in the table frame of the nominal machine, mm.
    pub centre_in_table_mm: Vector3<f64>,
    /// Covariance of X, Y, Z, mm², for a standard uncertainty of one touch of 1 mm: multiply by u² (u in mm).
    pub axis_position_cofactor: Matrix3<f64>,
    /// Diameter of the ball: the stated stylus ball is subtracted. Pre-travel makes the value smaller.
    pub diameter_mm: f64,
    /// Largest minus smallest residual of the fitted sphere, mm.
    pub form_mm: f64,
}

/// Limits for an acceptable measurement, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallLimits {
    pub max_form_mm: f64,
    /// Maximum deviation from the expected diameter, in either direction, including the pre-travel.
    pub max_diameter_deviation_mm: f64,
}

/// Error: the touches do not fit the ball; the message contains possible causes. `at`: text of the positions of the
/// rotary axes. Lengths in mm.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BallCheckError {
    #[error(
        "ball {ball} at {at}: the form deviation {form:.3} mm exceeds the limit {limit:.3} mm; check for dirt, a loose ball or a wrong stylus"
    )]
    FormTooLarge { ball: String, at: String, form: f64, limit: f64 },
    #[error(
        "ball {ball} at {at}: the measured diameter {diameter:.3} mm differs from the expected {expected_diameter:.3} mm by more than {limit:.3} mm; check for dirt, a loose ball or a wrong stylus"
    )]
    DiameterDeviates { ball: String, at: String, diameter: f64, expected_diameter: f64, limit: f64 },
    #[error("ball {ball} at {at}: {source}")]
    SphereFitFailed { ball: String, at: String, source: SphereError },
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
}

/// Fits the least-squares sphere through touches at one rotary position: axis positions at the triggers, with equal
/// rotary axes. `ball`: its id, for messages.
///
/// # Errors
/// There are fewer than four touches, or they lie in a plane; the machine has no kinematics.
pub fn evaluate_ball(
    ball: &str,
    touches: &[Position],
    machine: &Machine,
    probe: &Probe,
) -> Result<MeasuredBall, BallCheckError> {
    let chain = KinematicChain::new(machine)?;
    let tip = Point::from_vec(Vector3::from(machine.tool_mm));
    let at_table = |position: &Position| chain.tip_in_table(position, tip, &[]).mm;
    let points: Vec<[f64; 3]> = touches.iter().map(|at| at_table(at).into()).collect();
    let first = touches.first().cloned().unwrap_or_default();
    let rotary = first.filter_axes(|axis| !axis.is_linear());
    let fitted: FittedSphere = fit_sphere(&points).map_err(|source| {
        let (ball, at) = (ball.to_owned(), format_rotary_position(&rotary));
        BallCheckError::SphereFitFailed { ball, at, source }
    })?;
    let centre = Vector3::from(fitted.centre);
    let xyz = chain.solve_linear_axes(Point::from_vec(centre), tip, &rotary, &[])?;
    let axes_from_table = chain.inverse_linear_axes_jacobian(&rotary, &[])?;
    let of_table = Matrix3::from(fitted.centre_covariance(1.0));
    Ok(MeasuredBall {
        axis_positions_at_centre: rotary.updated_by(&xyz),
        centre_in_table_mm: centre,
        axis_position_cofactor: axes_from_table * of_table * axes_from_table.transpose(),
        diameter_mm: 2.0 * (fitted.radius - probe.ball_radius_mm),
        form_mm: fitted.form_deviation(),
    })
}

impl MeasuredBall {
    /// Checks form and diameter. `stated_diameter_mm`: stated diameter. The deviation from it includes the
    /// pre-travel.
    ///
    /// # Errors
    /// The limit that is exceeded.
    pub fn check_form_and_diameter(
        &self,
        ball: &str,
        stated_diameter_mm: f64,
        limits: &BallLimits,
    ) -> Result<(), BallCheckError> {
        let (form, limit) = (self.form_mm, limits.max_form_mm);
        let (ball, at) = (ball.to_owned(), format_rotary_position(&self.axis_positions_at_centre));
        if form.is_nan() || form > limit {
            return Err(BallCheckError::FormTooLarge { ball, at, form, limit });
        }
        let (diameter, expected_diameter, limit) =
            (self.diameter_mm, stated_diameter_mm, limits.max_diameter_deviation_mm);
        if (diameter - expected_diameter).abs() <= limit {
            return Ok(());
        }
        Err(BallCheckError::DiameterDeviates { ball, at, diameter, expected_diameter, limit })
    }
}

/// Text of the rotary axes, such as `B −30°, C 90°`.
fn format_rotary_position(position: &Position) -> String {
    let rotary = position.iter().filter(|(axis, _)| !axis.is_linear());
    let words = rotary.map(|(axis, value)| format!("{axis} {}°", axis.to_mm_or_deg(value)).replace('-', "−"));
    words.collect::<Vec<_>>().join(", ")
}
