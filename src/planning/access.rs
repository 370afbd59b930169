//! Accessible touches of a ball at a rotary position. The checks here are simple and conservative; the proof of the
//! stage (module `proof`) makes the final decision.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix4, Vector3};

use super::PlanningError;
use super::surroundings::{MIN_TOOL_CLEARANCE_MM, Surroundings};
use machine::frame::Pose;
use machine::kinematics::KinematicsError;
use machine::record::artefact::{Artefact, Ball};
use machine::record::machine::{Carrier, Machine, Probe};
use machine::record::plan::Plan;
use machine::{Axis, Position};

/// Alternatives to each of the four touches around the ball: offset in azimuth, and elevation, degrees. The smallest
/// offset comes first, because touches on the equator determine the centre best.
const ALTERNATIVE_AZIMUTH_OFFSET_AND_ELEVATION_DEG: [(f64, f64); 12] = [
    (0.0, 0.0),
    (0.0, 15.0),
    (15.0, 0.0),
    (-15.0, 0.0),
    (0.0, 30.0),
    (15.0, 15.0),
    (-15.0, 15.0),
    (30.0, 0.0),
    (-30.0, 0.0),
    (30.0, 30.0),
    (-30.0, 30.0),
    (0.0, 45.0),
];
/// Names and azimuths, degrees, of the four touches around the ball; paper 4, section 3.
const SIDE_TOUCH_AZIMUTHS_DEG: [(&str, f64); 4] = [("+45", 45.0), ("-135", -135.0), ("-45", -45.0), ("+135", 135.0)];
pub const POLE_TOUCH_DIRECTION_NAME: &str = "pole";
/// Number of candidate points on the upper half of the ball for touches in addition to the pole and the four sides.
const SPREAD_TOUCH_CANDIDATE_COUNT: u32 = 90;
/// Maximum standard deviation of the fitted centre in its worst direction, relative to that of one touch; with all
/// five touches it is 1.1.
const MAX_CENTRE_TO_TOUCH_SD_RATIO: f64 = 3.0;

/// Distance by which a search touch goes beyond the ball's position uncertainty, mm, so that contact always occurs.
const SEARCH_OVERRUN_MM: f64 = 0.3;

/// Search or measurement of a ball, with the lengths of its touches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BallTouchMode {
    /// At the search feed, over a length that finds the ball anywhere within `uncertainty_mm` of its expected position.
    Search { uncertainty_mm: f64, standoff_mm: f64 },
    /// At the measuring feed, along the normals of the ball at its found position: from `standoff_mm` before the
    /// expected contact to `search_mm` beyond it.
    Measure { standoff_mm: f64, search_mm: f64 },
}

/// A measurement of one ball to be planned.
#[derive(Debug, Clone, Copy)]
pub struct BallMeasurementRequest<'a> {
    /// The ball with its expected centre, table frame.
    pub ball: &'a Ball,
    /// Positions of all rotary axes, and of S if the spindle must be oriented.
    pub rotary: &'a Position,
    pub touch_mode: BallTouchMode,
    /// Number of touches: 5, or more for a check of form; fewer if some are not free, but at least 4. Not used for
    /// touches along given directions.
    pub touch_count: usize,
}

impl BallTouchMode {
    pub(super) fn touch_extent(self) -> TouchExtent {
        match self {
            Self::Search { uncertainty_mm, standoff_mm } => TouchExtent {
                before_mm: uncertainty_mm + standoff_mm,
                beyond_mm: uncertainty_mm + SEARCH_OVERRUN_MM,
                max_ball_misplacement_mm: uncertainty_mm,
            },
            Self::Measure { standoff_mm, search_mm } => {
                TouchExtent { before_mm: standoff_mm, beyond_mm: search_mm, max_ball_misplacement_mm: search_mm }
            }
        }
    }

    pub(super) fn feed_mm_min(self, probe: &Probe) -> f64 {
        match self {
            Self::Search { .. } => probe.search_feed_mm_min,
            Self::Measure { .. } => probe.feed_mm_min,
        }
    }
}

/// Name and outward normal of a touch that no obstacle blocks.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchDirection {
    /// `+45`, `-135`, `-45`, `+135` or `pole`: the nominal direction, even if the touch is moved away from an obstacle.
    /// Further touches are named by azimuth and elevation, e.g. `+117^35`.
    pub name: String,
    /// Outward normal, machine frame.
    pub normal: Vector3<f64>,
}

impl TouchDirection {
    /// Sort key: azimuth from X towards Y, rad; the pole comes last.
    fn sort_key(&self) -> f64 {
        if self.name == POLE_TOUCH_DIRECTION_NAME { TAU } else { self.normal.y.atan2(self.normal.x).rem_euclid(TAU) }
    }
}

