//! Whole revolutions of a rotary axis within its limits.

use std::ops::RangeInclusive;

use machine::Axis;
use machine::record::plan::Plan;

use crate::Refused;

/// Revolutions in equal steps, with lead-in and lead-out steps.
#[derive(Debug, Clone, Copy)]
pub struct Turns {
    /// Steps in one revolution.
    pub positions: usize,
    pub revolutions: usize,
    /// Steps before the first revolution and after the last.
    pub lead: usize,
}

impl Turns {
    /// The whole travel in multiples of 360°/`positions`. The revolutions start at zero or end at zero if the
    /// limits of the axis allow it; otherwise the travel starts at the lower limit.
    ///
    /// # Errors
    /// The limits of the axis do not allow so many revolutions.
    pub fn within(self, plan: &Plan, axis: Axis) -> Result<RangeInclusive<i64>, Refused> {
        let spec = plan.machine.axes.get(&axis).ok_or_else(Refused::no_table)?;
        let step_deg = 360.0 / self.positions as f64;
        let [low, high] = spec.multiples_within(step_deg);
        let (lead, positions) = (self.lead as i64, self.positions as i64);
        let whole = positions * self.revolutions as i64;
        let starts = [-lead, -whole - lead, low];
        let fits = |first: &i64| *first >= low && first + whole + 2 * lead <= high;
        if let Some(first) = starts.into_iter().find(fits) {
            return Ok(first..=first + whole + 2 * lead);
        }
        let lead_text = match lead {
            0 => String::new(),
            lead => format!(" and {:.0}° before and after them", lead as f64 * step_deg),
        };
        let why = format!(
            "{} revolution(s) of {axis}{lead_text} do not fit its limits, {}° to {}°",
            self.revolutions, spec.min, spec.max
        );
        Err(Refused::new(
            why,
            match (high - low - 2 * lead).max(0) / positions {
                0 => format!("widen the limits in [axes.{axis}], if the axis turns farther"),
                most => format!("choose revolutions = {most}"),
            },
        ))
    }
}
