//! Sources of uncertainty as they act on the radii: one factor matrix B a source (observations ×
//! independent draws), covariance B·Bᵀ, mm². The magnitudes are those declared in the plan; how
//! each acts is METHODS sections 1 and 6.

use faer::Mat;

use super::model::{Layout, Observation};
use super::settings::Spindle;
use estimation::monte_carlo::Shape;
use estimation::smooth::smooth_function;
use machine::Axis;
use machine::record::machine::AxisSpec;
use machine::record::plan::Plan;

pub struct UncertaintySource {
    pub name: &'static str,
    pub shape: Shape,
    pub factor: Mat<f64>,
}

/// Contact-direction harmonics of lobing; each takes an equal share of the declared variance.
/// Lower ones are radius and stylus offset.
const LOBES: std::ops::RangeInclusive<usize> = 2..=6;

/// Assumed standard uncertainty of one touch where none is declared, mm; the residuals rescale it.
const UNDECLARED_REPEATABILITY_MM: f64 = 1e-3;

/// All sources, the touches' own scatter first.
pub fn sources(
    plan: &Plan,
    layout: &Layout,
    seen: &[Observation],
    spindle: Spindle,
    seconds_per_unit: f64,
) -> Vec<UncertaintySource> {
    let mut list = vec![repeatability(plan, seen), resolution(plan, layout, seen)];
    list.push(stylus_offset(plan, layout, seen, spindle));
    list.push(lobing(plan, layout, seen, spindle));
    list.push(linear_axes(plan, layout, seen));
    if layout.drift_order == 0 {
        list.push(drift(plan, layout, seen, seconds_per_unit));
    }
    list.retain(|source| source.factor.norm_max() > 0.0);
    list
}

/// Standard uncertainty of each radius from the sources that differ touch by touch, mm.
pub fn touch_sigma(sources: &[UncertaintySource], rows: usize) -> Vec<f64> {
    (0..rows)
        .map(|row| {
            let variance: f64 = sources
                .iter()
                .filter(|source| is_touch_by_touch(source))
                .map(|source| source.factor[(row, row)].powi(2))
                .sum();
            variance.sqrt()
        })
        .collect()
}

/// Whether the source is independent from touch to touch (Type A, seen in the residuals).
pub fn is_touch_by_touch(source: &UncertaintySource) -> bool {
    source.name == REPEATABILITY || source.name == RESOLUTION
}

const REPEATABILITY: &str = "repeatability of a touch";
const RESOLUTION: &str = "resolution";

fn repeatability(plan: &Plan, seen: &[Observation]) -> UncertaintySource {
    let u = plan.probe.repeatability_um.map_or(UNDECLARED_REPEATABILITY_MM, |um| um * 1e-3);
    let factor = Mat::from_fn(seen.len(), seen.len(), |i, j| if i == j { u } else { 0.0 });
    UncertaintySource { name: REPEATABILITY, shape: Shape::Normal, factor }
}

/// Rectangular, width one step of each displayed axis, projected on the ray.
fn resolution(plan: &Plan, layout: &Layout, seen: &[Observation]) -> UncertaintySource {
    let width =
        |axis| plan.machine.axes.get(&axis).map_or(0.0, |a: &AxisSpec| a.resolution_um * 1e-3);
    let factor = Mat::from_fn(seen.len(), seen.len(), |i, j| {
        let (sin, cos) = layout.design.angle(seen[i].phi).sin_cos();
        let step = (width(Axis::X) * cos).hypot(width(Axis::Y) * sin);
        if i == j { step / 12f64.sqrt() } else { 0.0 }
    });
    UncertaintySource { name: RESOLUTION, shape: Shape::Rectangular, factor }
}

/// The stylus stands beside its stated place. Turned with the probe it only changes R.
fn stylus_offset(
    plan: &Plan,
    layout: &Layout,
    seen: &[Observation],
    spindle: Spindle,
) -> UncertaintySource {
    let u = plan.probe.stylus_offset_um * 1e-3;
    let factor = match spindle {
        Spindle::Follow => Mat::from_fn(seen.len(), 1, |_, _| u),
        Spindle::Fixed => Mat::from_fn(seen.len(), 2, |i, j| {
            let (sin, cos) = layout.design.angle(seen[i].phi).sin_cos();
            u * if j == 0 { cos } else { sin }
        }),
    };
    UncertaintySource { name: "stylus offset", shape: Shape::Normal, factor }
}

