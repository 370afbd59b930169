//! True balls on their stems.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::SimulatedWorldError;
use super::nearest_surface::NearestSurface;
use super::random_draws::{RandomSource, draw_ball_oval, draw_normal};
use super::truth::MachineTruth;
use machine::frame::unit_vector;
use machine::record::artefact::{self, REFERENCE_TEMPERATURE_C};

/// The balls of a ball artefact with their true positions, sizes and forms.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct TrueBalls {
    balls: Vec<TrueBall>,
}

/// One ball with its true errors.
#[derive(Debug, Clone, PartialEq)]
struct TrueBall {
    /// True centre without the timed displacements, table frame, mm.
    centre: Vector3<f64>,
    /// True mean radius, mm.
    radius: f64,
    /// Matrix F, mm, that adds uᵀ·F·u to the radius along the unit vector u: an oval.
    form_matrix: Matrix3<f64>,
    /// `None`: the ball has no stem that can be touched.
    stem: Option<BallStem>,
    /// Radius about the centre of a sphere that contains ball and stem.
    enclosing_radius: f64,
    /// Displacements of the centre, mm, each with the time, s, from which on it is added; they accumulate.
    timed_displacements: Vec<(f64, Vector3<f64>)>,
}

/// A cylinder with flat ends that begins at the ball's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
struct BallStem {
    /// Unit vector from the ball's centre along the stem.
    direction: Vector3<f64>,
    /// Length from the centre of the ball.
    length_mm: f64,
    radius_mm: f64,
}

impl TrueBalls {
    /// True balls at the true artefact temperature, with their distances set to the certified lengths.
    ///
    /// # Errors
    /// There is no ball, or a ball has a centre or a radius that is not possible.
    pub fn new(stated: &artefact::Balls, truth: &MachineTruth) -> Result<Self, SimulatedWorldError> {
        let balls = stated.balls.iter().enumerate();
        let mut balls: Vec<TrueBall> = balls.map(|(i, ball)| TrueBall::new(i, ball, truth)).collect();
        // This also rejects NaN, because every comparison with NaN is false.
        if balls.is_empty() || !balls.iter().all(TrueBall::is_valid) {
            return Err(SimulatedWorldError::InvalidBalls);
        }
        let [expansion, u_expansion] = stated.relative_expansion_and_u();
        let scale =
            1.0 + expansion + u_expansion * draw_normal(truth.seed, RandomSource::ArtefactTemperatureError, &[]);
        balls.iter_mut().for_each(|ball| ball.centre *= scale);
        move_balls_to_certified_lengths(&mut balls, stated, truth);
        Ok(Self { balls })
    }

    /// Surface nearest to `point` at the time `t_s`. Point and result: table frame. If `point` is inside several
    /// bodies: the surface of the one that it is deepest in.
    pub fn nearest(&self, point: Vector3<f64>, t_s: f64) -> NearestSurface {
        let far = NearestSurface::no_surface_within(f64::INFINITY);
        let relative_point = |ball: &TrueBall| point - ball.displacement_at(t_s);
        let min_distance = |ball: &TrueBall| ball.ball_distance_lower_bound(relative_point(ball));
        // The ball with the smallest lower bound comes first: most other balls then need no oval iteration.
        let first = self.balls.iter().min_by(|a, b| min_distance(a).total_cmp(&min_distance(b)));
        let best = first.map_or(far, |ball| ball.nearer_surface(relative_point(ball), far));
        self.balls.iter().fold(best, |best, ball| ball.nearer_surface(relative_point(ball), best))
    }

    /// True centre of the ball at `index`, with its displacements up to `t_s`, table frame, mm.
    #[cfg(test)]
    pub fn centre(&self, index: usize, t_s: f64) -> Vector3<f64> {
        self.balls[index].centre + self.balls[index].displacement_at(t_s)
    }
}

