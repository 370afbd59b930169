//! Approach to a step while touches have not verified the position of the machine yet: straight up to the upper
//! end of Z, there one axis group after the other, then down. No move is a rapid.
//!
//! Only contact with the stylus is detected. If the stylus descends beside an obstacle, the bodies above it could
//! land on the obstacle. Therefore, on the first descent, the stylus moves along an octagon in every interval of
//! its own length, as wide as the widest body above it, so that the stylus meets any obstacle first.

use std::f64::consts::TAU;

use super::motion_sequence::{MotionSequence, z_position};
use super::safe_heights::PLANNED_UNGUARDED_CLEARANCE_MM;
use super::surroundings::Surroundings;
use super::tool_parts::undetected_parts_radius_and_height_mm;
use super::{SafeHeights, TouchedDirections, turn_feeds};
use machine::record::motion::Motion;
use machine::record::plan::{Plan, Step};
use machine::record::sensor::SensorMount;
use machine::{Axis, Position};

/// Minimum length of a probing move, mm. A shorter move is a feed move at the search feed: LinuxCNC refuses probing
/// moves below 0.254 mm ("start point too close to probe point"), and so short a move does not break a stylus.
pub(super) const SHORTEST_PROBED_LENGTH_MM: f64 = 0.3;

/// Number of corners of an octagon.
const OCTAGON_CORNER_COUNT: u32 = 8;
/// Distance between two octagons as a share of the stylus length.
const OCTAGON_SPACING_TO_STYLUS_LENGTH: f64 = 0.9;

/// Parameters of an approach before touches have verified the position.
pub(super) struct UnverifiedPositionApproach<'a> {
    plan: &'a Plan,
    surroundings: &'a Surroundings,
    /// The upper end of Z, mm.
    top_z: f64,
    /// Lowest Z above the start of the current step at which no declared body is near, mm.
    lowest_clear_z: f64,
    /// Feed near the part, mm/min.
    near_part_feed_mm_min: f64,
    /// Whether contact stops the moves: true with a probe, false with a sensor.
    is_guarded: bool,
    /// Whether no touch was made yet.
    is_before_first_touch: bool,
}

impl<'a> UnverifiedPositionApproach<'a> {
    pub fn new(plan: &'a Plan, safe_heights: &'a SafeHeights, low_z: f64, touched: TouchedDirections) -> Self {
        let (surroundings, top_z) = (&safe_heights.surroundings, safe_heights.top_z);
        let (near_part_feed_mm_min, is_guarded) = (near_part_feed_mm_min(plan, touched), plan.sensors.is_empty());
        Self {
            plan,
            surroundings,
            top_z,
            lowest_clear_z: low_z,
            near_part_feed_mm_min,
            is_guarded,
            is_before_first_touch: !touched.has_any_direction(),
        }
    }

    /// Approach to a nest of sensors on the table: always by way of the upper end of Z.
    pub fn to_nest(plan: &'a Plan, safe_heights: &'a SafeHeights, low_z: f64) -> Self {
        let near_part_feed_mm_min = max_nest_feed_mm_min(plan);
        Self { near_part_feed_mm_min, ..Self::new(plan, safe_heights, low_z, TouchedDirections::default()) }
    }

    /// Moves to the point above `from`, at `lowest_clear_z`.
    pub fn move_above(&self, path: &mut MotionSequence, from: &Position) {
        self.move_up(path, from);
        self.move_across_and_down(path, from);
    }

    /// Moves up to `lowest_clear_z`, and to the upper end of Z if any axis but Z must move or if no touch was made yet.
    pub fn move_up(&self, path: &mut MotionSequence, from: &Position) {
        let mut elsewhere = from.iter().filter(|(axis, _)| *axis != Axis::Z);
        let goes_aside = elsewhere.any(|(axis, value)| !path.is_at(axis, value));
        if path.end_position.get(Axis::Z).is_some_and(|z| z < self.lowest_clear_z) {
            self.move_straight(path, &z_position(self.lowest_clear_z), self.near_part_feed_mm_min);
        }
        if goes_aside || self.is_before_first_touch {
            self.move_straight(path, &z_position(self.top_z), self.free_space_feed_mm_min());
        }
    }

