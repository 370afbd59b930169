//! Sources of uncertainty: the change of each dwell point's distance from the sphere's centre by each draw, mm. The
//! magnitudes are declared by the plan (METHODS section 6).

mod outside;

use nalgebra::Vector3;

use super::bench::LaserSetup;
use super::group::{Group, Grouped, noise_mm};
use super::latency::Latency;
use super::model::placed;
use super::observe::Observed;
use super::spots::Spot;
use crate::identification::declared::{self, RotaryMotion};
use crate::identification::{Effect, EvaluationType, InResiduals, Shape, UncertaintySource};
use machine::Position;
use machine::frame::{Point, unit_vector};
use machine::kinematics::ErrorParameter;
use machine::record::plan::{Step, StepKind};

/// Dwell points with the geometry of the fitted centres and beam.
struct DwellPoints<'a> {
    bench: &'a LaserSetup<'a>,
    grouped: &'a Grouped,
    /// Outward normal of the sphere at each dwell point, machine frame.
    normals: Vec<Vector3<f64>>,
    /// −cos of the incidence angle: derivative of the distance by the reading.
    along: Vec<f64>,
}

/// All sources. `latency_index`: index of the first latency unknown among all unknowns.
pub fn sources(
    bench: &LaserSetup<'_>,
    observed: &Observed,
    grouped: &Grouped,
    x: &[f64],
    latency_index: usize,
) -> Vec<UncertaintySource> {
    let centres = &grouped.centres;
    let normal = |row| unit_vector(centres.arm(x, row)).unwrap_or_default();
    let normals: Vec<Vector3<f64>> = centres.rows.iter().map(normal).collect();
    let beam = unit_vector(centres.beam(x)).unwrap_or_default();
    let along = centres.rows.iter().zip(&normals);
    let along = along.map(|(row, n)| match bench.touches() {
        true => -1.0,
        false => n.dot(&(row.spindle * beam)),
    });
    let along = along.collect();
    let points = DwellPoints { bench, grouped, normals, along };
    let mut list = vec![
        points.noise(noise_mm(bench, observed)),
        points.resolution(),
        points.linearity(),
        points.lobing(),
        points.backlash(observed),
        points.linear_axes(),
        points.angular_motions(x),
        points.rotary_axes(x),
        points.drift(),
        points.interruptions(&observed.stops),
        points.radius(),
        points.squareness(),
        points.form(),
        points.incidence(),
    ];
    let latency = observed.latency.as_ref();
    list.extend(latency.map(|latency| points.latency(latency, latency_index)));
    list.retain(|source| !source.is_zero());
    list
}

/// A source that affects all centres alike. The residuals do not change its size, and it does not enter the weights.
fn unjudged(name: &str, effect: Effect) -> UncertaintySource {
    UncertaintySource {
        in_residuals: InResiduals::Expected,
        is_in_weights: false,
        ..UncertaintySource::new(name, effect)
    }
}