impl TrueBall {
    fn new(index: usize, stated: &artefact::Ball, truth: &MachineTruth) -> Self {
        let own = truth.ball.iter().find(|ball| ball.id == stated.id).cloned().unwrap_or_default();
        let moves = truth.ball_moves.iter().filter(|moved| moved.ball == stated.id);
        let along = unit_vector(Vector3::from(stated.stem)).unwrap_or_default();
        let (length, radius) = (stated.stem_length_mm, stated.stem_radius_mm);
        let draw = |part| draw_normal(truth.seed, RandomSource::BallDeviation, &[index as u64, part]);
        let diameter_um = own.diameter_um + truth.ball_diameter_um * draw(3);
        let form_um = own.form_um.unwrap_or(truth.ball_form_um);
        let has_stem = length > 0.0 && radius > 0.0 && along != Vector3::zeros();
        let stem = has_stem.then_some(BallStem { direction: along, length_mm: length, radius_mm: radius });
        let ball_radius = stated.radius_mm + truth.radius_offset_mm + diameter_um * 0.5e-3;
        let form_matrix = draw_ball_oval(truth.seed, index) * (form_um * 1e-3);
        let max_ball_radius = ball_radius + form_deviation_bound(&form_matrix);
        Self {
            centre: Vector3::from(stated.centre_mm)
                + truth.artefact_offset_mm()
                + Vector3::from(own.offset_mm)
                + Vector3::new(draw(0), draw(1), draw(2)) * truth.ball_offset_mm,
            radius: ball_radius,
            form_matrix,
            stem,
            enclosing_radius: stem.map_or(max_ball_radius, |stem| max_ball_radius.max(stem.farthest_point_distance())),
            timed_displacements: moves.map(|moved| (moved.at_s, Vector3::from(moved.by_mm))).collect(),
        }
    }

    /// Whether the centre is finite, and the radius is finite and exceeds the bound of the form deviation.
    fn is_valid(&self) -> bool {
        let centre = self.centre.iter().all(|coordinate| coordinate.is_finite());
        centre && self.radius > form_deviation_bound(&self.form_matrix) && self.radius.is_finite()
    }

    /// Sum of the displacements that have begun at `t_s`.
    fn displacement_at(&self, t_s: f64) -> Vector3<f64> {
        self.timed_displacements.iter().filter(|(from, _)| *from <= t_s).map(|(_, by)| *by).sum()
    }

    /// Lower bound of the distance between `point` (table frame) and the ball.
    fn ball_distance_lower_bound(&self, point: Vector3<f64>) -> f64 {
        (point - self.centre).norm() - self.radius - form_deviation_bound(&self.form_matrix)
    }

    /// Returns `best` or the surface of this ball with its stem, whichever is nearer to `point` (table frame).
    fn nearer_surface(&self, point: Vector3<f64>, best: NearestSurface) -> NearestSurface {
        let from_centre = point - self.centre;
        if from_centre.norm() - self.enclosing_radius >= best.signed_distance {
            return best;
        }
        let may_be_nearer = self.ball_distance_lower_bound(point) < best.signed_distance;
        let best = if may_be_nearer { best.or_nearer(self.nearest_ball_surface(from_centre)) } else { best };
        self.stem.map_or(best, |stem| best.or_nearer(stem.nearest(from_centre)))
    }

    /// Signed distance and outward normal at the point of the ball's surface that is nearest to `from_centre`, a
    /// point relative to the ball's centre. Solves `from_centre` = r(u)·u + distance·normal(u) for the direction u of
    /// the nearest point. On a round ball, u is the direction of the point; for an oval of micrometres, each
    /// iteration reduces the error to about a thousandth.
    fn nearest_ball_surface(&self, from_centre: Vector3<f64>) -> NearestSurface {
        let mut direction = unit_vector(from_centre).unwrap_or(Vector3::z());
        let mut nearest =
            NearestSurface { signed_distance: from_centre.norm() - self.radius, outward_normal: direction };
        if self.form_matrix == Matrix3::zeros() {
            return nearest;
        }
        for _ in 0..MAX_PERPENDICULAR_ITERATIONS {
            let form_product = self.form_matrix * direction;
            let form_deviation = direction.dot(&form_product);
            let radius = self.radius + form_deviation;
            let slope = 2.0 * (form_product - direction * form_deviation);
            let normal = (direction - slope / radius).normalize();
            let distance = (from_centre - direction * radius).dot(&normal);
            nearest = NearestSurface { signed_distance: distance, outward_normal: normal };
            let next = unit_vector(from_centre - normal * distance).unwrap_or(direction);
            if (next - direction).norm_squared() < PERPENDICULAR_FOOT_CONVERGENCE_RAD2 {
                break;
            }
            direction = next;
        }
        nearest
    }
}

