//! A simulated operator at the simulated machine: observes its true motion, deflects its stylus and answers
//! prompts.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{Speed, World};
use machine::record::question::{Answer, AxisDirection, Jog, Question, Seen, Stylus};
use machine::{Axis, Position};

/// Smallest motion that the operator sees, mm or degrees.
const MIN_VISIBLE_MOTION: f64 = 0.05;
/// Resolution of a distance that the operator judges by eye, mm or degrees.
const VISUAL_RESOLUTION: f64 = 0.1;

pub struct SimulatedOperator {
    world: Arc<Mutex<World>>,
    /// True position at which a jog was allowed.
    before: Position,
}

impl SimulatedOperator {
    pub fn new(world: Arc<Mutex<World>>) -> Self {
        Self { world, before: Position::new() }
    }

    pub fn answer(&mut self, question: &Question) -> Answer {
        match question {
            Question::Shows(told) => self.shows(told),
            Question::MayJog { .. } | Question::MayHold(_) => {
                let stands = self.world().true_axes();
                self.before = stands;
                Answer::Yes
            }
            Question::Jogged { jog, .. } => Answer::Saw(self.saw(jog)),
            Question::Stylus(stylus) => {
                self.world().deflect(*stylus == Stylus::Deflected);
                Answer::Yes
            }
            Question::RetractDirection { .. } => self.leads_out(),
            Question::Released { .. } | Question::May { .. } => Answer::Yes,
        }
    }

    /// Moves an axis by hand, mm or degrees.
    pub fn shove(&self, axis: Axis, by: f64) {
        let mut world = self.world();
        let to = world.position().at(axis) + axis.from_edge(by);
        world.travel(&Position::new().with(axis, to), Speed::Rapid);
    }

    /// Whether the display agrees with the position that the control reports.
    fn shows(&self, told: &Position) -> Answer {
        let shown = self.world().position();
        let differs =
            |(axis, at): (Axis, f64)| axis.to_edge(at - shown.at(axis)).abs() > MIN_VISIBLE_MOTION;
        if told.iter().any(differs) { Answer::No } else { Answer::Yes }
    }

    /// The direction that frees the stylus most; `No` without contact, or if a finger deflects the stylus.
    fn leads_out(&self) -> Answer {
        let world = self.world();
        if world.deflected || !world.touches() {
            return Answer::No;
        }
        let freed = |direction: &AxisDirection| {
            let (axis, mut tried) = (direction.axis, world.clone());
            let by = if direction.is_positive { VISUAL_RESOLUTION } else { -VISUAL_RESOLUTION };
            tried.travel(&Position::new().with(axis, tried.position().at(axis) + by), Speed::Rapid);
            tried.margin_here()
        };
        let directions = Axis::LINEAR
            .into_iter()
            .flat_map(|axis| [true, false].map(|is_positive| AxisDirection { axis, is_positive }));
        let best = directions.max_by(|one, other| freed(one).total_cmp(&freed(other)));
        best.map_or(Answer::No, Answer::Retract)
    }

    fn saw(&self, jog: &Jog) -> Seen {
        let stands = self.world().true_axes();
        let gone = stands.iter().map(|(axis, at)| (axis, axis.to_edge(at - self.before.at(axis))));
        let farthest = gone.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
        match farthest.filter(|(_, by)| by.abs() > MIN_VISIBLE_MOTION) {
            None => Seen::Nothing,
            Some((axis, _)) if axis != jog.axis => Seen::Another(axis),
            Some((_, by)) if (by - jog.by).abs() <= VISUAL_RESOLUTION => Seen::AsSaid,
            Some((_, by)) if (by + jog.by).abs() <= VISUAL_RESOLUTION => Seen::OtherWay,
            Some((_, by)) => Seen::Distance((by / VISUAL_RESOLUTION).round() * VISUAL_RESOLUTION),
        }
    }

    fn world(&self) -> MutexGuard<'_, World> {
        // The world is plain data: a panic elsewhere leaves it consistent.
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
