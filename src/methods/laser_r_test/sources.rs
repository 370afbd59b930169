//! Sources of uncertainty: the change of each dwell point's distance from the sphere's centre by each draw, mm. The
//! magnitudes are declared by the plan (METHODS section 6).

use nalgebra::Vector3;

use super::centre_equations::ScanPoint;
use super::latency::LatencyEstimate;
use super::measured_scan::SampleMean;
use super::observe::{Interruption, ObservedScans};
use super::pose_groups::{GroupedScans, PoseGroup, sample_std_dev_mm};
use super::setup::LaserSetup;
use super::sphere_model::with_linear_axes;
use crate::identification::declared_sources::{self, DEFAULT_ROTARY_MOTION_ORDERS, RotaryErrorMotion};
use crate::identification::{
    DrawDistribution, EvaluationType, ObservationEffect, ResidualTreatment, UncertaintySource,
};
use machine::Position;
use machine::frame::{Point, unit_vector};
use machine::kinematics::ErrorParameter;
use machine::record::plan::{Step, StepKind};

/// Dwell points with the geometry of the fitted centres and beam.
struct ScanPointGeometry<'a> {
    setup: &'a LaserSetup<'a>,
    grouped: &'a GroupedScans,
    /// Outward normal of the sphere at each dwell point, machine frame.
    normals: Vec<Vector3<f64>>,
    /// Derivative of the distance from the sphere's centre by the reading, at each dwell point: −cos of the incidence
    /// angle; −1 for a touch.
    distance_derivative_by_reading: Vec<f64>,
}

/// All sources with an effect. `x`: unknowns of the centre fit. `first_latency_unknown`: index of the first latency
/// unknown among the unknowns of the combined fit.
pub fn uncertainty_sources(
    setup: &LaserSetup<'_>,
    observed: &ObservedScans,
    grouped: &GroupedScans,
    x: &[f64],
    first_latency_unknown: usize,
) -> Vec<UncertaintySource> {
    let centres = &grouped.centre_equations;
    let normal = |row: &ScanPoint| unit_vector(centres.centre_to_spot(x, row)).unwrap_or_default();
    let normals: Vec<Vector3<f64>> = centres.scan_points.iter().map(normal).collect();
    let beam = unit_vector(centres.beam_vector(x)).unwrap_or_default();
    let along = |(row, n): (&ScanPoint, &Vector3<f64>)| match setup.uses_touch_probe() {
        true => -1.0,
        false => n.dot(&(row.machine_from_spindle * beam)),
    };
    let distance_per_reading = centres.scan_points.iter().zip(&normals).map(along).collect();
    let points = ScanPointGeometry { setup, grouped, normals, distance_derivative_by_reading: distance_per_reading };
    let mut list = vec![
        points.noise_source(sample_std_dev_mm(setup, observed)),
        points.resolution_source(),
        points.linearity_source(),
        points.lobing_source(),
        points.backlash_source(observed),
        points.linear_error_motion_source(),
        points.angular_motion_source(x),
        points.rotary_error_motion_source(x),
        points.drift_source(),
        points.interruption_source(&observed.interruptions),
        points.radius_source(),
        points.squareness_source(),
        points.form_source(),
        points.incidence_source(),
    ];
    let latency = observed.latency.as_ref();
    list.extend(latency.map(|latency| points.latency_source(latency, first_latency_unknown)));
    list.retain(|source| !source.is_zero());
    list
}

/// A source that affects all centres alike. The residuals do not change its size, and it does not enter the weights.
fn common_source(name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
    UncertaintySource::new_unweighted(name, columns, ResidualTreatment::InExpectedChi2)
}

