//! Sources of uncertainty as they act on what is measured: X, Y, Z of each measurement (machine frame,
//! mm), then each certified length (mm). The magnitudes are those that the plan declares (METHODS
//! section 6).

mod interruptions;
mod rotary;

use nalgebra::{Matrix3, Vector3};

use super::observe::{Observed, Sight};
use estimation::monte_carlo::Shape;
use estimation::smooth::smooth_function;
use machine::Axis;
use machine::kinematics::Chain;
use machine::record::artefact::Length;
use machine::record::machine::AxisSpec;
use machine::record::plan::Plan;

/// What one independent draw moves: neighbouring entries from `first` on.
#[derive(Debug, Clone)]
pub struct Draw {
    pub first: usize,
    pub values: Vec<f64>,
}

#[derive(Debug, Clone)]
pub struct UncertaintySource {
    pub name: &'static str,
    pub shape: Shape,
    pub draws: Vec<Draw>,
    /// Whether the residuals show it, so that they may correct its size. A certificate's error
    /// moves everything together.
    pub shown: bool,
}

/// Contact-direction harmonics of lobing; each takes an equal share of the declared variance. Lower
/// ones are radius and stylus offset.
const LOBES: std::ops::RangeInclusive<usize> = 2..=6;

/// Assumed standard uncertainty of one touch where none is declared, mm; the residuals rescale it.
const UNDECLARED_REPEATABILITY_MM: f64 = 1e-3;

/// No measurement weighs more than one of this standard uncertainty, mm.
const LEAST_MM: f64 = 1e-6;

pub fn sources(
    plan: &Plan,
    chain: &Chain,
    observed: &Observed,
    lengths: &[&Length],
) -> Vec<UncertaintySource> {
    let sights = &observed.sights;
    let mut list = vec![
        of_touches("repeatability of a touch", Shape::Normal, sights, |_| repeatability(plan)),
        of_touches("resolution", Shape::Rectangular, sights, |normal| resolution(plan, normal)),
        lobing(plan, observed),
        linear_axes(plan, sights),
        rotary::error_motions(plan, chain, observed),
        drift(plan, sights),
        interruptions::steps(plan, sights),
    ];
    list.extend(certificates(sights.len(), lengths));
    for source in &mut list {
        source.draws.retain(|draw| draw.values.iter().any(|value| *value != 0.0));
    }
    list.retain(|source| !source.draws.is_empty());
    list
}

/// What each source alone makes of the covariance of each measurement, summed: the weights, mm². A
/// source that moves many measurements together weighs as if it did not; lobing, which is everywhere the
/// same, and the step at an interruption, which would set one half below the other, do not weigh at all.
pub fn weighting(sources: &[UncertaintySource], sights: usize) -> Vec<Matrix3<f64>> {
    let mut covariances = vec![Matrix3::from_diagonal(&Vector3::repeat(LEAST_MM.powi(2))); sights];
    let weighed = sources
        .iter()
        .filter(|source| source.shown && ![LOBING, interruptions::STEP].contains(&source.name));
    for draw in weighed.flat_map(|source| &source.draws) {
        for (i, moved) in draw.values.chunks_exact(3).enumerate() {
            let moved = Vector3::from_column_slice(moved);
            covariances[draw.first / 3 + i] += moved * moved.transpose();
        }
    }
    covariances
}

fn repeatability(plan: &Plan) -> f64 {
    plan.probe.repeatability_um.map_or(UNDECLARED_REPEATABILITY_MM, |um| um * 1e-3)
}

/// Width one step of each displayed axis, projected on the normal.
fn resolution(plan: &Plan, normal: Vector3<f64>) -> f64 {
    let width =
        |axis| plan.machine.axes.get(&axis).map_or(0.0, |a: &AxisSpec| a.resolution_um * 1e-3);
    Vector3::from(Axis::LINEAR.map(width)).component_mul(&normal).norm() / 12f64.sqrt()
}

/// One draw a touch, `u` along its normal.
fn of_touches(
    name: &'static str,
    shape: Shape,
    sights: &[Sight],
    u: impl Fn(Vector3<f64>) -> f64,
) -> UncertaintySource {
    let draws = sights.iter().enumerate().flat_map(|(i, sight)| {
        let u = &u;
        sight.touches.iter().map(move |touch| Draw {
            first: 3 * i,
            values: (touch.gain * u(touch.normal)).as_slice().to_vec(),
        })
    });
    UncertaintySource { name, shape, draws: draws.collect(), shown: true }
}

