//! Approach to a step while touches have not confirmed the position of the machine yet: straight up to the upper
//! end of Z, there one axis group after the other, then down. No move is a rapid.
//!
//! Only contact with the stylus is detected. Beside an obstacle, the bodies above the stylus could land on the
//! obstacle. Therefore, on the first descent, the stylus makes one round in every interval of its own length, as
//! wide as the widest body above it, so that the stylus meets any obstacle first.

use std::f64::consts::TAU;

use super::clearance::MARGIN;
use super::path::{Path, height};
use super::surroundings::Surroundings;
use super::tool::overhang;
use super::{Clearance, Confirmed, turning};
use machine::record::motion::Motion;
use machine::record::plan::{Plan, Step};
use machine::record::sensor::Mount;
use machine::{Axis, Position};

/// Minimum length of a probing move, mm. A shorter move is a feed move at the search feed: LinuxCNC refuses probing
/// moves below 0.254 mm ("start point too close to probe point"), and so short a move does not break a stylus.
pub(super) const SHORT_MM: f64 = 0.3;

/// Number of corners of a round, and distance between two rounds as a share of the stylus length.
const CORNERS: u32 = 8;
const SHARE: f64 = 0.9;

/// Parameters of an approach before the position is confirmed.
pub(super) struct UnconfirmedApproach<'a> {
    plan: &'a Plan,
    about: &'a Surroundings,
    /// The upper end of Z, mm.
    top_z: f64,
    /// Height of Z above which nothing declared is near, below the current step.
    low_z: f64,
    /// Feed near the part, mm/min.
    near_feed: f64,
    /// Whether contact stops the moves: true with a probe, false with a sensor.
    guarded: bool,
    /// Whether no touch was made yet.
    first: bool,
}

impl<'a> UnconfirmedApproach<'a> {
    pub fn new(plan: &'a Plan, clearance: &'a Clearance, low_z: f64, confirmed: Confirmed) -> Self {
        let (about, top_z) = (&clearance.about, clearance.top_z);
        let (near_feed, guarded) = (near_feed(plan, confirmed), plan.sensors.is_empty());
        Self { plan, about, top_z, low_z, near_feed, guarded, first: !confirmed.is_begun() }
    }

    /// Approach to a nest of sensors on the table: always by way of the upper end of Z.
    pub fn to_nest(plan: &'a Plan, clearance: &'a Clearance, low_z: f64) -> Self {
        let near_feed = nest_feed(plan);
        Self { near_feed, ..Self::new(plan, clearance, low_z, Confirmed::default()) }
    }

    /// Moves to the point above `from`, at `low_z`.
    pub fn over(&self, path: &mut Path, from: &Position) {
        self.up(path, from);
        self.across_and_down(path, from);
    }

    /// Moves up to `low_z`, and to the upper end of Z if any axis but Z must move or if no touch was made yet.
    pub fn up(&self, path: &mut Path, from: &Position) {
        let mut elsewhere = from.iter().filter(|(axis, _)| *axis != Axis::Z);
        let goes_aside = elsewhere.any(|(axis, value)| !path.stands_at(axis, value));
        if path.stands.get(Axis::Z).is_some_and(|z| z < self.low_z) {
            self.straight(path, &height(self.low_z), self.near_feed);
        }
        if goes_aside || self.first {
            self.straight(path, &height(self.top_z), self.fast());
        }
    }

    /// Makes the moves that remain after [`Self::up`].
    pub fn across_and_down(&self, path: &mut Path, from: &Position) {
        for (axis, value) in from.iter().filter(|(axis, _)| !axis.is_linear()) {
            self.turn(path, axis, value);
        }
        let over = from.only(|axis| matches!(axis, Axis::X | Axis::Y));
        self.straight(path, &over, self.fast());
        if self.first && self.guarded {
            self.probe_surroundings(path, from);
        }
        self.straight(path, &height(self.low_z), self.fast());
    }

    /// Makes rounds during the descent, down to the last necessary height; only the stylus moves below that height.
    fn probe_surroundings(&self, path: &mut Path, from: &Position) {
        let Some((_, length)) = overhang(self.plan) else { return };
        let levels = (self.top_z - from.at(Axis::Z)) / (SHARE * length);
        for level in 0..levels.max(0.0).ceil() as u32 {
            let z = (self.top_z - f64::from(level) * SHARE * length).max(self.low_z);
            let over = from.clone().with(Axis::Z, z);
            let round = self.round(&over);
            let free = |place: &Position| self.about.z_between(&over, place, MARGIN) <= z;
            // Where a declared body is this high, its position is known, so no round is needed.
            if round.iter().all(free) {
                self.straight(path, &height(z), self.fast());
                let middle = over.only(|axis| matches!(axis, Axis::X | Axis::Y));
                for place in round.iter().chain(round.first()).chain([&middle]) {
                    let to = place.only(|axis| matches!(axis, Axis::X | Axis::Y));
                    self.straight(path, &to, self.fast());
                }
            }
        }
    }