impl ScanPointGeometry<'_> {
    /// One entry for each dwell point, from its mean and its normal.
    fn column(&self, effect: impl Fn(&SampleMean, &Vector3<f64>) -> f64) -> Vec<f64> {
        self.grouped.sample_means.iter().zip(&self.normals).map(|(spot, n)| effect(spot, n)).collect()
    }

    fn noise_source(&self, sample_std_dev_mm: f64) -> UncertaintySource {
        let sample_means = self.grouped.sample_means.iter().zip(&self.distance_derivative_by_reading);
        let each =
            sample_means.map(|(spot, along)| sample_std_dev_mm * along.abs() / (spot.sample_count as f64).sqrt());
        let name = if self.setup.uses_touch_probe() { "repeatability of a touch" } else { "noise of the sensor" };
        let noise = UncertaintySource::new(name, ObservationEffect::Independent(each.collect()));
        UncertaintySource { evaluation: EvaluationType::A, ..noise }
    }

    fn resolution_source(&self) -> UncertaintySource {
        let each = self.normals.iter().map(|n| declared_sources::resolution_u_mm(self.setup.plan, *n));
        let source = UncertaintySource::new("resolution of the axes", ObservationEffect::Independent(each.collect()));
        UncertaintySource { draw_distribution: DrawDistribution::Rectangular, ..source }
    }

    /// The sensor's linearity error: a smooth random function of the reading.
    fn linearity_source(&self) -> UncertaintySource {
        let readings: Vec<f64> = self.grouped.sample_means.iter().map(|spot| spot.reading_mm).collect();
        let patterns = declared_sources::linearity_patterns(&self.setup.sensor, &readings);
        let columns =
            patterns.iter().map(|p| p.iter().zip(&self.distance_derivative_by_reading).map(|(p, a)| p * a).collect());
        UncertaintySource::new("linearity of the sensor", ObservationEffect::Joint(columns.collect()))
    }

    /// Lobing of the touch probe.
    fn lobing_source(&self) -> UncertaintySource {
        let rows = self.grouped.centre_equations.scan_points.iter().filter(|_| self.setup.uses_touch_probe());
        let normals = rows.zip(&self.normals).map(|(row, n)| row.machine_from_spindle.inverse() * n);
        let patterns = declared_sources::lobing_patterns(self.setup.plan, &normals.collect::<Vec<_>>());
        UncertaintySource::new("probe lobing", ObservationEffect::Joint(patterns))
    }

    /// Backlash of the linear axes. Continuous scans estimate it together with the latency. At a dwell point an axis
    /// lags behind its last motion, which follows from the path of all readings, including those of the search and
    /// those without a value.
    fn backlash_source(&self, observed: &ObservedScans) -> UncertaintySource {
        let half = declared_sources::half_backlash_mm(self.setup.plan);
        let path: Vec<Vector3<f64>> = observed.positions_by_time.iter().map(|(_, xyz)| *xyz).collect();
        let along_path = declared_sources::backlash_lags_mm(self.setup.plan, &path);
        let lag = |(spot, normal): (&SampleMean, &Vector3<f64>)| {
            let next = observed.positions_by_time.partition_point(|(t_s, _)| *t_s <= spot.time_in_run_s);
            match self.setup.uses_touch_probe() {
                // The motion of a touch is opposite to the normal.
                true => normal.zip_map(&half, |n, half| half * n.signum()),
                false => along_path[..next].last().copied().unwrap_or_default(),
            }
        };
        let is_estimated = observed.latency.is_some();
        let sample_means = self.grouped.sample_means.iter().zip(&self.normals).filter(|_| !is_estimated);
        let lags: Vec<Vector3<f64>> = sample_means.map(lag).collect();
        let column = |k: usize| lags.iter().zip(&self.normals).map(move |(lag, n)| n[k] * lag[k]);
        let columns = [0, 1, 2].map(|k| column(k).collect());
        common_source("backlash", columns.into())
    }

    fn linear_error_motion_source(&self) -> UncertaintySource {
        let positions: Vec<_> = self.grouped.sample_means.iter().map(|spot| spot.linear_axis_positions_mm).collect();
        let patterns = declared_sources::linear_motion_patterns(self.setup.plan, &positions);
        let along =
            |k: usize, pattern: &[f64]| self.normals.iter().zip(pattern).map(|(n, p)| n[k] * p).collect::<Vec<f64>>();
        let columns = patterns.iter().flat_map(|pattern| [0, 1, 2].map(|k| along(k, pattern)));
        UncertaintySource::new("error motions of X, Y and Z", ObservationEffect::Joint(columns.collect()))
    }

    /// Angular error motions of the linear axes. A rotation of the sensor about the sphere's centre does not change the
    /// reading, so the lever arm of each dwell point ends at the centre.
    fn angular_motion_source(&self, x: &[f64]) -> UncertaintySource {
        let (centres, setup) = (&self.grouped.centre_equations, self.setup);
        let positions: Vec<Vector3<f64>> =
            self.grouped.sample_means.iter().map(|spot| spot.linear_axis_positions_mm).collect();
        let patterns = declared_sources::angular_motion_patterns(setup.plan, &positions);
        let errors: Vec<ErrorParameter> = patterns.iter().map(|(error, _)| *error).collect();
        let shifts = centres.scan_points.iter().zip(&positions).zip(&self.normals).map(|((row, xyz), n)| {
            let group = &self.grouped.groups[row.group_index];
            let missing = centres.group_centre(x, row.group_index) - row.spindle_displacement_from_table_mm;
            let centre = setup.zero_point() + row.machine_from_spindle.inverse() * missing;
            let at = with_linear_axes(&group.rotary, *xyz);
            let columns = setup.chain.error_jacobian(&at, Point::from_vec(centre), &[], &errors);
            columns.iter().map(|column| n.dot(&(group.machine_from_table * column))).collect::<Vec<f64>>()
        });
        let shifts: Vec<Vec<f64>> = shifts.collect();
        let column = |(k, (_, angles)): (usize, &(ErrorParameter, Vec<f64>))| {
            shifts.iter().zip(angles).map(|(shift, angle)| shift[k] * angle).collect()
        };
        let effect = ObservationEffect::Joint(patterns.iter().enumerate().map(column).collect());
        UncertaintySource::new("angular error motions of X, Y and Z", effect)
    }

    fn rotary_error_motion_source(&self, x: &[f64]) -> UncertaintySource {
        let motions = declared_sources::rotary_error_motions(self.setup.plan, &DEFAULT_ROTARY_MOTION_ORDERS);
        let columns = motions.into_iter().map(|motion| self.rotary_motion_column(x, motion));
        UncertaintySource::new("error motions of rotary axes", ObservationEffect::Joint(columns.collect()))
    }

    /// Components along the normals of the displacement of each pose by an error motion.
    fn rotary_motion_column(&self, x: &[f64], motion: RotaryErrorMotion) -> Vec<f64> {
        let (chain, tip) = (&self.setup.chain, Point::from_vec(self.setup.zero_point()));
        let shift = |(i, group): (usize, &PoseGroup)| {
            let at = group.axis_positions(self.grouped.centre_equations.group_centre(x, i));
            let column = chain.error_jacobian(&at, tip, &[], &[motion.error]);
            group.machine_from_table * column.first().copied().unwrap_or_default() * motion.coefficient_sd_mm
        };
        let shifts: Vec<Vector3<f64>> = self.grouped.groups.iter().enumerate().map(shift).collect();
        let rows = self.grouped.centre_equations.scan_points.iter().zip(&self.normals);
        rows.map(|(row, n)| n.dot(&shifts[row.group_index])).collect()
    }

    /// Drift of the table relative to the spindle at the declared rate, zero at the mean time of the points.
    fn drift_source(&self) -> UncertaintySource {
        let rate = declared_sources::drift_rate_sd_mm_per_s(self.setup.plan);
        let sample_means = &self.grouped.sample_means;
        let mean = sample_means.iter().map(|spot| spot.time_in_run_s).sum::<f64>() / sample_means.len().max(1) as f64;
        let along = |k: usize| self.column(|spot, n| n[k] * rate * (spot.time_in_run_s - mean));
        UncertaintySource::new("thermal drift", ObservationEffect::Joint((0..3).map(along).collect()))
    }

    /// Shift between the points before and after an interruption, by which the sphere may move before a reference
    /// exceeds its limit. The whole shift counts as standard uncertainty, as the distribution is unknown.
    fn interruption_source(&self, interruptions: &[Interruption]) -> UncertaintySource {
        let columns = interruptions.iter().flat_map(|interruption| {
            [0, 1, 2].map(|k| {
                let size = interruption.shift_limit_mm * self.sphere_displacement_per_reference_change(k);
                self.column(|spot, n| if spot.time_in_run_s > interruption.time_in_run_s { n[k] * size } else { 0.0 })
            })
        });
        UncertaintySource::new("steps at interruptions", ObservationEffect::Joint(columns.collect()))
    }

    /// Displacement of the sphere along the linear axis `axis_index`, mm, that changes the most sensitive reading of a
    /// reference by 1 mm; 1 if no reference responds.
    fn sphere_displacement_per_reference_change(&self, axis_index: usize) -> f64 {
        let steps = self.setup.plan.steps.iter();
        let references = steps.filter(|step| step.kind == StepKind::Reference);
        let responses =
            references.map(|step| max_reference_response_per_mm(step, axis_index, self.setup.measuring_radius_mm()));
        let most = responses.fold(0.0, f64::max);
        if most > 0.0 { 1.0 / most } else { 1.0 }
    }

    fn radius_source(&self) -> UncertaintySource {
        // The radius of a touched sphere is an unknown.
        let u = if self.setup.uses_touch_probe() { 0.0 } else { self.setup.settings.radius_u_um * 1e-3 };
        common_source("radius of the sphere", vec![vec![-u; self.normals.len()]])
    }

    /// The latency and the lost motion of the axes, which are correlated.
    fn latency_source(&self, latency: &LatencyEstimate, first_latency_unknown: usize) -> UncertaintySource {
        let grouped = self.grouped;
        let rows = grouped.centre_equations.scan_points.iter().zip(&grouped.sample_means).zip(&self.normals);
        let each: Vec<Vec<f64>> = rows
            .map(|((row, spot), n)| {
                let machine_from_xyz = grouped.groups[row.group_index].machine_from_xyz;
                let moved = latency.position_derivatives(spot.velocity, spot.last_motion_sign).into_iter();
                moved.map(|by| n.dot(&(machine_from_xyz * by))).collect()
            })
            .collect();
        let (mut columns, mut direct_changes) = (Vec::new(), Vec::new());
        for draw in latency.covariance_root.col_iter() {
            let change = |derivatives: &Vec<f64>| derivatives.iter().zip(draw.iter()).map(|(by, size)| by * size).sum();
            columns.push(each.iter().map(change).collect());
            let mut direct_change = vec![0.0; first_latency_unknown];
            direct_change.extend(draw.iter());
            direct_changes.push(direct_change);
        }
        UncertaintySource {
            evaluation: EvaluationType::A,
            direct_unknown_changes: direct_changes,
            ..common_source("latency of the sensor", columns)
        }
    }

    /// Squareness errors: X moves in proportion to Y and Z, Y in proportion to Z.
    fn squareness_source(&self) -> UncertaintySource {
        const SQUARENESS_AXIS_PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];
        let sigma = self.setup.plan.machine.squareness_urad * 1e-6;
        let sample_means = &self.grouped.sample_means;
        let sum: Vector3<f64> = sample_means.iter().map(|spot| spot.linear_axis_positions_mm).sum();
        let mean = sum / sample_means.len().max(1) as f64;
        let column = |(along, by): (usize, usize)| {
            self.column(|spot, n| n[along] * sigma * (spot.linear_axis_positions_mm[by] - mean[by]))
        };
        let columns = SQUARENESS_AXIS_PAIRS.map(column).into();
        UncertaintySource::new("squareness of X, Y and Z", ObservationEffect::Joint(columns))
    }

    /// Second-degree form error that turns with the table: the radius along a unit vector u changes by uᵀ·S·u, S
    /// symmetric and without trace, of the declared standard deviation along every u.
    fn form_source(&self) -> UncertaintySource {
        let sigma = self.setup.settings.form_u_um * 1e-3;
        let groups = &self.grouped.groups;
        let rows = self.grouped.centre_equations.scan_points.iter().zip(&self.normals);
        let outward = rows.map(|(row, normal)| groups[row.group_index].machine_from_table.inverse() * normal);
        let outward: Vec<Vector3<f64>> = outward.collect();
        let column = |effect: &dyn Fn(&Vector3<f64>) -> f64| outward.iter().map(|u| sigma * effect(u)).collect();
        // Variances 1 on the diagonal and 1/2 off the diagonal, minus the trace: the variance along every u is 2/3.
        let own = |k: usize| column(&move |u| 1.5f64.sqrt() * (u[k] * u[k] - 1.0 / 3.0));
        let mixed = |i: usize, j: usize| column(&move |u| 3f64.sqrt() * u[i] * u[j]);
        let columns = [own(0), own(1), own(2), mixed(0, 1), mixed(0, 2), mixed(1, 2)];
        UncertaintySource::new("form of the sphere", ObservationEffect::Joint(columns.into()))
    }

    /// Reading error on a surface that is inclined to the beam: one part proportional to the squared tangent of the
    /// inclination, two proportional to the tangent along two perpendicular directions. Each has the declared
    /// standard deviation at 45°.
    fn incidence_source(&self) -> UncertaintySource {
        let name = "lean of the surface";
        let sigma = self.setup.sensor.incidence_um * 1e-3;
        // Touches are all around the sphere: the tangent of the inclination is not bounded there.
        if sigma == 0.0 || self.setup.uses_touch_probe() {
            return common_source(name, Vec::new());
        }
        let frame = self.grouped.centre_equations.beam_frame;
        let inclinations = self.grouped.centre_equations.scan_points.iter().zip(&self.normals).map(|(row, normal)| {
            let n = (row.machine_from_spindle * frame).transpose() * normal;
            // If the surface faces the beam, n is (0, 0, −1).
            [n.x / -n.z, n.y / -n.z]
        });
        let inclinations: Vec<[f64; 2]> = inclinations.collect();
        let column = |effect: fn(&[f64; 2]) -> f64| {
            let rows = inclinations.iter().zip(&self.distance_derivative_by_reading);
            rows.map(|(inclination, along)| sigma * along * effect(inclination)).collect()
        };
        let columns = [column(|[x, y]| x * x + y * y), column(|[x, _]| *x), column(|[_, y]| *y)];
        common_source(name, columns.into())
    }
}

/// Largest change of a reading of a reference, mm, if the sphere is displaced by 1 mm along the axis `k`. Across the
/// beam only readings on the flanks of the sphere change.
fn max_reference_response_per_mm(step: &Step, k: usize, radius: f64) -> f64 {
    let normal = unit_vector(Vector3::from(step.normal)).unwrap_or_default();
    let path: Vec<Vector3<f64>> = step.scan.iter().flat_map(|scan| &scan.path).map(Position::xyz_or_zero).collect();
    let middle = path.iter().sum::<Vector3<f64>>() / path.len().max(1) as f64;
    let outward = path.iter().map(|at| {
        let offset = at - middle;
        let across = offset - normal * (offset.dot(&normal) / normal.norm_squared());
        across + normal * (radius * radius - across.norm_squared()).max(0.0).sqrt()
    });
    let responses = outward.map(|n| (n[k] / n.dot(&normal)).abs());
    responses.fold(normal[k].abs(), f64::max)
}