/// Direction-dependent pre-travel of the probe.
fn lobing(
    plan: &Plan,
    layout: &Layout,
    seen: &[Observation],
    spindle: Spindle,
) -> UncertaintySource {
    let u = plan.probe.lobing_um * 1e-3;
    let share = u / (LOBES.count() as f64).sqrt();
    let factor = match spindle {
        Spindle::Follow => Mat::from_fn(seen.len(), 1, |_, _| u),
        Spindle::Fixed => Mat::from_fn(seen.len(), 2 * LOBES.count(), |i, j| {
            let lobes = (LOBES.start() + j / 2) as f64;
            let (sin, cos) = (lobes * layout.design.angle(seen[i].phi)).sin_cos();
            share * if j % 2 == 0 { cos } else { sin }
        }),
    };
    UncertaintySource { name: "probe lobing", shape: Shape::Normal, factor }
}

/// Drift at the declared rates where none is fitted.
fn drift(
    plan: &Plan,
    layout: &Layout,
    seen: &[Observation],
    seconds_per_unit: f64,
) -> UncertaintySource {
    let rate_mm_per_s = plan.machine.drift_um_per_h * 1e-3 / 3600.0;
    let factor = Mat::from_fn(seen.len(), 3, |i, j| {
        let (sin, cos) = layout.design.angle(seen[i].phi).sin_cos();
        rate_mm_per_s * seconds_per_unit * seen[i].time * [cos, sin, 1.0][j]
    });
    UncertaintySource { name: "thermal drift", shape: Shape::Normal, factor }
}

/// The references stand at C = 0: they see that something moved while the cycle was interrupted, but
/// not whether it was the table, which is what is fitted, or the part on it, which turns with C.
/// Anything between is taken as equally likely, from the steps in `x`.
pub fn interruptions(layout: &Layout, seen: &[Observation], x: &[f64]) -> UncertaintySource {
    let factor = Mat::from_fn(seen.len(), 2 * layout.gaps.len(), |i, j| {
        let (gap, what) = (j / 2, j % 2);
        let along = |index: usize| {
            let (sin, cos) = layout.design.angle(index).sin_cos();
            [cos, sin][what]
        };
        let (s, theta) = (&seen[i], layout.design.theta(seen[i].c, seen[i].phi));
        let step = x[layout.step(what, gap)] / 3f64.sqrt();
        step * layout.stepped(s, gap) * (along(theta) - along(s.phi))
    });
    UncertaintySource { name: "what moved when interrupted", shape: Shape::Rectangular, factor }
}

/// Error motions of X and Y: positioning and straightness, each a stationary random function with
/// covariance σ²·exp(−Δ²/2ℓ²), zero at axis zero, acting along the ray.
fn linear_axes(plan: &Plan, layout: &Layout, seen: &[Observation]) -> UncertaintySource {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for (axis, along) in [(Axis::X, 0), (Axis::Y, 1)] {
        let Some(spec) = plan.machine.axes.get(&axis) else { continue };
        if spec.error_motion_um == 0.0 {
            continue;
        }
        let places: Vec<f64> = seen
            .iter()
            .map(|s| {
                let (sin, cos) = layout.design.angle(s.phi).sin_cos();
                (s.radius * [cos, sin][along]).round()
            })
            .collect();
        for draw in smooth_function(&places, spec.error_motion_um * 1e-3, spec.error_wavelength_mm)
        {
            // Positioning and straightness of the axis: the same law, independent draws.
            for part in 0..2 {
                columns.push(
                    seen.iter()
                        .zip(&draw)
                        .map(|(s, value)| {
                            let (sin, cos) = layout.design.angle(s.phi).sin_cos();
                            -value * [cos, sin][part]
                        })
                        .collect(),
                );
            }
        }
    }
    let factor = Mat::from_fn(seen.len(), columns.len(), |i, j| columns[j][i]);
    UncertaintySource { name: "error motions of X and Y", shape: Shape::Normal, factor }
}
