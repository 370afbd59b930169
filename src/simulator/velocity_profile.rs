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
pub(super) struct VelocityProfile {
    /// Highest speed reached, 1/s.
    peak_fraction_speed: f64,
    /// Acceleration of the path fraction, 1/s².
    fraction_acceleration: f64,
}

impl VelocityProfile {
    /// The fastest profile within the limits of speed and acceleration of the path fraction; both are positive, and
    /// may be infinite.
    pub fn new(speed: f64, acceleration: f64) -> Self {
        Self { peak_fraction_speed: speed.min(acceleration.sqrt()), fraction_acceleration: acceleration }
    }

    /// Path fraction of the acceleration phase, equal to that of the braking phase.
    fn acceleration_phase_fraction(&self) -> f64 {
        self.peak_fraction_speed * self.peak_fraction_speed / (2.0 * self.fraction_acceleration)
    }

    pub fn duration_s(&self) -> f64 {
        1.0 / self.peak_fraction_speed + self.peak_fraction_speed / self.fraction_acceleration
    }

    /// Time from the start of the move to `fraction`, if the move is not stopped.
    pub fn time_at_fraction_s(&self, fraction: f64) -> f64 {
        if fraction < self.acceleration_phase_fraction() {
            (2.0 * fraction / self.fraction_acceleration).sqrt()
        } else if fraction <= 1.0 - self.acceleration_phase_fraction() {
            self.peak_fraction_speed / self.fraction_acceleration
                + (fraction - self.acceleration_phase_fraction()) / self.peak_fraction_speed
        } else {
            self.duration_s() - (2.0 * (1.0 - fraction).max(0.0) / self.fraction_acceleration).sqrt()
        }
    }

    /// Speed of the path fraction, 1/s.
    pub fn speed_at_fraction(&self, fraction: f64) -> f64 {
        let distance_to_end = fraction.min(1.0 - fraction).clamp(0.0, self.acceleration_phase_fraction());
        (2.0 * self.fraction_acceleration * distance_to_end).sqrt()
    }

    /// Path fraction `seconds` after `fraction`, if the move is not stopped.
    pub fn fraction_after(&self, fraction: f64, seconds: f64) -> f64 {
        if seconds <= 0.0 {
            return fraction;
        }
        let (time, whole) = (self.time_at_fraction_s(fraction) + seconds, self.duration_s());
        let acceleration_s = self.peak_fraction_speed / self.fraction_acceleration;
        if time < acceleration_s {
            self.fraction_acceleration * time * time / 2.0
        } else if time <= whole - acceleration_s {
            self.acceleration_phase_fraction() + (time - acceleration_s) * self.peak_fraction_speed
        } else {
            1.0 - self.fraction_acceleration * (whole - time).max(0.0).powi(2) / 2.0
        }
    }

    /// Path fraction at rest, and time from the start of the move to rest, when braking begins at `fraction`.
    pub fn rest_fraction_and_time_s(&self, fraction: f64) -> (f64, f64) {
        let speed = self.speed_at_fraction(fraction);
        let rest = (fraction + speed * speed / (2.0 * self.fraction_acceleration)).min(1.0);
        (rest, self.time_at_fraction_s(fraction) + speed / self.fraction_acceleration)
    }
}

/// Minimum step of the search, mm.
pub(super) const SEARCH_STEP_FLOOR_MM: f64 = 0.01;
/// Maximum change of the distance, mm, over the interval in which a crossing is located.
const CROSSING_DISTANCE_TOLERANCE_MM: f64 = 1e-10;

/// First path fraction in `from_fraction..=1` at which `distance_mm` is no longer positive. `max_slope_mm` bounds
/// the change of the distance with the path fraction: a step as long as the distance allows cannot pass over a
/// crossing.
pub(super) fn first_zero_crossing_fraction(
    distance_mm: impl Fn(f64) -> f64,
    max_slope_mm: f64,
    from_fraction: f64,
) -> Option<f64> {
    let (mut here, mut value) = (from_fraction, distance_mm(from_fraction));
    while value > 0.0 {
        if here >= 1.0 || max_slope_mm <= 0.0 {
            return None;
        }
        let next = (here + value.max(SEARCH_STEP_FLOOR_MM) / max_slope_mm).min(1.0);
        let value_next = distance_mm(next);
        if value_next <= 0.0 {
            let width = CROSSING_DISTANCE_TOLERANCE_MM / max_slope_mm;
            return Some(find_root(distance_mm, (here, value), (next, value_next), width));
        }
        (here, value) = (next, value_next);
    }
    Some(here)
}

/// Root of `f`, to within `width`, between the points `a` (positive value) and `b` (not positive), each an argument
/// and its value. False position, with half weight for an end point that stays twice (Illinois), and bisection in
/// every third iteration to bound the work.
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