    /// Corners of a round about `over`, limited to the travel of X and Y.
    fn round(&self, over: &Position) -> Vec<Position> {
        let wide = round_mm(self.plan);
        let corner = |k: u32| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(CORNERS)).sin_cos();
            let aside = [(Axis::X, wide * cos), (Axis::Y, wide * sin)];
            aside.into_iter().fold(over.clone(), |place, (axis, by)| {
                let to = over.at(axis) + by;
                let spec = self.plan.machine.axes.get(&axis);
                place.with(axis, spec.map_or(to, |spec| to.clamp(spec.min, spec.max)))
            })
        };
        (0..CORNERS).map(corner).collect()
    }

    /// Feed where nothing declared is near. With a sensor, a hold that follows the first reported distance must
    /// stop the machine within the sensor's range.
    fn fast(&self) -> f64 {
        let feed = self.plan.probe.guarded_feed_mm_min;
        let ranges = self.plan.sensors.iter().map(|sensor| sensor.range_mm[1] - sensor.range_mm[0]);
        ranges.map(|range| stopping_feed(self.plan, range)).fold(feed, f64::min)
    }

    fn straight(&self, path: &mut Path, to: &Position, feed_mm_min: f64) {
        let way = |(axis, to): (Axis, f64)| path.stands.get(axis).map(|at| (to - at).powi(2));
        let length = to.iter().map(way).sum::<Option<f64>>().map(f64::sqrt);
        let is_short = length.is_some_and(|length| length < SHORT_MM);
        path.feed(to, |to| match (self.guarded, is_short) {
            (true, true) => Motion::Feed { to, feed_mm_min: search_feed(self.plan) },
            (true, false) => Motion::Guarded { to, feed_mm_min },
            (false, _) => Motion::Feed { to, feed_mm_min },
        });
    }

    fn turn(&self, path: &mut Path, axis: Axis, value: f64) {
        if axis == Axis::S {
            path.orient(Some(value));
            return;
        }
        let feed_mm_min = turning::feed_at_most(self.plan, &self.about.chain, axis, &path.stands);
        path.feed(&Position::new().with(axis, value), |to| Motion::Feed { to, feed_mm_min });
    }
}

/// Distance of the corners of a round from its middle, mm.
pub(super) fn round_mm(plan: &Plan) -> f64 {
    let (wide, _) = overhang(plan).unwrap_or_default();
    wide / (TAU / f64::from(2 * CORNERS)).cos()
}

/// Feed, mm/min, from which a hold stops within `within_mm`, for every linear axis.
fn stopping_feed(plan: &Plan, within_mm: f64) -> f64 {
    let axes = plan.machine.axes.iter().filter(|(axis, _)| axis.is_linear());
    let slowest = axes.map(|(_, spec)| spec.acceleration_per_s2).fold(f64::INFINITY, f64::min);
    60.0 * turning::stopping_speed(slowest, within_mm)
}

/// Whether all sensors of `step` are on the table: they measure the ball in the spindle, which is between them.
pub(super) fn is_in_nest(plan: &Plan, step: &Step) -> bool {
    let is_on_table = |name: &String| {
        let named = plan.sensors.iter().find(|sensor| sensor.name == *name);
        named.is_some_and(|sensor| sensor.mount == Mount::Table)
    };
    !step.sensors.is_empty() && step.sensors.iter().all(is_on_table)
}

/// Maximum feed of linear axes while the ball is in a nest of sensors on the table or moves there, mm/min: a hold
/// at the near end of a range stops the ball before it meets the body of the sensor. Where `stand_off_mm` leaves
/// less than a quarter of the range, the ball stops within that quarter.
pub(super) fn nest_feed(plan: &Plan) -> f64 {
    let on_table = plan.sensors.iter().filter(|sensor| sensor.mount == Mount::Table);
    let within = on_table.map(|sensor| {
        let [least, greatest] = sensor.range_mm;
        let range = greatest - least;
        (sensor.stand_off_mm + least).max(range / 4.0).min(range)
    });
    within.map(|mm| stopping_feed(plan, mm)).fold(search_feed(plan), f64::min)
}

/// Feed near the part until a touch has shown that the probe works.
pub(super) fn search_feed(plan: &Plan) -> f64 {
    plan.probe.guarded_feed_mm_min.min(plan.probe.search_feed_mm_min)
}

/// Feed of moves near the part.
pub(super) fn near_feed(plan: &Plan, confirmed: Confirmed) -> f64 {
    match confirmed.is_begun() {
        true => plan.probe.guarded_feed_mm_min,
        false => search_feed(plan),
    }
}
