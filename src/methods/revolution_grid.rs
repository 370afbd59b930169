//! Whole revolutions of a rotary axis within its limits.

use std::ops::RangeInclusive;

use machine::Axis;
use machine::record::plan::Plan;

use crate::MethodRefusal;

/// Revolutions divided into equal angles, with further positions before and after them.
#[derive(Debug, Clone, Copy)]
pub struct RevolutionGrid {
    /// Number of angle positions in one revolution.
    pub positions_per_revolution: usize,
    pub revolutions: usize,
    /// Number of positions before the first revolution, and after the last.
    pub lead_positions_per_end: usize,
}

impl RevolutionGrid {
    /// The whole travel with both leads, as an inclusive range of multiples of 360°/`positions_per_revolution`. The
    /// revolutions start at zero or end at zero if the limits of the axis allow it; otherwise the travel starts at
    /// the lower limit.
    ///
    /// # Errors
    /// The limits of the axis do not allow so many revolutions.
    pub fn position_index_range_within_limits(
        self,
        plan: &Plan,
        axis: Axis,
    ) -> Result<RangeInclusive<i64>, MethodRefusal> {
        let spec = plan.machine.axes.get(&axis).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let step_deg = 360.0 / self.positions_per_revolution as f64;
        let [low, high] = spec.first_and_last_multiplier_within_limits(step_deg);
        let (lead, positions) = (self.lead_positions_per_end as i64, self.positions_per_revolution as i64);
        let whole = positions * self.revolutions as i64;
        let starts = [-lead, -whole - lead, low];
        let fits = |first: &i64| *first >= low && first + whole + 2 * lead <= high;
        if let Some(first) = starts.into_iter().find(fits) {
            return Ok(first..=first + whole + 2 * lead);
        }
        let lead_text = match lead {
            0 => String::new(),
            lead => format!(" and {:.0}° before and after", lead as f64 * step_deg),
        };
        let reason = format!(
            "{} revolution(s) of {axis}{lead_text} exceed the limits of the axis, {}° to {}°",
            self.revolutions, spec.min, spec.max
        );
        Err(MethodRefusal::new(
            reason,
            match (high - low - 2 * lead).max(0) / positions {
                0 => format!("widen the limits in [axes.{axis}] if the axis can turn further"),
                most => format!("choose revolutions = {most}"),
            },
        ))
    }
}