/// Reason why a ball cannot be measured at a rotary position. `value`, `min`, `max` in mm or degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BallAccessError {
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("the target {axis} {value:.3} is outside the limits [{min}, {max}]")]
    OutOfTravel { axis: Axis, value: f64, min: f64, max: f64 },
    #[error("the machine has no axis {axis}")]
    UnknownAxis { axis: Axis },
    #[error("the rotary position has no value for {axis}")]
    MissingAxisPosition { axis: Axis },
    #[error("the spindle is tilted; balls can be touched only with the spindle axis along Z")]
    SpindleTilted,
    /// In the touch of this name, the part `tool` of the tool would come too near to the obstacle.
    #[error("touch {touch}: the {tool} would come too near to the {obstacle}")]
    ObstacleTooNear { touch: String, tool: String, obstacle: String },
    /// The `free` accessible touches are too few or too near to each other. `reason`: why the first blocked touch is
    /// not accessible.
    #[error("the {free} accessible touches are too few or too near to each other; first blocked touch: {reason}")]
    TooFewTouches { free: usize, reason: Box<BallAccessError> },
    /// The touch ends `beyond_mm` beyond the expected contact, less than `uncertainty_mm`, the largest misplacement of
    /// the ball.
    #[error(
        "a touch ends {beyond_mm} mm beyond the expected contact, but the position uncertainty of the ball is \
         {uncertainty_mm} mm: the touch could miss the ball"
    )]
    SearchTooShort { beyond_mm: f64, uncertainty_mm: f64 },
    /// A touch, in any touch mode, is longer than the probe's overtravel, mm.
    #[error("the search is {length:.3} mm long, more than the probe's overtravel of {overtravel} mm")]
    SearchTooLong { length: f64, overtravel: f64 },
}

/// Start and end of a touch along the normal, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TouchExtent {
    /// Distance before the expected contact at which the touch starts.
    pub before_mm: f64,
    /// Distance beyond the expected contact at which the touch ends.
    pub beyond_mm: f64,
    /// Maximum distance of the ball from its expected position, mm.
    pub max_ball_misplacement_mm: f64,
}

/// Checks which touches are accessible, from the machine and everything on it.
#[derive(Debug, Clone)]
pub struct TouchAccess {
    pub(super) surroundings: Surroundings,
    pub(super) machine: Machine,
    stylus_ball_radius_mm: f64,
}