const LOBING: &str = "probe lobing";

/// Direction-dependent pre-travel of the probe: harmonics of the azimuth in the frame of the spindle,
/// fading towards its pole. It turns with the spindle.
fn lobing(plan: &Plan, observed: &Observed) -> UncertaintySource {
    let share = plan.probe.lobing_um * 1e-3 / (LOBES.count() as f64).sqrt();
    let sense = plan.machine.axes.get(&Axis::S).map_or(1.0, |spec| spec.positive.sign());
    let draws = LOBES.flat_map(|lobes| [0.0, 0.25].map(|part| (lobes as f64, part))).map(|which| {
        let (lobes, quarter) = which;
        let shift = |sight: &Sight| {
            let turned = sense * observed.places[sight.place].at(Axis::S);
            let of_touch = |touch: &super::observe::Touch| {
                let level = touch.normal.x.hypot(touch.normal.y);
                let azimuth = touch.normal.y.atan2(touch.normal.x) - turned;
                let phase = lobes * azimuth - quarter * std::f64::consts::TAU;
                touch.gain * (share * level * phase.cos())
            };
            sight.touches.iter().map(of_touch).sum::<Vector3<f64>>()
        };
        spread(&observed.sights, shift)
    });
    UncertaintySource { name: LOBING, shape: Shape::Normal, draws: draws.collect(), shown: true }
}

/// Positioning and straightness of X, Y and Z, each a smooth random function of its axis.
fn linear_axes(plan: &Plan, sights: &[Sight]) -> UncertaintySource {
    let mut draws = Vec::new();
    for (k, axis) in Axis::LINEAR.into_iter().enumerate() {
        let Some(spec) = plan.machine.axes.get(&axis) else { continue };
        if spec.error_motion_um == 0.0 {
            continue;
        }
        // At its touches, not at its centre: the slope of a motion changes the sphere.
        let touches = sights.iter().flat_map(|sight| &sight.touches);
        let places: Vec<f64> = touches.map(|touch| touch.point[k].round()).collect();
        let sigma = spec.error_motion_um * 1e-3;
        for column in smooth_function(&places, sigma, spec.error_wavelength_mm) {
            draws.extend(Axis::LINEAR.map(|along| touched(sights, &column, along.direction())));
        }
    }
    let name = "error motions of X, Y and Z";
    UncertaintySource { name, shape: Shape::Normal, draws, shown: true }
}

/// Touches that deviate by `by`, one entry a touch, along an axis.
fn touched(sights: &[Sight], by: &[f64], along: Vector3<f64>) -> Draw {
    let mut by = by.iter();
    let shift = |sight: &Sight| -> Vector3<f64> {
        let touches = sight.touches.iter().zip(by.by_ref());
        touches.map(|(touch, by)| touch.gain * (touch.normal.dot(&along) * by)).sum()
    };
    spread(sights, shift)
}

/// The table against the spindle in X, Y and Z, at the declared rate, from the middle of the run: that
/// is what the estimate speaks of.
fn drift(plan: &Plan, sights: &[Sight]) -> UncertaintySource {
    let rate_mm_per_s = plan.machine.drift_um_per_h * 1e-3 / 3600.0;
    let mean = sights.iter().map(|sight| sight.t_s).sum::<f64>() / sights.len().max(1) as f64;
    let along =
        |axis: Axis| spread(sights, |sight| axis.direction() * rate_mm_per_s * (sight.t_s - mean));
    let draws = Axis::LINEAR.map(along).to_vec();
    UncertaintySource { name: "thermal drift", shape: Shape::Normal, draws, shown: true }
}

fn spread(sights: &[Sight], shift: impl FnMut(&Sight) -> Vector3<f64>) -> Draw {
    let shifts: Vec<[f64; 3]> = sights.iter().map(shift).map(Into::into).collect();
    Draw { first: 0, values: shifts.into_flattened() }
}

fn certificates(sights: usize, lengths: &[&Length]) -> [UncertaintySource; 2] {
    [("certified length", 0), ("temperature of the certified length", 1)].map(|(name, part)| {
        let draws = lengths.iter().enumerate().map(|(i, length)| Draw {
            first: 3 * sights + i,
            values: vec![super::model::length_u_parts_mm(length)[part]],
        });
        UncertaintySource { name, shape: Shape::Normal, draws: draws.collect(), shown: false }
    })
}
