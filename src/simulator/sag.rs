//! Sag: the table gives way as the part turns its weight about a tilt axis.

use glam::{DAffine3, DMat3, DVec3};

use super::truth::{SagLaw, SagTerm};
use machine::{Axis, Position};

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sag {
    terms: Vec<Term>,
}

#[derive(Debug, Clone, PartialEq)]
struct Term {
    axis: Axis,
    law: SagLaw,
    /// Displacement and rotation vector at 90°, machine frame, mm and rad.
    shift: DVec3,
    turn: DVec3,
}

impl Sag {
    pub fn new(terms: &[SagTerm]) -> Self {
        let read = |term: &SagTerm| Term {
            axis: term.axis,
            law: term.law,
            shift: DVec3::from_array(term.um) * 1e-3,
            turn: DVec3::from_array(term.urad) * 1e-6,
        };
        Self { terms: terms.iter().map(read).collect() }
    }

    /// The pose of the table, given way: shifted, and turned about where its origin stands.
    pub fn bend(&self, table: DAffine3, axes: &Position) -> DAffine3 {
        self.terms.iter().fold(table, |table, term| {
            let angle = axes.at(term.axis);
            let share = match term.law {
                SagLaw::Sin => angle.sin(),
                SagLaw::OneMinusCos => 1.0 - angle.cos(),
            };
            let turn = term.turn * share;
            let turned = match turn.length() {
                0.0 => table.matrix3,
                by => DMat3::from_axis_angle(turn / by, by) * table.matrix3,
            };
            DAffine3 { matrix3: turned, translation: table.translation + term.shift * share }
        })
    }
}
