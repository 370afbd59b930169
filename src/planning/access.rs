//! Accessible touches of a ball at a rotary position. The bounds are simple and conservative; the final decision is
//! the proof's.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix4, Vector3};

use super::PlanningError;
use super::surroundings::{CLEAR, Surroundings};
use machine::frame::{Point, Pose};
use machine::kinematics::KinematicsError;
use machine::record::artefact::{Artefact, Ball};
use machine::record::machine::{Carrier, Machine};
use machine::record::plan::Plan;
use machine::{Axis, Position};

/// Alternatives to each of the four touches round the ball: offset in azimuth, and elevation, degrees. The smallest
/// offset comes first, because touches on the equator determine the centre best.
const ALTERNATIVE_OFFSETS: [(f64, f64); 12] = [
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
/// Names and azimuths, degrees, of the four touches round the ball; paper 4, section 3.
const ROUND: [(&str, f64); 4] = [("+45", 45.0), ("-135", -135.0), ("-45", -45.0), ("+135", 135.0)];
pub const POLE: &str = "pole";
/// Number of candidate points, spread over the upper half, for touches beyond the five.
const SPREAD_POINTS: u32 = 90;
/// Maximum standard deviation of the fitted centre in its worst direction, relative to that of one touch; with all
/// five touches it is 1.1.
const MAX_CENTRE_SD_RATIO: f64 = 3.0;

/// One free touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// Name: `+45`, `-135`, `-45`, `+135` or `pole` for the nominal position, although the touch may be moved away
    /// from an obstacle; further touches by azimuth and elevation, `+117^35`.
    pub name: String,
    /// Outward normal, machine frame.
    pub normal: Vector3<f64>,
}

impl Contact {
    /// Sort key: azimuth from X towards Y, rad; the pole comes last.
    fn place(&self) -> f64 {
        if self.name == POLE { TAU } else { self.normal.y.atan2(self.normal.x).rem_euclid(TAU) }
    }
}

/// Reason why a ball cannot be measured at a rotary position. `value`, `min`, `max` in mm or degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Unreachable {
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("{axis} would go to {value:.3}, outside [{min}, {max}]")]
    OutOfTravel { axis: Axis, value: f64, min: f64, max: f64 },
    #[error("the machine has no axis {axis}")]
    NoAxis { axis: Axis },
    #[error("the rotary position does not say where {axis} stands")]
    Incomplete { axis: Axis },
    #[error("the spindle does not stand upright, and balls are touched from above only")]
    Tilted,
    #[error("the {tool} would come too near to the {obstacle} at the touch {touch}")]
    InTheWay { touch: String, tool: String, obstacle: String },
    #[error(
        "{free} touches are free, too few or too near to each other; the first that is not: {why}"
    )]
    TooFew { free: usize, why: Box<Unreachable> },
    #[error(
        "a touch goes {beyond} mm beyond the contact expected, and the ball may stand {loose} mm off its \
         place: it could miss it"
    )]
    TooShort { beyond: f64, loose: f64 },
    #[error("the search would be {length:.3} mm long, more than the overtravel of {overtravel} mm")]
    TooLong { length: f64, overtravel: f64 },
}

/// Start and end of a touch along the normal, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TouchExtent {
    pub out: f64,
    /// Distance beyond the expected contact at which the touch ends.
    pub beyond: f64,
    /// Maximum distance of the ball from its expected position, mm.
    pub loose: f64,
}

/// Checks which touches are accessible, from the machine and everything on it.
#[derive(Debug, Clone)]
pub struct Access {
    pub(super) about: Surroundings,
    pub(super) machine: Machine,
    ball_radius: f64,
}

