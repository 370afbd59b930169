//! Scales of vectors at positions in space, which all groups of a figure share.

use super::ticked_axis::{round_up_to_1_2_or_5, value_bounds};
use super::views::View;
use machine::record::estimate::{ArrowFigure, ArrowGroup, FigureArrow, Unit};

/// Distance from the middle of a view to the farthest position, in picture units.
const FARTHEST_POSITION_OFFSET: f64 = 140.0;
/// Length of the longest arrow without a flag, in picture units.
const LONGEST_UNFLAGGED_ARROW_LENGTH: f64 = 80.0;
/// Maximum length of an arrow, in picture units: flagged ones may be longer than the others by orders of
/// magnitude.
const MAX_ARROW_LENGTH: f64 = 100.0;

/// Scales that all groups of a figure share.
pub(in crate::report) struct ArrowScales {
    /// Centre of all positions, mm.
    centre_mm: [f64; 3],
    /// Picture units per mm between positions.
    pub(super) picture_units_per_mm: f64,
    /// Picture units per unit of the vectors.
    pub(super) picture_units_per_vector_unit: f64,
    /// Unit of the vectors.
    pub(super) unit: Unit,
    /// Length of the scale arrow, in the unit of the vectors.
    pub(super) scale_arrow_length: f64,
    /// Length of the scale of the positions, mm; `None` if all positions are equal.
    pub(super) scale_bar_mm: Option<f64>,
}

impl ArrowScales {
    /// The scales of a figure; `None` without a finite arrow.
    pub(in crate::report) fn new(figure: &ArrowFigure) -> Option<Self> {
        let all = || figure.groups.iter().flat_map(finite_arrows);
        let side = |k: usize| value_bounds(all().map(|arrow| arrow.at_mm[k]));
        let sides = [side(0)?, side(1)?, side(2)?];
        let middle = sides.map(|(low, high)| 0.5 * (low + high));
        let reach = sides.iter().map(|(low, high)| 0.5 * (high - low)).fold(0.0, f64::max);
        let longest = |flagged: bool| {
            let chosen = all().filter(|arrow| flagged || !arrow.flagged);
            chosen.map(|arrow| vector_length(arrow.vector)).fold(0.0, f64::max)
        };
        let length = [longest(false), longest(true)].into_iter().find(|length| *length > 0.0);
        let length = length.unwrap_or(1.0);
        Some(Self {
            centre_mm: middle,
            picture_units_per_mm: if reach > 0.0 { FARTHEST_POSITION_OFFSET / reach } else { 1.0 },
            picture_units_per_vector_unit: LONGEST_UNFLAGGED_ARROW_LENGTH / length,
            unit: figure.unit,
            scale_arrow_length: round_up_to_1_2_or_5(0.4 * length),
            scale_bar_mm: (reach > 0.0).then(|| round_up_to_1_2_or_5(0.25 * reach)),
        })
    }

    /// Position of the start of a vector in the picture.
    pub(super) fn start(&self, view: View, arrow: &FigureArrow) -> (i32, i32) {
        self.tip(view, arrow, [0.0; 3])
    }

    /// Position of the tip of `vector` at the start of `arrow` in the picture.
    pub(super) fn tip(&self, view: View, arrow: &FigureArrow, vector: [f64; 3]) -> (i32, i32) {
        let drawn = self.drawn_vector(vector);
        let offset = |k: usize| self.picture_units_per_mm * (arrow.at_mm[k] - self.centre_mm[k]) + drawn[k];
        view.picture_point(view.project([offset(0), offset(1), offset(2)]))
    }

    /// The vector in picture units, shortened where it would be too long.
    pub(super) fn drawn_vector(&self, vector: [f64; 3]) -> [f64; 3] {
        let scale = self.picture_units_per_vector_unit
            * (MAX_ARROW_LENGTH / (self.picture_units_per_vector_unit * vector_length(vector))).min(1.0);
        vector.map(|part| scale * part)
    }

    /// Scale of vectors in `unit` divided by the scale of the positions; `None` for a unit that is not a length.
    pub(in crate::report) fn magnification(&self, unit: Unit) -> Option<f64> {
        let per_mm = match unit {
            Unit::Um => 1e3,
            Unit::Mm => 1.0,
            Unit::Urad | Unit::UmPerM | Unit::Ms => return None,
        };
        Some(self.picture_units_per_vector_unit * per_mm / self.picture_units_per_mm)
    }

    /// Whether a flagged arrow is drawn shorter than to scale.
    pub(in crate::report) fn has_shortened_arrows(&self, figure: &ArrowFigure) -> bool {
        figure
            .groups
            .iter()
            .flat_map(finite_arrows)
            .any(|a| self.picture_units_per_vector_unit * vector_length(a.vector) > MAX_ARROW_LENGTH)
    }
}

/// Root mean square of the lengths of the vectors of a group; `None` without a finite vector.
pub(in crate::report) fn group_rms(group: &ArrowGroup) -> Option<f64> {
    let squares: Vec<f64> = finite_arrows(group).map(|arrow| vector_length(arrow.vector).powi(2)).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Arrows of the group whose position and vector are finite; all others are left out of the figure.
pub(super) fn finite_arrows(group: &ArrowGroup) -> impl Iterator<Item = &FigureArrow> {
    group.arrows.iter().filter(|a| a.at_mm.iter().chain(&a.vector).all(|part| part.is_finite()))
}

fn vector_length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}