impl TouchAccess {
    /// `artefact`: all balls and stems at their assumed positions; the checks enlarge them by the uncertainty of the
    /// artefact.
    ///
    /// # Errors
    /// The machine has no kinematics.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let surroundings = Surroundings::new(plan, artefact)?;
        Ok(Self { surroundings, machine: plan.machine.clone(), stylus_ball_radius_mm: plan.probe.ball_radius_mm })
    }

    /// Distance between the centres of ball and stylus ball in contact, mm.
    pub(super) fn contact_distance_mm(&self, ball: &Ball) -> f64 {
        ball.radius_mm + self.stylus_ball_radius_mm
    }

    /// Selects the requested number of free, well distributed touches of a ball: first the pole, which must be free,
    /// and the four sides, of which at least three must be free, then others. The order is by azimuth, with the pole
    /// last.
    ///
    /// # Errors
    /// The reason: an obstacle to a touch, an axis out of travel, a tilted spindle, too few free touches, or a touch
    /// too short to meet the ball at its largest misplacement.
    pub fn accessible_touches(
        &self,
        request: &BallMeasurementRequest<'_>,
    ) -> Result<Vec<TouchDirection>, BallAccessError> {
        let BallMeasurementRequest { rotary, touch_mode, touch_count, .. } = *request;
        self.check_rotary_position(rotary)?;
        let beyond_mm = touch_mode.touch_extent().beyond_mm;
        let uncertainty_mm = self.surroundings.max_artefact_misplacement_mm;
        // As in the proof, a touch that is too short to meet the ball at every possible position is refused.
        if beyond_mm < uncertainty_mm {
            return Err(BallAccessError::SearchTooShort { beyond_mm, uncertainty_mm });
        }
        let spindle = self.spindle_pose_without_s(rotary)?;
        let normal = |azimuth: f64, elevation: f64| spindle.transform_vector(&unit_direction(azimuth, elevation));
        let free = |contact: &TouchDirection| self.check_touch_is_free(request, contact);
        let mut blocked = None;
        let mut contacts = Vec::new();
        for (name, azimuth) in SIDE_TOUCH_AZIMUTHS_DEG {
            let at = |(turn, up): &(f64, f64)| new_touch_direction(name, normal(azimuth + turn, *up));
            match ALTERNATIVE_AZIMUTH_OFFSET_AND_ELEVATION_DEG.iter().map(at).find(|contact| free(contact).is_ok()) {
                Some(contact) => contacts.push(contact),
                None => blocked = blocked.or(free(&at(&ALTERNATIVE_AZIMUTH_OFFSET_AND_ELEVATION_DEG[0])).err()),
            }
        }
        let pole = new_touch_direction(POLE_TOUCH_DIRECTION_NAME, normal(0.0, 90.0));
        free(&pole)?;
        contacts.push(pole);
        let enough = contacts.len() >= 4 && worst_centre_to_touch_sd_ratio(&contacts) <= MAX_CENTRE_TO_TOUCH_SD_RATIO;
        if let (false, Some(reason)) = (enough, blocked) {
            return Err(BallAccessError::TooFewTouches { free: contacts.len(), reason: Box::new(reason) });
        }
        let needs_more = touch_count > contacts.len() && touch_count > SIDE_TOUCH_AZIMUTHS_DEG.len() + 1;
        let spread = spread_touch_directions().filter(|_| needs_more);
        let spread = spread.map(|(name, azimuth, up)| TouchDirection { name, normal: normal(azimuth, up) });
        let more: Vec<TouchDirection> = spread.filter(|contact| free(contact).is_ok()).collect();
        add_farthest_touches(&mut contacts, more, touch_count);
        // In order of azimuth, so that the path from touch to touch is short; the pole comes last.
        contacts.sort_by(|one, other| one.sort_key().total_cmp(&other.sort_key()));
        Ok(contacts)
    }

    /// Touches of a ball along `directions`: azimuth and elevation, degrees, in the spindle frame without the rotation
    /// of S. The directions give the names. Error: the first direction that is not free.
    pub(super) fn touches_along_directions(
        &self,
        request: &BallMeasurementRequest<'_>,
        directions: &[[f64; 2]],
    ) -> Result<Vec<TouchDirection>, BallAccessError> {
        self.check_rotary_position(request.rotary)?;
        let spindle = self.spindle_pose_without_s(request.rotary)?;
        let contact = |[azimuth, elevation]: &[f64; 2]| {
            let normal = spindle.transform_vector(&unit_direction(*azimuth, *elevation));
            let contact = TouchDirection { name: format!("{azimuth:+}^{elevation}"), normal };
            self.check_touch_is_free(request, &contact)?;
            Ok(contact)
        };
        directions.iter().map(contact).collect()
    }

    /// Spindle frame without the rotation of S.
    fn spindle_pose_without_s(&self, rotary: &Position) -> Result<Pose, BallAccessError> {
        if !self.surroundings.is_spindle_upright(rotary) {
            return Err(BallAccessError::SpindleTilted);
        }
        let carried = self.surroundings.chain.carrier_chain(Carrier::Spindle);
        let commands = Axis::ALL.map(|axis| rotary.get_or_zero(axis));
        Ok(carried.map_or(Pose::identity(), |carried| carried.pose(&commands)))
    }

    /// Checks that each rotary axis except S has a position, and that all rotary positions are within the travel.
    fn check_rotary_position(&self, rotary: &Position) -> Result<(), BallAccessError> {
        let turning = self.machine.axes.keys().filter(|axis| !axis.is_linear());
        for axis in turning.filter(|axis| **axis != Axis::S) {
            rotary.get(*axis).ok_or(BallAccessError::MissingAxisPosition { axis: *axis })?;
        }
        self.check_within_travel(&rotary.filter_axes(|axis| !axis.is_linear()))
    }

    fn check_within_travel(&self, position: &Position) -> Result<(), BallAccessError> {
        for (axis, value) in position.iter() {
            let spec = self.machine.axes.get(&axis).ok_or(BallAccessError::UnknownAxis { axis })?;
            let (value, min, max) = (axis.to_mm_or_deg(value), spec.min, spec.max);
            if !(min - 1e-9..=max + 1e-9).contains(&value) {
                return Err(BallAccessError::OutOfTravel { axis, value, min, max });
            }
        }
        Ok(())
    }

    /// Position of X, Y, Z and the rotary axes at which the centre of the stylus ball is at distance `distance_mm`
    /// from the centre of the ball along `normal` (machine frame).
    pub(super) fn position_beside_ball(
        &self,
        ball: &Ball,
        rotary: &Position,
        normal: Vector3<f64>,
        distance_mm: f64,
    ) -> Result<Position, KinematicsError> {
        let table = self.surroundings.chain.machine_from_table(rotary, &[]).rotation;
        let target = Vector3::from(ball.centre_mm) + table.inverse() * normal * distance_mm;
        self.surroundings.position_at_table_point(target, rotary)
    }

    /// Checks that the touch, up to the largest misplacement of the ball, and the Z above its start that clears all
    /// bodies are within the travel. Checks also that no obstacle is nearer than the minimum clearance between the
    /// start and the expected contact; the touched ball needs no clearance.
    fn check_touch_is_free(
        &self,
        request: &BallMeasurementRequest<'_>,
        contact: &TouchDirection,
    ) -> Result<(), BallAccessError> {
        let BallMeasurementRequest { ball, rotary, touch_mode, .. } = *request;
        let (extent, contact_distance_mm) = (touch_mode.touch_extent(), self.contact_distance_mm(ball));
        let place =
            |distance_mm| self.position_beside_ball(ball, rotary, contact.normal, contact_distance_mm + distance_mm);
        let (from, touched) = (place(extent.before_mm)?, place(0.0)?);
        self.check_within_travel(&from)?;
        self.check_within_travel(&place(-extent.max_ball_misplacement_mm)?)?;
        let over = self.surroundings.clear_z_command_on_path(&from, &from, MIN_TOOL_CLEARANCE_MM);
        // `over` is −∞ if no body is below; then no clearance height is needed.
        if over > f64::NEG_INFINITY {
            self.check_within_travel(&from.clone().with(Axis::Z, over))?;
        }
        let own = format!("ball {}", ball.id);
        match self.surroundings.find_near_obstacle(&from, &touched, MIN_TOOL_CLEARANCE_MM, &own) {
            None => Ok(()),
            Some(near) => Err(BallAccessError::ObstacleTooNear {
                touch: contact.name.clone(),
                tool: near.tool_or_sensor_name,
                obstacle: near.obstacle_name,
            }),
        }
    }
}