impl DwellPoints<'_> {
    fn noise(&self, sample_mm: f64) -> UncertaintySource {
        let spots = self.grouped.spots.iter().zip(&self.along);
        let each =
            spots.map(|(spot, along)| sample_mm * along.abs() / (spot.samples as f64).sqrt());
        let name = match self.bench.touches() {
            true => "repeatability of a touch",
            false => "noise of the sensor",
        };
        let noise = UncertaintySource::new(name, Effect::Each(each.collect()));
        UncertaintySource { evaluation: EvaluationType::A, ..noise }
    }

    fn resolution(&self) -> UncertaintySource {
        let each = self.normals.iter().map(|n| declared::resolution_mm(self.bench.plan, *n));
        let source = UncertaintySource::new("resolution of the axes", Effect::Each(each.collect()));
        UncertaintySource { shape: Shape::Rectangular, ..source }
    }

    /// The sensor's linearity error: a smooth random function of the reading.
    fn linearity(&self) -> UncertaintySource {
        let readings: Vec<f64> = self.grouped.spots.iter().map(|spot| spot.value).collect();
        let patterns = declared::linearity_patterns(&self.bench.sensor, &readings);
        let columns =
            patterns.iter().map(|p| p.iter().zip(&self.along).map(|(p, a)| p * a).collect());
        UncertaintySource::new("linearity of the sensor", Effect::Joint(columns.collect()))
    }

    /// Lobing of the touch probe.
    fn lobing(&self) -> UncertaintySource {
        let rows = self.grouped.centres.rows.iter().filter(|_| self.bench.touches());
        let normals = rows.zip(&self.normals).map(|(row, n)| row.spindle.inverse() * n);
        let patterns = declared::lobing_patterns(self.bench.plan, &normals.collect::<Vec<_>>());
        UncertaintySource::new("probe lobing", Effect::Joint(patterns))
    }

    /// Backlash of the linear axes. Continuous scans estimate it together with the latency. Otherwise the axes lag
    /// at a dwell point on the side that they came from: along the `path` of all readings, those of the search and
    /// those without a value among them.
    fn backlash(&self, observed: &Observed) -> UncertaintySource {
        let half = declared::half_backlash_mm(self.bench.plan);
        let path: Vec<Vector3<f64>> = observed.path.iter().map(|(_, xyz)| *xyz).collect();
        let along_path = declared::lags_mm(self.bench.plan, &path);
        let lag = |(spot, normal): (&Spot, &Vector3<f64>)| {
            let next = observed.path.partition_point(|(t_s, _)| *t_s <= spot.t_s);
            match self.bench.touches() {
                // The motion of a touch is opposite to the normal.
                true => normal.zip_map(&half, |n, half| half * n.signum()),
                false => along_path[..next].last().copied().unwrap_or_default(),
            }
        };
        let is_found = observed.latency.is_some();
        let spots = self.grouped.spots.iter().zip(&self.normals).filter(|_| !is_found);
        let lags: Vec<Vector3<f64>> = spots.map(lag).collect();
        let column = |k: usize| lags.iter().zip(&self.normals).map(move |(lag, n)| n[k] * lag[k]);
        let columns = [0, 1, 2].map(|k| column(k).collect());
        unjudged("backlash", Effect::Joint(columns.into()))
    }

    fn linear_axes(&self) -> UncertaintySource {
        let positions: Vec<_> = self.grouped.spots.iter().map(|spot| spot.xyz).collect();
        let patterns = declared::linear_motion_patterns(self.bench.plan, &positions);
        let along = |k: usize, pattern: &[f64]| {
            self.normals.iter().zip(pattern).map(|(n, p)| n[k] * p).collect::<Vec<f64>>()
        };
        let columns = patterns.iter().flat_map(|pattern| [0, 1, 2].map(|k| along(k, pattern)));
        UncertaintySource::new("error motions of X, Y and Z", Effect::Joint(columns.collect()))
    }

    /// Angular error motions of the linear axes. They are the same for all dwell points of a pose, as a rotation of
    /// the sphere about its centre has no effect.
    fn angular_motions(&self, x: &[f64]) -> UncertaintySource {
        let axes = |(i, group): (usize, &Group)| group.axes(self.grouped.centres.centre(x, i));
        let points: Vec<Vector3<f64>> = self.grouped.groups.iter().enumerate().map(axes).collect();
        let patterns = declared::angular_motion_patterns(self.bench.plan, &points);
        let column = |(error, angles): &(ErrorParameter, Vec<f64>)| {
            let shifts = self.by_error(x, *error).into_iter().zip(angles);
            self.along_normals(&shifts.map(|(shift, angle)| shift * *angle).collect::<Vec<_>>())
        };
        let effect = Effect::Joint(patterns.iter().map(column).collect());
        UncertaintySource::new("angular error motions of X, Y and Z", effect)
    }

    fn rotary_axes(&self, x: &[f64]) -> UncertaintySource {
        let motions =
            declared::rotary_motions(self.bench.plan, &declared::MOTION_ORDERS).into_iter();
        let columns = motions.map(|motion| self.rotary_axis(x, motion));
        UncertaintySource::new("error motions of rotary axes", Effect::Joint(columns.collect()))
    }

    fn rotary_axis(&self, x: &[f64], motion: RotaryMotion) -> Vec<f64> {
        let shifts = self.by_error(x, motion.error).into_iter();
        self.along_normals(&shifts.map(|shift| shift * motion.size_mm).collect::<Vec<_>>())
    }

    /// Displacement of each pose by one unit of an error, machine frame.
    fn by_error(&self, x: &[f64], error: ErrorParameter) -> Vec<Vector3<f64>> {
        let (chain, tip) = (&self.bench.chain, Point::from_vec(self.bench.zero()));
        let of_group = |(i, group): (usize, &Group)| {
            let at = placed(&group.rotary, group.axes(self.grouped.centres.centre(x, i)));
            let column = chain.jacobian(&at, tip, &[], &[error]);
            group.table * column.first().copied().unwrap_or_default()
        };
        self.grouped.groups.iter().enumerate().map(of_group).collect()
    }

    /// Components along the normals of `shifts`, one per pose.
    fn along_normals(&self, shifts: &[Vector3<f64>]) -> Vec<f64> {
        let rows = self.grouped.centres.rows.iter().zip(&self.normals);
        rows.map(|(row, n)| n.dot(&shifts[row.group])).collect()
    }

    /// Drift of the table relative to the spindle at the declared rate, zero at the middle of the run.
    fn drift(&self) -> UncertaintySource {
        let rate = declared::drift_mm_per_s(self.bench.plan);
        let spots = &self.grouped.spots;
        let mean = spots.iter().map(|spot| spot.t_s).sum::<f64>() / spots.len().max(1) as f64;
        let along = |k: usize| {
            let spots = spots.iter().zip(&self.normals);
            spots.map(|(spot, n)| n[k] * rate * (spot.t_s - mean)).collect()
        };
        UncertaintySource::new("thermal drift", Effect::Joint((0..3).map(along).collect()))
    }

    /// Shift between the points before and after an interruption, up to the limit of the reference check. The whole
    /// limit counts as standard uncertainty, as the distribution is unknown.
    fn interruptions(&self, stops: &[(f64, f64)]) -> UncertaintySource {
        let columns = stops.iter().flat_map(|(gap_s, limit_mm)| {
            (0..3).map(move |k| {
                let size = limit_mm * self.least_seen(k);
                let spots = self.grouped.spots.iter().zip(&self.normals);
                spots.map(|(s, n)| if s.t_s > *gap_s { n[k] * size } else { 0.0 }).collect()
            })
        });
        UncertaintySource::new("steps at interruptions", Effect::Joint(columns.collect()))
    }

    /// Displacement of the sphere along an axis, mm, that changes a reference by 1 mm. 1 if no reference is
    /// sensitive to it.
    fn least_seen(&self, k: usize) -> f64 {
        let steps = self.bench.plan.steps.iter();
        let references = steps.filter(|step| step.kind == StepKind::Reference);
        let seen = references.map(|step| seen_along(step, k, self.bench.radius()));
        let most = seen.fold(0.0, f64::max);
        if most > 0.0 { 1.0 / most } else { 1.0 }
    }

    fn radius(&self) -> UncertaintySource {
        // The radius of a touched sphere is an unknown.
        let stated = if self.bench.touches() { 0.0 } else { self.bench.settings.radius_u_um };
        let u = stated * 1e-3;
        unjudged("radius of the sphere", Effect::Joint(vec![vec![-u; self.normals.len()]]))
    }

    /// The latency and the lost motion of the axes, which are correlated.
    fn latency(&self, latency: &Latency, latency_index: usize) -> UncertaintySource {
        let grouped = self.grouped;
        let rows = grouped.centres.rows.iter().zip(&grouped.spots).zip(&self.normals);
        let each: Vec<Vec<f64>> = rows
            .map(|((row, spot), n)| {
                let travel = grouped.groups[row.group].travel;
                let moved = latency.columns(spot.velocity, spot.last_motion_sign).into_iter();
                moved.map(|by| n.dot(&(travel * by))).collect()
            })
            .collect();
        let (mut columns, mut direct_changes) = (Vec::new(), Vec::new());
        for draw in latency.root.col_iter() {
            let of = |by: &Vec<f64>| by.iter().zip(draw.iter()).map(|(by, size)| by * size).sum();
            columns.push(each.iter().map(of).collect());
            let mut change = vec![0.0; latency_index];
            change.extend(draw.iter());
            direct_changes.push(change);
        }
        UncertaintySource {
            evaluation: EvaluationType::A,
            direct_changes,
            ..unjudged("latency of the sensor", Effect::Joint(columns))
        }
    }
}

/// Response of a reference to a displacement of the sphere by 1 mm along an axis. Across the beam only the flanks
/// of the sphere respond.
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