    /// Makes the moves that remain after [`Self::move_up`].
    pub fn move_across_and_down(&self, path: &mut MotionSequence, from: &Position) {
        for (axis, value) in from.iter().filter(|(axis, _)| !axis.is_linear()) {
            self.turn_axis(path, axis, value);
        }
        let above_step = from.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y));
        self.move_straight(path, &above_step, self.free_space_feed_mm_min());
        if self.is_before_first_touch && self.is_guarded {
            self.probe_octagons_on_descent(path, from);
        }
        self.move_straight(path, &z_position(self.lowest_clear_z), self.free_space_feed_mm_min());
    }

    /// Moves along octagons during the descent. Only the stylus descends below the height of the last octagon.
    fn probe_octagons_on_descent(&self, path: &mut MotionSequence, from: &Position) {
        let Some((_, length)) = undetected_parts_radius_and_height_mm(self.plan) else { return };
        let levels = (self.top_z - from.get_or_zero(Axis::Z)) / (OCTAGON_SPACING_TO_STYLUS_LENGTH * length);
        for level in 0..levels.max(0.0).ceil() as u32 {
            let z =
                (self.top_z - f64::from(level) * OCTAGON_SPACING_TO_STYLUS_LENGTH * length).max(self.lowest_clear_z);
            let centre = from.clone().with(Axis::Z, z);
            let octagon = self.octagon_corners(&centre);
            let free = |place: &Position| {
                self.surroundings.clear_z_command_on_path(&centre, place, PLANNED_UNGUARDED_CLEARANCE_MM) <= z
            };
            // Where a declared body is this high, its position is known, so no octagon is needed.
            if octagon.iter().all(free) {
                self.move_straight(path, &z_position(z), self.free_space_feed_mm_min());
                let middle = centre.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y));
                for place in octagon.iter().chain(octagon.first()).chain([&middle]) {
                    let to = place.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y));
                    self.move_straight(path, &to, self.free_space_feed_mm_min());
                }
            }
        }
    }

    /// Corners of an octagon about `centre`, limited to the travel of X and Y.
    fn octagon_corners(&self, centre: &Position) -> Vec<Position> {
        let wide = octagon_radius_mm(self.plan);
        let corner = |k: u32| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(OCTAGON_CORNER_COUNT)).sin_cos();
            let aside = [(Axis::X, wide * cos), (Axis::Y, wide * sin)];
            aside.into_iter().fold(centre.clone(), |place, (axis, by)| {
                let to = centre.get_or_zero(axis) + by;
                let spec = self.plan.machine.axes.get(&axis);
                place.with(axis, spec.map_or(to, |spec| to.clamp(spec.min, spec.max)))
            })
        };
        (0..OCTAGON_CORNER_COUNT).map(corner).collect()
    }

    /// Feed where no declared body is near, mm/min. With a sensor, a hold after the first reported distance must stop
    /// the machine within the sensor's range.
    fn free_space_feed_mm_min(&self) -> f64 {
        let feed = self.plan.probe.guarded_feed_mm_min;
        let ranges = self.plan.sensors.iter().map(|sensor| sensor.range_mm[1] - sensor.range_mm[0]);
        ranges.map(|range| max_stoppable_feed_mm_min(self.plan, range)).fold(feed, f64::min)
    }

    /// Adds a move that contact stops if the approach is guarded; a move shorter than [`SHORTEST_PROBED_LENGTH_MM`]
    /// is then a feed move at the search feed.
    fn move_straight(&self, path: &mut MotionSequence, to: &Position, feed_mm_min: f64) {
        let way = |(axis, to): (Axis, f64)| path.end_position.get(axis).map(|at| (to - at).powi(2));
        let length = to.iter().map(way).sum::<Option<f64>>().map(f64::sqrt);
        let is_short = length.is_some_and(|length| length < SHORTEST_PROBED_LENGTH_MM);
        path.add_motion(to, |to| match (self.is_guarded, is_short) {
            (true, true) => Motion::Feed { to, feed_mm_min: search_feed_before_first_touch_mm_min(self.plan) },
            (true, false) => Motion::Guarded { to, feed_mm_min },
            (false, _) => Motion::Feed { to, feed_mm_min },
        });
    }

    /// Orients the spindle, or turns another axis at the feed that is allowed until the position is verified.
    fn turn_axis(&self, path: &mut MotionSequence, axis: Axis, value: f64) {
        if axis == Axis::S {
            path.add_spindle_orientation(Some(value));
            return;
        }
        let feed_mm_min =
            turn_feeds::max_turn_feed_deg_min(self.plan, &self.surroundings.chain, axis, &path.end_position);
        path.add_motion(&Position::new().with(axis, value), |to| Motion::Feed { to, feed_mm_min });
    }
}