fn new_touch_direction(name: &str, normal: Vector3<f64>) -> TouchDirection {
    TouchDirection { name: name.to_owned(), normal }
}

/// Unit vector in the spindle frame: azimuth from X towards Y, elevation from the equator to the
/// pole.
fn unit_direction(azimuth_deg: f64, elevation_deg: f64) -> Vector3<f64> {
    let ((sin, cos), (up, out)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
    Vector3::new(out * cos, out * sin, up)
}

/// Name, azimuth and elevation (degrees) of points spread evenly from the equator up to 75°: a spiral with the golden
/// angle.
fn spread_touch_directions() -> impl Iterator<Item = (String, f64, f64)> {
    let golden = 180.0 * (3.0 - 5.0_f64.sqrt());
    (0..SPREAD_TOUCH_CANDIDATE_COUNT).map(move |k| {
        let height = 75.0_f64.to_radians().sin() * f64::from(k) / f64::from(SPREAD_TOUCH_CANDIDATE_COUNT);
        let azimuth = (golden * f64::from(k) + 180.0).rem_euclid(360.0) - 180.0;
        let (azimuth, up) = (azimuth.round(), (height.asin() * 180.0 / PI).round());
        (format!("{azimuth:+}^{up}"), azimuth, up)
    })
}

/// Adds contacts from `more` up to `touch_count`, each time the contact farthest from all present contacts.
fn add_farthest_touches(contacts: &mut Vec<TouchDirection>, mut more: Vec<TouchDirection>, touch_count: usize) {
    while contacts.len() < touch_count {
        let nearest = |one: &TouchDirection| {
            let angles = contacts.iter().map(|other| other.normal.dot(&one.normal));
            angles.fold(f64::NEG_INFINITY, f64::max)
        };
        let apart =
            |(_, a): &(usize, &TouchDirection), (_, b): &(usize, &TouchDirection)| nearest(a).total_cmp(&nearest(b));
        let Some((index, _)) = more.iter().enumerate().min_by(apart) else { return };
        contacts.push(more.remove(index));
    }
}

/// Upper bound of the standard deviation of the fitted centre in its worst direction, relative to that of one touch;
/// centre and radius are fitted. Infinite if the touches do not determine centre and radius.
fn worst_centre_to_touch_sd_ratio(contacts: &[TouchDirection]) -> f64 {
    let rows = contacts.iter().map(|contact| contact.normal.push(1.0));
    let information: Matrix4<f64> = rows.map(|row| row * row.transpose()).sum();
    if information.determinant() < 1e-6 {
        return f64::INFINITY;
    }
    let Some(cofactor) = information.try_inverse() else { return f64::INFINITY };
    // Upper bound of the largest eigenvalue.
    (0..3).map(|i| cofactor.column(i).xyz().abs().sum()).fold(0.0, f64::max).sqrt()
}
