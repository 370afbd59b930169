//! A simulated operator at the simulated machine: observes its true motion, deflects its stylus and answers
//! prompts.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{SimulatedWorld, Speed};
use machine::record::question::{AxisDirection, Jog, ObservedMotion, OperatorAnswer, OperatorQuestion, StylusState};
use machine::{Axis, Position};

/// Largest motion or difference that the operator overlooks, mm or degrees.
const MIN_VISIBLE_MOTION: f64 = 0.05;
/// Resolution and tolerance of a distance that the operator judges by eye, mm or degrees.
const VISUAL_DISTANCE_RESOLUTION: f64 = 0.1;

/// Answers questions about the simulated machine truthfully, from its true motion.
pub struct SimulatedOperator {
    world: Arc<Mutex<SimulatedWorld>>,
    /// True position when the operator allowed the current jog.
    true_position_before_jog: Position,
}

impl SimulatedOperator {
    pub fn new(world: Arc<Mutex<SimulatedWorld>>) -> Self {
        Self { world, true_position_before_jog: Position::new() }
    }

    /// Answers the question; deflects or releases the stylus if the question requests it.
    pub fn answer(&mut self, question: &OperatorQuestion) -> OperatorAnswer {
        match question {
            OperatorQuestion::DisplayedPosition(reported) => self.compare_display(reported),
            OperatorQuestion::AllowJog { .. } | OperatorQuestion::AllowJogWithHold(_) => {
                let true_position = self.lock_world().true_axis_positions();
                self.true_position_before_jog = true_position;
                OperatorAnswer::Yes
            }
            OperatorQuestion::ObservedJog { jog, .. } => OperatorAnswer::Motion(self.observed_motion(jog)),
            OperatorQuestion::StylusState(stylus) => {
                self.lock_world().set_stylus_deflected(*stylus == StylusState::Deflected);
                OperatorAnswer::Yes
            }
            OperatorQuestion::RetractDirection { .. } => self.retract_direction(),
            OperatorQuestion::HoldReleased { .. } | OperatorQuestion::AllowAction { .. } => OperatorAnswer::Yes,
        }
    }

    /// Moves an axis by hand, mm or degrees.
    pub fn move_axis_by_hand(&self, axis: Axis, by_mm_or_deg: f64) {
        let mut world = self.lock_world();
        let to = world.displayed_position().get_or_zero(axis) + axis.to_mm_or_rad(by_mm_or_deg);
        world.travel(&Position::new().with(axis, to), Speed::Rapid);
    }

    /// `Yes` if the display agrees with the position that the control reports.
    fn compare_display(&self, reported: &Position) -> OperatorAnswer {
        let displayed = self.lock_world().displayed_position();
        let differs =
            |(axis, at): (Axis, f64)| axis.to_mm_or_deg(at - displayed.get_or_zero(axis)).abs() > MIN_VISIBLE_MOTION;
        if reported.iter().any(differs) { OperatorAnswer::No } else { OperatorAnswer::Yes }
    }

    /// The axis direction in which a motion of 0.1 mm frees the stylus most; `No` without contact, or if a finger
    /// deflects the stylus.
    fn retract_direction(&self) -> OperatorAnswer {
        let world = self.lock_world();
        if world.is_stylus_deflected || !world.is_in_contact() {
            return OperatorAnswer::No;
        }
        let freed_distance = |direction: &AxisDirection| {
            let (axis, mut trial) = (direction.axis, world.clone());
            let by = if direction.is_positive { VISUAL_DISTANCE_RESOLUTION } else { -VISUAL_DISTANCE_RESOLUTION };
            trial.travel(&Position::new().with(axis, trial.displayed_position().get_or_zero(axis) + by), Speed::Rapid);
            trial.trigger_distance()
        };
        let directions = Axis::LINEAR
            .into_iter()
            .flat_map(|axis| [true, false].map(|is_positive| AxisDirection { axis, is_positive }));
        let best = directions.max_by(|a, b| freed_distance(a).total_cmp(&freed_distance(b)));
        best.map_or(OperatorAnswer::No, OperatorAnswer::Retract)
    }

    /// True motion since the operator allowed the jog, compared with the announced one.
    fn observed_motion(&self, jog: &Jog) -> ObservedMotion {
        let true_position = self.lock_world().true_axis_positions();
        let travelled = true_position
            .iter()
            .map(|(axis, at)| (axis, axis.to_mm_or_deg(at - self.true_position_before_jog.get_or_zero(axis))));
        let farthest = travelled.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        match farthest.filter(|(_, by)| by.abs() > MIN_VISIBLE_MOTION) {
            None => ObservedMotion::NoMotion,
            Some((axis, _)) if axis != jog.axis => ObservedMotion::OtherAxis(axis),
            Some((_, by)) if (by - jog.by).abs() <= VISUAL_DISTANCE_RESOLUTION => ObservedMotion::AsAnnounced,
            Some((_, by)) if (by + jog.by).abs() <= VISUAL_DISTANCE_RESOLUTION => ObservedMotion::Opposite,
            Some((_, by)) => {
                ObservedMotion::Distance((by / VISUAL_DISTANCE_RESOLUTION).round() * VISUAL_DISTANCE_RESOLUTION)
            }
        }
    }

    fn lock_world(&self) -> MutexGuard<'_, SimulatedWorld> {
        // The world is plain data: a panic elsewhere leaves it consistent.
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
