//! Sources of uncertainty as they act on dwell points: by how much each one's distance from the
//! sphere's centre is greater, mm. The magnitudes are those that the plan declares (METHODS section 6).

mod outside;

use nalgebra::{Matrix3, Vector3};

use super::bench::Bench;
use super::centres::{Centres, Row};
use super::group::{Grouped, noise_mm};
use super::latency::Latency;
use super::model::placed;
use super::observe::Observed;
use estimation::monte_carlo::Shape;
use estimation::smooth::smooth_function;
use machine::frame::unit_vector;
use machine::kinematics::{ErrorParameter, Shape as Motion};
use machine::record::plan::{Step, StepKind};
use machine::{Axis, Position, frame::Point};

/// What the independent draws move.
#[derive(Debug, Clone)]
pub enum Acts {
    /// A draw for each dwell point.
    Each(Vec<f64>),
    /// A draw for each of these columns over all dwell points.
    Joint(Vec<Vec<f64>>),
}

#[derive(Debug, Clone)]
pub struct UncertaintySource {
    pub name: &'static str,
    pub shape: Shape,
    pub acts: Acts,
    /// Whether the residuals show it, so that they may correct its size.
    pub shown: bool,
    /// Of joint draws: what each is of the latency and of what the axes lose where they turn round, s and
    /// mm in the order of [`Latency::names`].
    pub clocks: Vec<Vec<f64>>,
}

/// Harmonics of an error motion; each takes an equal share of the declared variance. The mean is the
/// axis' place, and the first goes with what turns on it.
const ORDERS: std::ops::RangeInclusive<u32> = 2..=5;
/// Contact-direction harmonics of lobing; lower ones are radius and stylus offset.
const LOBES: std::ops::RangeInclusive<u32> = 2..=6;
/// Part of the range over which the sensor's curve changes.
const CURVE: f64 = 0.25;

/// The dwell points as the sources see them.
struct Seen<'a> {
    bench: &'a Bench<'a>,
    grouped: &'a Grouped,
    /// Outward normal at each, machine frame.
    normals: Vec<Vector3<f64>>,
    /// −cos of the incidence: what a greater reading does to the distance.
    along: Vec<f64>,
}

pub fn sources(
    bench: &Bench<'_>,
    observed: &Observed,
    grouped: &Grouped,
    x: &[f64],
) -> Vec<UncertaintySource> {
    let centres: &Centres = &grouped.centres;
    let normals: Vec<Vector3<f64>> = centres
        .rows
        .iter()
        .map(|row| unit_vector(centres.arm(x, row)).unwrap_or_default())
        .collect();
    let beam = unit_vector(centres.beam(x)).unwrap_or_default();
    let along = centres.rows.iter().zip(&normals);
    let along = along.map(|(row, n)| match bench.touches() {
        true => -1.0,
        false => n.dot(&(row.spindle * beam)),
    });
    let along = along.collect();
    let seen = Seen { bench, grouped, normals, along };
    let mut list = vec![
        seen.noise(noise_mm(bench, observed)),
        seen.resolution(),
        seen.linearity(),
        seen.lobing(),
        seen.linear_axes(),
        seen.rotary_axes(x),
        seen.drift(),
        seen.interruptions(&observed.stops),
        seen.radius(),
        seen.squareness(),
        seen.form(),
        seen.incidence(),
    ];
    list.extend(observed.latency.as_ref().map(|latency| seen.latency(latency)));
    list.retain(|source| match &source.acts {
        Acts::Each(sizes) => sizes.iter().any(|size| *size != 0.0),
        Acts::Joint(columns) => columns.iter().flatten().any(|size| *size != 0.0),
    });
    list
}

fn source(name: &'static str, acts: Acts) -> UncertaintySource {
    UncertaintySource { name, shape: Shape::Normal, acts, shown: true, clocks: Vec::new() }
}