/// Distance of the corners of an octagon from its centre, mm.
pub(super) fn octagon_radius_mm(plan: &Plan) -> f64 {
    let (wide, _) = undetected_parts_radius_and_height_mm(plan).unwrap_or_default();
    wide / (TAU / f64::from(2 * OCTAGON_CORNER_COUNT)).cos()
}

/// Maximum feed, mm/min, from which a hold stops every linear axis within `within_mm`.
fn max_stoppable_feed_mm_min(plan: &Plan, within_mm: f64) -> f64 {
    60.0 * turn_feeds::max_stoppable_speed_mm_s(plan.machine.min_linear_acceleration_mm_s2(), within_mm)
}

/// Whether all sensors of `step` are on the table: they measure the ball in the spindle, which is between them.
pub(super) fn are_step_sensors_on_table(plan: &Plan, step: &Step) -> bool {
    let is_on_table = |name: &String| {
        let named = plan.sensors.iter().find(|sensor| sensor.name == *name);
        named.is_some_and(|sensor| sensor.mount == SensorMount::Table)
    };
    !step.sensors.is_empty() && step.sensors.iter().all(is_on_table)
}

/// Maximum feed of linear axes while the ball is in a nest of sensors on the table or moves there, mm/min: a hold at
/// the near end of a range stops the ball before it meets the body of the sensor. Where `stand_off_mm` leaves less
/// than a quarter of the range, the ball stops within that quarter. Never above the search feed.
pub(super) fn max_nest_feed_mm_min(plan: &Plan) -> f64 {
    let on_table = plan.sensors.iter().filter(|sensor| sensor.mount == SensorMount::Table);
    let within = on_table.map(|sensor| {
        let [least, greatest] = sensor.range_mm;
        let range = greatest - least;
        (sensor.stand_off_mm + least).max(range / 4.0).min(range)
    });
    within.map(|mm| max_stoppable_feed_mm_min(plan, mm)).fold(search_feed_before_first_touch_mm_min(plan), f64::min)
}

/// Feed near the part until a touch has shown that the probe works, mm/min: the smaller of search feed and guarded
/// feed.
pub(super) fn search_feed_before_first_touch_mm_min(plan: &Plan) -> f64 {
    plan.probe.guarded_feed_mm_min.min(plan.probe.search_feed_mm_min)
}

/// Feed of moves near the part, mm/min: the guarded feed after any touch; before the first touch, not above the
/// search feed.
pub(super) fn near_part_feed_mm_min(plan: &Plan, touched: TouchedDirections) -> f64 {
    match touched.has_any_direction() {
        true => plan.probe.guarded_feed_mm_min,
        false => search_feed_before_first_touch_mm_min(plan),
    }
}