impl Access {
    /// Builds the check. `artefact`: all balls and stems at their assumed positions, enlarged by its uncertainty.
    ///
    /// # Errors
    /// The machine has no kinematics.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let about = Surroundings::new(plan, artefact)?;
        Ok(Self { about, machine: plan.machine.clone(), ball_radius: plan.probe.ball_radius_mm })
    }

    /// Distance between the centres of ball and stylus ball in contact, mm.
    pub(super) fn reach(&self, ball: &Ball) -> f64 {
        ball.radius_mm + self.ball_radius
    }

    /// Free touches of `ball` with the rotary axes as in `rotary`: `touches` of them, the five of the paper first;
    /// at least four, including the pole, and well distributed.
    pub(super) fn contacts(
        &self,
        ball: &Ball,
        rotary: &Position,
        stand: TouchExtent,
        touches: usize,
    ) -> Result<Vec<Contact>, Unreachable> {
        self.check_rotary(rotary)?;
        // Same rule as in the proof: a touch is long enough to meet the ball at every possible position.
        let (beyond, loose) = (stand.beyond, self.about.loose);
        if beyond < loose {
            return Err(Unreachable::TooShort { beyond, loose });
        }
        let spindle = self.spindle(rotary)?;
        let normal =
            |azimuth: f64, elevation: f64| spindle.transform_vector(&on_sphere(azimuth, elevation));
        let free = |contact: &Contact| self.free(ball, rotary, contact, stand);
        let mut blocked = None;
        let mut contacts = Vec::new();
        for (name, azimuth) in ROUND {
            let at = |(turn, up): &(f64, f64)| named(name, normal(azimuth + turn, *up));
            match ALTERNATIVE_OFFSETS.iter().map(at).find(|contact| free(contact).is_ok()) {
                Some(contact) => contacts.push(contact),
                None => blocked = blocked.or(free(&at(&ALTERNATIVE_OFFSETS[0])).err()),
            }
        }
        let pole = named(POLE, normal(0.0, 90.0));
        free(&pole)?;
        contacts.push(pole);
        let enough = contacts.len() >= 4 && worst_direction(&contacts) <= MAX_CENTRE_SD_RATIO;
        if let (false, Some(why)) = (enough, blocked) {
            return Err(Unreachable::TooFew { free: contacts.len(), why: Box::new(why) });
        }
        let more =
            spread().map(|(name, azimuth, up)| Contact { name, normal: normal(azimuth, up) });
        let more: Vec<Contact> = if touches > contacts.len() && touches > ROUND.len() + 1 {
            more.filter(|contact| free(contact).is_ok()).collect()
        } else {
            Vec::new()
        };
        extend(&mut contacts, more, touches);
        // Neighbours are adjacent; the pole comes last.
        contacts.sort_by(|one, other| one.place().total_cmp(&other.place()));
        Ok(contacts)
    }

    /// Touches of `ball` along `directions`: azimuth and elevation, degrees, in the spindle frame without the
    /// rotation of S. The directions give the names.
    pub(super) fn contacts_along(
        &self,
        ball: &Ball,
        rotary: &Position,
        stand: TouchExtent,
        directions: &[[f64; 2]],
    ) -> Result<Vec<Contact>, Unreachable> {
        self.check_rotary(rotary)?;
        let spindle = self.spindle(rotary)?;
        let contact = |[azimuth, elevation]: &[f64; 2]| {
            let normal = spindle.transform_vector(&on_sphere(*azimuth, *elevation));
            let contact = Contact { name: format!("{azimuth:+}^{elevation}"), normal };
            self.free(ball, rotary, &contact, stand)?;
            Ok(contact)
        };
        directions.iter().map(contact).collect()
    }

    /// Spindle frame without the rotation of S.
    fn spindle(&self, rotary: &Position) -> Result<Pose, Unreachable> {
        if !self.about.upright(rotary) {
            return Err(Unreachable::Tilted);
        }
        let carried = self.about.chain.carried(Carrier::Spindle);
        let commands = Axis::ALL.map(|axis| rotary.at(axis));
        Ok(carried.map_or(Pose::identity(), |carried| carried.pose(&commands)))
    }

    fn check_rotary(&self, rotary: &Position) -> Result<(), Unreachable> {
        let turning = self.machine.axes.keys().filter(|axis| !axis.is_linear());
        for axis in turning.filter(|axis| **axis != Axis::S) {
            rotary.get(*axis).ok_or(Unreachable::Incomplete { axis: *axis })?;
        }
        self.check_travel(&rotary.only(|axis| !axis.is_linear()))
    }

    fn check_travel(&self, position: &Position) -> Result<(), Unreachable> {
        for (axis, value) in position.iter() {
            let spec = self.machine.axes.get(&axis).ok_or(Unreachable::NoAxis { axis })?;
            let (value, min, max) = (axis.to_edge(value), spec.min, spec.max);
            if !(min - 1e-9..=max + 1e-9).contains(&value) {
                return Err(Unreachable::OutOfTravel { axis, value, min, max });
            }
        }
        Ok(())
    }

    /// Position of X, Y, Z and the rotary axes at which the stylus ball is at distance `far` from the ball's centre
    /// along the normal.
    pub(super) fn position(
        &self,
        ball: &Ball,
        rotary: &Position,
        normal: Vector3<f64>,
        far: f64,
    ) -> Result<Position, KinematicsError> {
        let chain = &self.about.chain;
        let table = chain.machine_from_table(rotary, &[]).rotation;
        let target = Vector3::from(ball.centre_mm) + table.inverse() * normal * far;
        let rotary = rotary.only(|axis| !axis.is_linear());
        let linear =
            chain.linear_axes_for(Point::from_vec(target), self.about.tip, &rotary, &[])?;
        Ok(rotary.updated_by(&linear))
    }

    fn free(
        &self,
        ball: &Ball,
        rotary: &Position,
        contact: &Contact,
        stand: TouchExtent,
    ) -> Result<(), Unreachable> {
        let reach = self.reach(ball);
        let place = |far| self.position(ball, rotary, contact.normal, reach + far);
        let (from, touched) = (place(stand.out)?, place(0.0)?);
        self.check_travel(&from)?;
        self.check_travel(&place(-stand.loose)?)?;
        let over = self.about.z_between(&from, &from, CLEAR);
        // Nothing is below: no height is needed.
        if over > f64::NEG_INFINITY {
            self.check_travel(&from.clone().with(Axis::Z, over))?;
        }
        let own = format!("ball {}", ball.id);
        match self.about.near(&from, &touched, CLEAR, &own) {
            None => Ok(()),
            Some(near) => Err(Unreachable::InTheWay {
                touch: contact.name.clone(),
                tool: near.tool,
                obstacle: near.obstacle,
            }),
        }
    }
}

