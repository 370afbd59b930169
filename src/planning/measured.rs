//! Evaluation of the touches of one ball: its centre, diameter and form.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use estimation::sphere::{Sphere, SphereError, fit_sphere};
use machine::kinematics::{Chain, KinematicsError};
use machine::record::machine::{Machine, Probe};
use machine::{Axis, Position, frame::Point};

/// Measurement of one ball at one rotary position.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredBall {
    /// X, Y, Z at which the stylus-ball centre coincides with the ball's centre, and the rotary axes.
    pub position: Position,
    /// Centre of the ball in the table frame of the nominal machine, mm.
    pub centre_mm: Vector3<f64>,
    /// Covariance of X, Y, Z, mm², for a standard uncertainty of one touch of 1 mm: multiply by u².
    pub cofactor: Matrix3<f64>,
    /// Diameter of the ball: the stated stylus ball is subtracted. Pre-travel makes the value smaller.
    pub diameter_mm: f64,
    /// Largest minus smallest residual of the fitted sphere, mm.
    pub form_mm: f64,
}

/// Limits for an acceptable measurement, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallLimits {
    pub form_mm: f64,
    /// Maximum deviation from the stated diameter, in either direction.
    pub diameter_mm: f64,
}

/// Error: the touches do not fit the ball; the message contains possible causes.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BallDoubt {
    #[error(
        "ball {ball} at {at}: form {form:.3} mm, more than {limit:.3} mm: dirt, loose ball or wrong stylus?"
    )]
    Form { ball: String, at: String, form: f64, limit: f64 },
    #[error(
        "ball {ball} at {at}: diameter {diameter:.3} mm, not {stated:.3} mm within {limit:.3} mm: dirt, loose ball or wrong stylus?"
    )]
    Diameter { ball: String, at: String, diameter: f64, stated: f64, limit: f64 },
    #[error("ball {ball} at {at}: {source}")]
    Fit { ball: String, at: String, source: SphereError },
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
}

/// Fits the least-squares sphere through touches at one rotary position: axis positions at the triggers, with equal
/// rotary axes. `ball`: its id, for messages.
///
/// # Errors
/// There are fewer than four touches, or they lie in a plane; the machine has no kinematics.
pub fn measured_ball(
    ball: &str,
    touches: &[Position],
    machine: &Machine,
    probe: &Probe,
) -> Result<MeasuredBall, BallDoubt> {
    let chain = Chain::new(machine)?;
    let tip = Point::from_vec(Vector3::from(machine.tool_mm));
    let at_table = |position: &Position| chain.tip_in_table(position, tip, &[]).mm;
    let points: Vec<[f64; 3]> = touches.iter().map(|at| at_table(at).into()).collect();
    let first = touches.first().cloned().unwrap_or_default();
    let rotary = first.only(|axis| !axis.is_linear());
    let fitted: Sphere = fit_sphere(&points).map_err(|source| {
        let (ball, at) = (ball.to_owned(), in_words(&rotary));
        BallDoubt::Fit { ball, at, source }
    })?;
    let centre = Vector3::from(fitted.centre);
    let xyz = chain.linear_axes_for(Point::from_vec(centre), tip, &rotary, &[])?;
    let axes_from_table = chain.linear_inverse(&rotary, &[])?;
    let of_table = Matrix3::from(fitted.centre_covariance(1.0));
    Ok(MeasuredBall {
        position: rotary.updated_by(&xyz),
        centre_mm: centre,
        cofactor: axes_from_table * of_table * axes_from_table.transpose(),
        diameter_mm: 2.0 * (fitted.radius - probe.ball_radius_mm),
        form_mm: fitted.form(),
    })
}

impl MeasuredBall {
    /// Checks form and diameter. `stated_mm`: the expected diameter, reduced by the pre-travel.
    ///
    /// # Errors
    /// The limit that is exceeded.
    pub fn check(&self, ball: &str, stated_mm: f64, limits: &BallLimits) -> Result<(), BallDoubt> {
        let (form, limit) = (self.form_mm, limits.form_mm);
        let said = || (ball.to_owned(), in_words(&self.position));
        if form.is_nan() || form > limit {
            let (ball, at) = said();
            return Err(BallDoubt::Form { ball, at, form, limit });
        }
        let (diameter, stated, limit) = (self.diameter_mm, stated_mm, limits.diameter_mm);
        if (diameter - stated).abs() <= limit {
            return Ok(());
        }
        let (ball, at) = said();
        Err(BallDoubt::Diameter { ball, at, diameter, stated, limit })
    }
}

/// `B −30°, C 90°`
fn in_words(position: &Position) -> String {
    let rotary: BTreeMap<Axis, f64> =
        position.iter().filter(|(axis, _)| !axis.is_linear()).collect();
    let word = |(axis, value): (&Axis, &f64)| {
        let degrees = format!("{axis} {}°", axis.to_edge(*value));
        degrees.replace('-', "−")
    };
    rotary.iter().map(word).collect::<Vec<_>>().join(", ")
}