/// Upper bound of the deviation of an oval from its mean radius, mm.
fn form_deviation_bound(form_matrix: &Matrix3<f64>) -> f64 {
    2.0 * form_matrix.abs().sum()
}

/// Maximum number of iterations of the search for the nearest point of an oval.
const MAX_PERPENDICULAR_ITERATIONS: usize = 30;
/// Squared change of angle, rad², below which the foot of a perpendicular has converged.
const PERPENDICULAR_FOOT_CONVERGENCE_RAD2: f64 = 1e-28;

impl BallStem {
    /// Distance of the stem's farthest point from the ball's centre.
    fn farthest_point_distance(&self) -> f64 {
        self.length_mm.hypot(self.radius_mm)
    }

    /// Surface of the stem nearest to `from_centre`, a point relative to the ball's centre.
    fn nearest(&self, from_centre: Vector3<f64>) -> NearestSurface {
        let along = from_centre.dot(&self.direction);
        let across = from_centre - self.direction * along;
        let (reach, outward) = (across.norm(), unit_vector(across).unwrap_or(Vector3::x()));
        let side = reach - self.radius_mm;
        let end = (along - self.length_mm / 2.0).abs() - self.length_mm / 2.0;
        let cap = self.direction * (along - self.length_mm / 2.0).signum();
        NearestSurface::from_prism_side_and_end(side, outward, end, cap)
    }
}

/// Moves the balls until their distances equal the certified lengths, plus the drawn error of the certificate,
/// the true temperature and the declared faults. Both balls of a length move by the same amount; the corrections
/// alternate where balls share lengths.
fn move_balls_to_certified_lengths(balls: &mut [TrueBall], stated: &artefact::Balls, truth: &MachineTruth) {
    let ball_indices: BTreeMap<&str, usize> =
        stated.balls.iter().enumerate().map(|(i, ball)| (ball.id.as_str(), i)).collect();
    for _ in 0..MAX_CERTIFIED_LENGTH_ITERATIONS {
        let mut max_correction = 0.0_f64;
        for (number, length) in stated.lengths.iter().enumerate() {
            let ends = (ball_indices.get(length.from.as_str()), ball_indices.get(length.to.as_str()));
            let (Some(&from), Some(&to)) = ends else { continue };
            let separation = balls[to].centre - balls[from].centre;
            let shortfall = true_certified_length_mm(number, length, truth) - separation.norm();
            let half = unit_vector(separation).unwrap_or(Vector3::x()) * (shortfall / 2.0);
            balls[from].centre -= half;
            balls[to].centre += half;
            max_correction = max_correction.max(shortfall.abs());
        }
        if max_correction < 1e-13 {
            return;
        }
    }
}

/// Maximum number of passes over all certified lengths.
const MAX_CERTIFIED_LENGTH_ITERATIONS: usize = 1000;

/// The certified length with the drawn errors of certificate and temperature, at the true temperature, and with
/// `length_error_um_per_m`.
fn true_certified_length_mm(length_index: usize, length: &artefact::CertifiedLength, truth: &MachineTruth) -> f64 {
    let draw = |part| draw_normal(truth.seed, RandomSource::CertifiedLengthError, &[length_index as u64, part]);
    let temperature_rise_k = length.temperature_c.unwrap_or(REFERENCE_TEMPERATURE_C) - REFERENCE_TEMPERATURE_C
        + length.u_temperature_k * draw(1);
    let certified = length.mm + length.u_mm * draw(0);
    certified
        * (1.0 + length.expansion_um_per_m_k * 1e-6 * temperature_rise_k)
        * (1.0 + truth.length_error_um_per_m * 1e-6)
}