fn named(name: &str, normal: Vector3<f64>) -> Contact {
    Contact { name: name.to_owned(), normal }
}

/// Unit vector from angles in degrees, spindle frame: azimuth from X towards Y, elevation from the equator to the
/// pole.
fn on_sphere(azimuth: f64, elevation: f64) -> Vector3<f64> {
    let ((sin, cos), (up, out)) =
        (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    Vector3::new(out * cos, out * sin, up)
}

/// Points spread evenly from the equator up to 75°: a spiral with the golden angle.
fn spread() -> impl Iterator<Item = (String, f64, f64)> {
    let golden = 180.0 * (3.0 - 5.0_f64.sqrt());
    (0..SPREAD_POINTS).map(move |k| {
        let height = 75.0_f64.to_radians().sin() * f64::from(k) / f64::from(SPREAD_POINTS);
        let azimuth = (golden * f64::from(k) + 180.0).rem_euclid(360.0) - 180.0;
        let (azimuth, up) = (azimuth.round(), (height.asin() * 180.0 / PI).round());
        (format!("{azimuth:+}^{up}"), azimuth, up)
    })
}

/// Adds contacts one after the other, each time the one farthest from all present contacts.
fn extend(contacts: &mut Vec<Contact>, mut more: Vec<Contact>, touches: usize) {
    while contacts.len() < touches {
        let nearest = |one: &Contact| {
            let angles = contacts.iter().map(|other| other.normal.dot(&one.normal));
            angles.fold(f64::NEG_INFINITY, f64::max)
        };
        let apart = |(_, a): &(usize, &Contact), (_, b): &(usize, &Contact)| {
            nearest(a).total_cmp(&nearest(b))
        };
        let Some((index, _)) = more.iter().enumerate().min_by(apart) else { return };
        contacts.push(more.remove(index));
    }
}

/// Standard deviation of the fitted centre in its worst direction, relative to that of one touch; centre and radius
/// are fitted.
fn worst_direction(contacts: &[Contact]) -> f64 {
    let rows = contacts.iter().map(|contact| contact.normal.push(1.0));
    let information: Matrix4<f64> = rows.map(|row| row * row.transpose()).sum();
    if information.determinant() < 1e-6 {
        return f64::INFINITY;
    }
    let Some(cofactor) = information.try_inverse() else { return f64::INFINITY };
    // Upper bound of the largest eigenvalue.
    (0..3).map(|i| cofactor.column(i).xyz().abs().sum()).fold(0.0, f64::max).sqrt()
}
