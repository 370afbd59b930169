//! Trapezoidal velocity profile of a straight move, and the search for the first event on it.

/// Speed of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    Rapid,
    /// Feed along the path of the linear axes; deg/min where only rotary axes move.
    Feed {
        mm_min: f64,
    },
}

/// Motion from rest to rest over the path fraction 0 to 1: accelerate, cruise, brake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ramp {
    /// Highest speed reached, 1/s.
    peak: f64,
    /// Acceleration of the path fraction, 1/s².
    acceleration: f64,
}

impl Ramp {
    /// Limits of the speed and acceleration of the path fraction; both positive, may be infinite.
    pub fn new(speed: f64, acceleration: f64) -> Self {
        Self { peak: speed.min(acceleration.sqrt()), acceleration }
    }

    /// Path fraction of the acceleration phase, equal to that of the braking phase.
    fn ramp_fraction(&self) -> f64 {
        self.peak * self.peak / (2.0 * self.acceleration)
    }

    pub fn duration_s(&self) -> f64 {
        1.0 / self.peak + self.peak / self.acceleration
    }

    pub fn time_s(&self, fraction: f64) -> f64 {
        if fraction < self.ramp_fraction() {
            (2.0 * fraction / self.acceleration).sqrt()
        } else if fraction <= 1.0 - self.ramp_fraction() {
            self.peak / self.acceleration + (fraction - self.ramp_fraction()) / self.peak
        } else {
            self.duration_s() - (2.0 * (1.0 - fraction).max(0.0) / self.acceleration).sqrt()
        }
    }

    pub fn speed(&self, fraction: f64) -> f64 {
        let distance_to_end = fraction.min(1.0 - fraction).clamp(0.0, self.ramp_fraction());
        (2.0 * self.acceleration * distance_to_end).sqrt()
    }

    /// Path fraction `seconds` after `fraction`, if the move is not stopped.
    pub fn fraction_after(&self, fraction: f64, seconds: f64) -> f64 {
        if seconds <= 0.0 {
            return fraction;
        }
        let (time, whole) = (self.time_s(fraction) + seconds, self.duration_s());
        let acceleration_s = self.peak / self.acceleration;
        if time < acceleration_s {
            self.acceleration * time * time / 2.0
        } else if time <= whole - acceleration_s {
            self.ramp_fraction() + (time - acceleration_s) * self.peak
        } else {
            1.0 - self.acceleration * (whole - time).max(0.0).powi(2) / 2.0
        }
    }

    /// Path fraction and time at rest when braking begins at `fraction`.
    pub fn brake_from(&self, fraction: f64) -> (f64, f64) {
        let speed = self.speed(fraction);
        let rest = (fraction + speed * speed / (2.0 * self.acceleration)).min(1.0);
        (rest, self.time_s(fraction) + speed / self.acceleration)
    }
}

/// Shortest step of the search.
pub(super) const MIN_SEARCH_STEP_MM: f64 = 0.01;
/// Interval width at which a crossing counts as located.
const CROSSING_TOLERANCE_MM: f64 = 1e-10;

/// First path fraction in `from..=1` at which the distance `f` (mm) is no longer positive. `max_slope_mm` bounds
/// the change of `f` with the path fraction: a step as long as the distance allows cannot pass over a crossing.
pub(super) fn first_crossing(f: impl Fn(f64) -> f64, max_slope_mm: f64, from: f64) -> Option<f64> {
    let (mut here, mut value) = (from, f(from));
    while value > 0.0 {
        if here >= 1.0 || max_slope_mm <= 0.0 {
            return None;
        }
        let next = (here + value.max(MIN_SEARCH_STEP_MM) / max_slope_mm).min(1.0);
        let value_next = f(next);
        if value_next <= 0.0 {
            return Some(find_root(f, (here, value), (next, value_next), CROSSING_TOLERANCE_MM / max_slope_mm));
        }
        (here, value) = (next, value_next);
    }
    Some(here)
}

/// Root between a positive `a` and a non-positive `b`: false position, with half weight for an end point that
/// stays twice (Illinois), and bisection in every third iteration to bound the work.
fn find_root(f: impl Fn(f64) -> f64, mut a: (f64, f64), mut b: (f64, f64), width: f64) -> f64 {
    let mut kept_b = None;
    for round in 0..200 {
        if b.0 - a.0 <= width || b.1 == 0.0 {
            break;
        }
        let middle = match round % 3 {
            2 => (a.0 + b.0) / 2.0,
            _ => a.0 + (b.0 - a.0) * a.1 / (a.1 - b.1),
        };
        let value = f(middle);
        let keep_b = value > 0.0;
        let weight = if kept_b == Some(keep_b) { 0.5 } else { 1.0 };
        if keep_b {
            (a, b.1) = ((middle, value), b.1 * weight);
        } else {
            (b, a.1) = ((middle, value), a.1 * weight);
        }
        kept_b = Some(keep_b);
    }
    b.0
}
