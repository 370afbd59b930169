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
    fn flight(&self) -> f64 {
        self.peak * self.peak / (2.0 * self.acceleration)
    }

    pub fn duration_s(&self) -> f64 {
        1.0 / self.peak + self.peak / self.acceleration
    }

    pub fn time_s(&self, fraction: f64) -> f64 {
        if fraction < self.flight() {
            (2.0 * fraction / self.acceleration).sqrt()
        } else if fraction <= 1.0 - self.flight() {
            self.peak / self.acceleration + (fraction - self.flight()) / self.peak
        } else {
            self.duration_s() - (2.0 * (1.0 - fraction).max(0.0) / self.acceleration).sqrt()
        }
    }

    pub fn speed(&self, fraction: f64) -> f64 {
        let left = fraction.min(1.0 - fraction).clamp(0.0, self.flight());
        (2.0 * self.acceleration * left).sqrt()
    }

    /// Path fraction `seconds` after `fraction`, if the move is not stopped.
    pub fn later(&self, fraction: f64, seconds: f64) -> f64 {
        if seconds <= 0.0 {
            return fraction;
        }
        let (time, whole) = (self.time_s(fraction) + seconds, self.duration_s());
        let speeding = self.peak / self.acceleration;
        if time < speeding {
            self.acceleration * time * time / 2.0
        } else if time <= whole - speeding {
            self.flight() + (time - speeding) * self.peak
        } else {
            1.0 - self.acceleration * (whole - time).max(0.0).powi(2) / 2.0
        }
    }

    /// Path fraction and time at rest when braking begins at `fraction`.
    pub fn stop_from(&self, fraction: f64) -> (f64, f64) {
        let speed = self.speed(fraction);
        let rest = (fraction + speed * speed / (2.0 * self.acceleration)).min(1.0);
        (rest, self.time_s(fraction) + speed / self.acceleration)
    }
}

/// Shortest step of the search.
pub(super) const FINEST_MM: f64 = 0.01;
/// Interval width at which a crossing counts as located.
const CROSSING_MM: f64 = 1e-10;

/// First path fraction in `from..=1` at which the distance `f` (mm) is no longer positive. `steepest` bounds
/// the change of `f` with the path fraction: a step as long as the distance allows cannot pass over a crossing.
pub(super) fn first_crossing(f: impl Fn(f64) -> f64, steepest: f64, from: f64) -> Option<f64> {
    let (mut here, mut value) = (from, f(from));
    while value > 0.0 {
        if here >= 1.0 || steepest <= 0.0 {
            return None;
        }
        let next = (here + value.max(FINEST_MM) / steepest).min(1.0);
        let value_next = f(next);
        if value_next <= 0.0 {
            return Some(locate(f, (here, value), (next, value_next), CROSSING_MM / steepest));
        }
        (here, value) = (next, value_next);
    }
    Some(here)
}

/// Root between a positive `a` and a non-positive `b`: false position, with half weight for an end point that
/// stays twice (Illinois), and bisection in every third iteration to bound the work.
fn locate(f: impl Fn(f64) -> f64, mut a: (f64, f64), mut b: (f64, f64), width: f64) -> f64 {
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