impl Seen<'_> {
    fn noise(&self, sample_mm: f64) -> UncertaintySource {
        let spots = self.grouped.spots.iter().zip(&self.along);
        let each =
            spots.map(|(spot, along)| sample_mm * along.abs() / (spot.samples as f64).sqrt());
        let name = match self.bench.touches() {
            true => "repeatability of a touch",
            false => "noise of the sensor",
        };
        source(name, Acts::Each(each.collect()))
    }

    fn resolution(&self) -> UncertaintySource {
        let axes = &self.bench.plan.machine.axes;
        let width = |axis| axes.get(&axis).map_or(0.0, |spec| spec.resolution_um * 1e-3);
        let width = Vector3::from(Axis::LINEAR.map(width));
        let each = self.normals.iter().map(|n| width.component_mul(n).norm() / 12f64.sqrt());
        let acts = Acts::Each(each.collect());
        UncertaintySource { shape: Shape::Rectangular, ..source("resolution of the axes", acts) }
    }

    /// What the sensor's curve deviates from a line, a smooth function of the reading.
    fn linearity(&self) -> UncertaintySource {
        let [least, most] = self.bench.sensor.range_mm;
        let readings: Vec<f64> =
            self.grouped.spots.iter().map(|spot| (spot.value * 20.0).round() / 20.0).collect();
        let sigma = self.bench.sensor.linearity_um * 1e-3;
        let columns = smooth_function(&readings, sigma, CURVE * (most - least)).into_iter();
        let acts =
            columns.map(|column| column.iter().zip(&self.along).map(|(c, a)| c * a).collect());
        source("linearity of the sensor", Acts::Joint(acts.collect()))
    }

    /// Direction-dependent pre-travel of the probe: harmonics of the azimuth in the frame of the spindle,
    /// fading towards its pole.
    fn lobing(&self) -> UncertaintySource {
        let lobing = if self.bench.touches() { self.bench.plan.probe.lobing_um } else { 0.0 };
        let share = lobing * 1e-3 / (LOBES.count() as f64).sqrt();
        let column = |lobes: f64, quarter: f64| {
            let rows = self.grouped.centres.rows.iter().zip(&self.normals);
            let at = move |(row, normal): (&Row, &Vector3<f64>)| {
                let n = row.spindle.inverse() * normal;
                let phase = lobes * n.y.atan2(n.x) - quarter * std::f64::consts::TAU;
                share * n.x.hypot(n.y) * phase.cos()
            };
            rows.map(at).collect::<Vec<f64>>()
        };
        let columns =
            LOBES.flat_map(|lobes| [0.0, 0.25].map(|quarter| column(f64::from(lobes), quarter)));
        source("probe lobing", Acts::Joint(columns.collect()))
    }

    /// Positioning and straightness of X, Y and Z, each a smooth random function of its axis.
    fn linear_axes(&self) -> UncertaintySource {
        let mut columns = Vec::new();
        for (k, axis) in Axis::LINEAR.into_iter().enumerate() {
            let Some(spec) = self.bench.plan.machine.axes.get(&axis) else { continue };
            if spec.error_motion_um == 0.0 {
                continue;
            }
            let places: Vec<f64> = self.grouped.spots.iter().map(|s| s.xyz[k].round()).collect();
            let sigma = spec.error_motion_um * 1e-3;
            for column in smooth_function(&places, sigma, spec.error_wavelength_mm) {
                let along = |k: usize| {
                    let normals = self.normals.iter().zip(&column);
                    normals.map(|(n, by)| n[k] * by).collect::<Vec<f64>>()
                };
                columns.extend((0..3).map(along));
            }
        }
        source("error motions of X, Y and Z", Acts::Joint(columns))
    }

    /// The table moves by `shift` (machine frame) of each group.
    fn by_group(&self, shift: impl Fn(usize) -> Vector3<f64>) -> Vec<f64> {
        let rows = self.grouped.centres.rows.iter().zip(&self.normals);
        rows.map(|(row, n)| -n.dot(&shift(row.group))).collect()
    }

    /// Along X, Y and Z, each a few harmonics of the angle (ISO 230-7).
    fn rotary_axes(&self, x: &[f64]) -> UncertaintySource {
        let mut columns = Vec::new();
        let turning = self.bench.plan.machine.axes.iter().filter(|(axis, _)| !axis.is_linear());
        for (axis, spec) in turning.filter(|(_, spec)| spec.error_motion_um > 0.0) {
            let share = spec.error_motion_um * 1e-3 / (ORDERS.count() as f64).sqrt();
            for order in ORDERS {
                for shape in [Motion::Cos(order), Motion::Sin(order)] {
                    for along in Axis::LINEAR {
                        let Ok(motion) = ErrorParameter::new(along, *axis, shape) else { continue };
                        let shifts = self.shifts(x, motion, share);
                        columns.push(self.by_group(|group| shifts[group]));
                    }
                }
            }
        }
        source("error motions of rotary axes", Acts::Joint(columns))
    }

    /// Of the table at each group, machine frame, for an error motion of this size.
    fn shifts(&self, x: &[f64], motion: ErrorParameter, size: f64) -> Vec<Vector3<f64>> {
        let (chain, tip) = (&self.bench.chain, Point::from_vec(self.bench.zero()));
        let groups = self.grouped.groups.iter().enumerate();
        groups
            .map(|(i, group)| {
                let at = placed(&group.rotary, group.axes(self.grouped.centres.centre(x, i)));
                let table = chain.machine_from_table(&at, &[]).rotation;
                let column = chain.jacobian(&at, tip, &[], &[motion]);
                -(table * column.first().copied().unwrap_or_default()) * size
            })
            .collect()
    }

    /// The table against the spindle, at the declared rate, from the middle of the run.
    fn drift(&self) -> UncertaintySource {
        let rate = self.bench.plan.machine.drift_um_per_h * 1e-3 / 3600.0;
        let spots = &self.grouped.spots;
        let mean = spots.iter().map(|spot| spot.t_s).sum::<f64>() / spots.len().max(1) as f64;
        let along = |k: usize| {
            let spots = spots.iter().zip(&self.normals);
            spots.map(|(spot, n)| n[k] * rate * (spot.t_s - mean)).collect()
        };
        source("thermal drift", Acts::Joint((0..3).map(along).collect()))
    }

    /// What was measured after an interruption may lie apart from what was measured before, by as much
    /// as references measured again are allowed to. That whole limit counts as standard uncertainty: nobody
    /// knows how steps spread.
    fn interruptions(&self, stops: &[(f64, f64)]) -> UncertaintySource {
        let columns = stops.iter().flat_map(|(gap_s, limit_mm)| {
            (0..3).map(move |k| {
                let size = limit_mm * self.least_seen(k);
                let spots = self.grouped.spots.iter().zip(&self.normals);
                spots.map(|(s, n)| if s.t_s > *gap_s { n[k] * size } else { 0.0 }).collect()
            })
        });
        source("steps at interruptions", Acts::Joint(columns.collect()))
    }

    /// So far may the sphere stand along an axis for a reference that is 1 mm off; 1 where none sees it.
    fn least_seen(&self, k: usize) -> f64 {
        let steps = self.bench.plan.steps.iter();
        let references = steps.filter(|step| step.kind == StepKind::Reference);
        let seen = references.map(|step| seen_along(step, k, self.bench.radius()));
        let most = seen.fold(0.0, f64::max);
        if most > 0.0 { 1.0 / most } else { 1.0 }
    }

    fn radius(&self) -> UncertaintySource {
        // A touched sphere's radius is an unknown.
        let stated = if self.bench.touches() { 0.0 } else { self.bench.settings.radius_u_um };
        let u = stated * 1e-3;
        let acts = Acts::Joint(vec![vec![-u; self.normals.len()]]);
        UncertaintySource { shown: false, ..source("radius of the sphere", acts) }
    }

    /// The latency and, known no better without it, what the axes lose where they turn round.
    fn latency(&self, latency: &Latency) -> UncertaintySource {
        let grouped = self.grouped;
        let draws = latency.root.col_iter().map(|draw| draw.iter().copied().collect::<Vec<f64>>());
        let clocks: Vec<Vec<f64>> = draws.collect();
        let rows = grouped.centres.rows.iter().zip(&grouped.spots).zip(&self.normals);
        let each: Vec<Vec<f64>> = rows
            .map(|((row, spot), n)| {
                let travel =
                    grouped.groups.get(row.group).map_or(Matrix3::identity(), |g| g.travel);
                let moved = latency.columns(spot.velocity, spot.toward).into_iter();
                moved.map(|by| n.dot(&(travel * by))).collect()
            })
            .collect();
        let along = |draw: &Vec<f64>| {
            let of = |by: &Vec<f64>| by.iter().zip(draw).map(|(by, size)| by * size).sum();
            each.iter().map(of).collect()
        };
        let acts = Acts::Joint(clocks.iter().map(along).collect());
        UncertaintySource { shown: false, clocks, ..source("latency of the sensor", acts) }
    }
}

/// What a reference shows of a sphere that stands 1 mm further along an axis: across the beam its flanks
/// alone see it.
fn seen_along(step: &Step, k: usize, radius: f64) -> f64 {
    let normal = unit_vector(Vector3::from(step.normal)).unwrap_or_default();
    let path: Vec<Vector3<f64>> =
        step.scan.iter().flat_map(|scan| &scan.path).map(Position::xyz).collect();
    let middle = path.iter().sum::<Vector3<f64>>() / path.len().max(1) as f64;
    let outward = path.iter().map(|at| {
        let from = at - middle;
        let across = from - normal * (from.dot(&normal) / normal.norm_squared());
        across + normal * (radius * radius - across.norm_squared()).max(0.0).sqrt()
    });
    let lean = outward.map(|n| (n[k] / n.dot(&normal)).abs());
    lean.fold(normal[k].abs(), f64::max)
}
