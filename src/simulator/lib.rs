//! The simulated machine: its true errors, and the simulated controls and sensors that act on it. One machine
//! with all its errors, one probe, one artefact; exact, nonlinear and independent of the estimators' equations.
//! Simulated time advances only by motion and dwell.
//!
//! Directions: error motions of X, Y and Z, and drift, shift the tool against the table along the machine axes.
//! Pre-travel and its scatter act along the contact normal: the probe triggers where the sum of pre-travel, scatter
//! and the gap between ball and surface falls to zero.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod balls;
mod beam;
pub mod controls;
mod crc16;
mod datum_cylinder_truth;
mod error;
pub mod faulty_wire;
pub mod interpreter;
mod linear_errors;
mod machine_pose;
mod magnitude_check;
mod motion_history;
mod mounted_sensors;
mod nearest_surface;
mod operator;
mod random_draws;
mod rotary_errors;
mod rotary_motion;
mod sag;
mod scene;
pub mod sensor_devices;
mod sensor_truth;
mod sensor_view;
mod straight_move;
mod surface;
mod testing;
mod thermometer_truth;
mod true_datum_cylinder;
mod true_round_part;
mod truth;
mod velocity_profile;
mod wiring;

use std::collections::BTreeMap;

pub use beam::SensorOutput;
pub use datum_cylinder_truth::{DatumCylinderTruth, IndexingStageTruth, MountingAngleFault, SectionFormHarmonic};
pub use error::SimulatedWorldError;
pub use operator::SimulatedOperator;
pub use rotary_motion::RotaryMotionMagnitudes;
pub use sensor_truth::{LinearityWave, SensorTruth};
pub use testing::SampleInMotion;
pub use true_round_part::FormHarmonic;
pub use truth::{ErrorMotionHarmonic, LatchDelay, MachineTruth};
pub use velocity_profile::Speed;

use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe, StatedAxis};
use machine::{Axis, Position};
use motion_history::MotionHistory;
use mounted_sensors::SimulatedSensor;
use random_draws::{RandomSource, draw_normal};
use scene::TrueScene;
use straight_move::{LostMotion, MoveBounds, MovePath};
use thermometer_truth::ThermometerTruth;
use velocity_profile::{SEARCH_STEP_FLOOR_MM, first_zero_crossing_fraction};
use wiring::TrueWiring;

/// Result of an unguarded move.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MoveResult {
    /// The probe closed during the move or is closed at its end; if nothing moved: its input reads closed.
    pub has_probe_closed: bool,
    /// The stylus was deflected beyond its overtravel.
    pub has_crashed: bool,
    pub duration_s: f64,
}

/// Result of a probing move.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ProbeResult {
    /// `None`: the move reached its target, and no contact was reported by the probe input.
    pub contact: Option<LatchedContact>,
    /// The stylus was deflected beyond its overtravel while braking or, with a simulated input fault, on the way.
    /// `false` as well if the wiring keeps the input from changing.
    pub has_crashed: bool,
    /// Simulated duration of the move, braking included.
    pub duration_s: f64,
}

/// A contact of the probe, as the control latches it.
#[derive(Debug, Clone, PartialEq)]
pub struct LatchedContact {
    /// Displayed axis positions when the control latched them.
    pub latched_position: Position,
    /// Simulated time at which the control latched them.
    pub latch_time_s: f64,
}

/// The only owner of simulated time, axis positions and the state of the probe.
#[derive(Debug, Clone)]
pub struct SimulatedWorld {
    scene: TrueScene,
    stated_axes: BTreeMap<Axis, StatedAxis>,
    seed: u64,
    /// Standard deviation of the trigger point of one touch along the contact normal.
    touch_std_dev_mm: f64,
    /// Largest overlap of stylus ball and surface without a crash.
    stylus_overtravel_mm: f64,
    latch_delay: LatchDelay,
    simulated_time_s: f64,
    /// Commanded positions of all axes, not rounded to the resolution, mm or rad.
    commanded_position: Position,
    lost_motion: LostMotion,
    true_wiring: TrueWiring,
    /// Scatter of the current touch, mm, positive if the probe triggers later; between two touches, that of the last.
    current_touch_scatter_mm: f64,
    /// Whether a person deflects the stylus by hand.
    is_stylus_deflected: bool,
    /// Whether the probe is not in the spindle.
    is_probe_removed: bool,
    /// Number of probing moves for each N word.
    probe_counts_by_line: BTreeMap<u32, u32>,
    /// Errors of all `[[simulated.sensor]]`, for the sensors to be added.
    sensor_truths: Vec<SensorTruth>,
    sensors: Vec<SimulatedSensor>,
    /// Past motion, recorded only if there are sensors.
    motion_history: MotionHistory,
    thermometers: Vec<ThermometerTruth>,
}

impl SimulatedWorld {
    /// Creates a world with all axes at zero, except Z at its upper limit, at time zero.
    ///
    /// # Errors
    /// A topology or an error symbol cannot be parsed, an error refers to an axis that the machine lacks, a
    /// unit is wrong, the artefact is impossible, or a magnitude is negative.
    pub fn new(
        machine: &Machine,
        probe: &Probe,
        artefact: &Artefact,
        truth: &MachineTruth,
    ) -> Result<Self, SimulatedWorldError> {
        magnitude_check::check_magnitudes(machine, probe, truth)?;
        let scene = TrueScene::new(machine, probe, artefact, truth)?;
        let mut command: Position = scene.axes().map(|axis| (axis, 0.0)).collect();
        command.set(Axis::Z, machine.axes.get(&Axis::Z).map_or(0.0, |spec| spec.max));
        Ok(Self {
            scene,
            stated_axes: machine.axes.clone(),
            seed: truth.seed,
            touch_std_dev_mm: probe.repeatability_um.unwrap_or_default() * 1e-3,
            stylus_overtravel_mm: probe.overtravel_mm,
            latch_delay: truth.latch,
            simulated_time_s: 0.0,
            lost_motion: LostMotion::new(&true_backlash_um(machine, truth), &command),
            true_wiring: TrueWiring::new(&truth.wiring, &command),
            commanded_position: command,
            current_touch_scatter_mm: 0.0,
            is_stylus_deflected: false,
            is_probe_removed: false,
            probe_counts_by_line: BTreeMap::new(),
            sensor_truths: truth.sensor.clone(),
            sensors: Vec::new(),
            motion_history: MotionHistory::default(),
            thermometers: truth.thermometer.clone(),
        })
    }

    /// Advances the world by `seconds`, and counts a probing move for each of the N words
    /// `probed_line_numbers`, so that the next touches have new scatter.
    pub fn advance(&mut self, seconds: f64, probed_line_numbers: impl IntoIterator<Item = u32>) {
        self.dwell(seconds);
        for n in probed_line_numbers {
            *self.probe_counts_by_line.entry(n).or_default() += 1;
        }
        self.sensors.iter_mut().for_each(|sensor| sensor.advance_sample_index_to_time(self.simulated_time_s));
    }

    /// Simulated time since the world was created.
    pub fn time_s(&self) -> f64 {
        self.simulated_time_s
    }

    /// Axis positions as displayed by the control: linear axes in whole steps.
    pub fn displayed_position(&self) -> Position {
        self.rounded_to_resolution(&self.commanded_position)
    }

    /// Whether the probe input reads closed now.
    pub fn is_probe_closed(&self) -> bool {
        self.true_wiring.is_probe_input_closed(self.is_in_contact())
    }

    /// Whether the probe is truly closed: deflected by hand, or in the spindle and in contact with the artefact.
    fn is_in_contact(&self) -> bool {
        if self.is_stylus_deflected {
            return true;
        }
        !self.is_probe_removed && self.trigger_distance() + self.current_touch_scatter_mm <= 0.0
    }

    /// Distance of the stylus from the trigger point at the true axis positions, without the scatter of the touch,
    /// mm; negative in contact.
    fn trigger_distance(&self) -> f64 {
        let command = self.true_wiring.true_position(self.commanded_position.clone());
        self.scene.trigger_distance(&self.true_axis_positions(), &command, self.simulated_time_s)
    }

    /// Positions that the axes really have: the commanded ones, changed by the lost motion and the true wiring.
    fn true_axis_positions(&self) -> Position {
        self.true_wiring.true_position(self.lost_motion.position_after_move_to(&self.commanded_position))
    }

    /// Removes the probe from the spindle, or puts it back. Without a probe there is no contact and no damage.
    pub fn set_probe_removed(&mut self, is_removed: bool) {
        self.is_probe_removed = is_removed;
    }

    /// Mounts a datum cylinder again on its indexing stage, turned by this angle against its first mounting,
    /// counter-clockwise seen from its tip. Does nothing with another artefact.
    pub fn remount_datum_cylinder(&mut self, turn_deg: f64) {
        self.scene.surface.remount_datum_cylinder(turn_deg);
    }

    /// Deflects the stylus by hand, or releases it.
    pub fn set_stylus_deflected(&mut self, is_stylus_deflected: bool) {
        self.is_stylus_deflected = is_stylus_deflected;
    }

    /// Makes a straight, unguarded move of the axes named in `to`; no contact stops it. Axes that the machine
    /// lacks do not move.
    pub fn travel(&mut self, to: &Position, speed: Speed) -> MoveResult {
        let Some(path) = self.move_path_to(to, speed) else {
            return MoveResult { has_probe_closed: self.is_probe_closed(), ..MoveResult::default() };
        };
        let has_touched = self.is_probe_closed_on_path(&path);
        let stylus_travel_left = |fraction| self.stylus_clearance_on_path(&path, fraction) + self.stylus_overtravel_mm;
        let has_crashed = first_zero_crossing_fraction(stylus_travel_left, path.max_stylus_travel_mm, 0.0).is_some();
        let duration_s = path.velocity_profile.duration_s();
        self.finish_move(&path, 1.0, duration_s);
        MoveResult { has_probe_closed: has_touched, has_crashed, duration_s }
    }

    /// Sets the delay with which contacts are latched from now on.
    pub fn set_latch_delay(&mut self, latch: LatchDelay) {
        self.latch_delay = latch;
    }

    /// Moves until the probe triggers and the contact is latched, then brakes. `line_number` is the N word. The scatter
    /// is drawn for the N word and the number of earlier probing moves with this N word, so that the order of the
    /// touches does not matter. If the probe is closed at the start, contact is reported there.
    pub fn probe(&mut self, to: &Position, feed_mm_min: f64, line_number: u32) -> ProbeResult {
        let occurrence = self.probe_counts_by_line.entry(line_number).or_default();
        let key = [u64::from(line_number), u64::from(*occurrence)];
        self.current_touch_scatter_mm =
            self.touch_std_dev_mm * draw_normal(self.seed, RandomSource::TouchScatter, &key);
        let scan_phase = random_draws::draw_plc_scan_phase(self.seed, line_number, *occurrence);
        *occurrence += 1;
        let Some(path) = self.move_path_to(to, Speed::Feed { mm_min: feed_mm_min }) else {
            let here =
                LatchedContact { latched_position: self.displayed_position(), latch_time_s: self.simulated_time_s };
            return ProbeResult { contact: self.is_probe_closed().then_some(here), ..ProbeResult::default() };
        };
        let contact = first_zero_crossing_fraction(
            |fraction| self.trigger_distance_on_path(&path, fraction),
            path.max_stylus_travel_mm,
            0.0,
        );
        match contact.filter(|_| self.true_wiring.probe_input_reacts_to_contact()) {
            Some(fraction) => {
                let late_s = (self.latch_delay.delay_ms + scan_phase * self.latch_delay.scan_ms) * 1e-3;
                self.stop_on_contact(&path, path.velocity_profile.fraction_after(fraction, late_s))
            }
            None => {
                let duration_s = path.velocity_profile.duration_s();
                self.finish_move(&path, 1.0, duration_s);
                ProbeResult { duration_s, ..ProbeResult::default() }
            }
        }
    }

    /// Turns the spindle to `s_rad` at its rapid speed.
    pub fn orient_spindle(&mut self, s_rad: f64) {
        self.travel(&Position::new().with(Axis::S, s_rad), Speed::Rapid);
    }

    pub fn dwell(&mut self, seconds: f64) {
        self.simulated_time_s += seconds.max(0.0);
    }

    /// Latches the contact at `fraction` of the path, then brakes.
    fn stop_on_contact(&mut self, path: &MovePath, fraction: f64) -> ProbeResult {
        let t_s = self.simulated_time_s + path.velocity_profile.time_at_fraction_s(fraction);
        let contact = LatchedContact {
            latched_position: self.rounded_to_resolution(&path.command_at_fraction(fraction)),
            latch_time_s: t_s,
        };
        let (rest, duration_s) = path.velocity_profile.rest_fraction_and_time_s(fraction);
        let has_crashed = self.stylus_clearance_on_path(path, rest) < -self.stylus_overtravel_mm;
        self.finish_move(path, rest, duration_s);
        ProbeResult { contact: Some(contact), has_crashed, duration_s }
    }

    /// Whether the probe is closed at the end of the move or closes on the way. If it is closed at the start, it must
    /// open and close again to count, unless it never opens.
    fn is_probe_closed_on_path(&self, path: &MovePath) -> bool {
        let margin = |fraction| self.trigger_distance_on_path(path, fraction);
        let max_slope_mm = path.max_stylus_travel_mm;
        let open = if margin(0.0) > 0.0 {
            Some(0.0)
        } else {
            // Slightly beyond the point at which the probe opens, so that the input is safely open.
            first_zero_crossing_fraction(|fraction| -margin(fraction), max_slope_mm, 0.0)
                .map(|fraction| (fraction + SEARCH_STEP_FLOOR_MM / max_slope_mm).min(1.0))
        };
        margin(1.0) <= 0.0 || open.is_none_or(|o| first_zero_crossing_fraction(margin, max_slope_mm, o).is_some())
    }

    /// Path of a move from the commanded position; `None`: nothing moves.
    fn move_path_to(&self, to: &Position, speed: Speed) -> Option<MovePath> {
        let lever_arm = |axis, at: &Position| self.scene.max_stylus_distance_from_axis(axis, at);
        let limits = MoveBounds {
            stated_axes: &self.stated_axes,
            max_stylus_distance_from_axis: &lever_arm,
            max_true_travel_ratio: self.true_wiring.max_true_travel_ratio(),
        };
        MovePath::new(&self.commanded_position, to, speed, &self.lost_motion, &limits)
    }

    /// Distance from the trigger point, with the scatter of the touch, mm.
    fn trigger_distance_on_path(&self, path: &MovePath, fraction: f64) -> f64 {
        if self.is_probe_removed {
            return f64::MAX;
        }
        let (axes, command) = self.true_positions_with_and_without_lost_motion(path, fraction);
        let t_s = self.simulated_time_s + path.velocity_profile.time_at_fraction_s(fraction);
        self.scene.trigger_distance(&axes, &command, t_s) + self.current_touch_scatter_mm
    }

    /// Distance between ball and surface, mm; negative: overlap.
    fn stylus_clearance_on_path(&self, path: &MovePath, fraction: f64) -> f64 {
        if self.is_probe_removed {
            return f64::MAX;
        }
        let (axes, command) = self.true_positions_with_and_without_lost_motion(path, fraction);
        let t_s = self.simulated_time_s + path.velocity_profile.time_at_fraction_s(fraction);
        self.scene.stylus_clearance(&axes, &command, t_s)
    }

    /// True axis positions, with and without lost motion.
    fn true_positions_with_and_without_lost_motion(&self, path: &MovePath, fraction: f64) -> (Position, Position) {
        (
            self.true_wiring.true_position(path.true_axes_at_fraction(fraction)),
            self.true_wiring.true_position(path.command_at_fraction(fraction)),
        )
    }

    /// Ends a move at `fraction` of its path, and records it for the sensors.
    fn finish_move(&mut self, path: &MovePath, fraction: f64, duration_s: f64) {
        if !self.sensors.is_empty() {
            self.motion_history.record_move(self.simulated_time_s, path, fraction);
        }
        self.stop_at_path_fraction(path, fraction, duration_s);
    }

    fn stop_at_path_fraction(&mut self, path: &MovePath, fraction: f64, duration_s: f64) {
        self.commanded_position = path.command_at_fraction(fraction);
        self.lost_motion.update_actual_position(&self.commanded_position);
        self.simulated_time_s += duration_s;
    }

    /// Linear axes in whole steps of their stated resolution.
    fn rounded_to_resolution(&self, command: &Position) -> Position {
        let rounded = |(axis, value): (Axis, f64)| {
            let step = self.stated_axes.get(&axis).map_or(0.0, |spec| spec.resolution_um * 1e-3);
            let rounds_to_steps = axis.is_linear() && step > 0.0;
            (axis, if rounds_to_steps { (value / step).round() * step } else { value })
        };
        command.iter().map(rounded).collect()
    }
}

/// Whole lost motion of the linear axes: as `[simulated]` states it, or drawn from the declared magnitude.
fn true_backlash_um(machine: &Machine, truth: &MachineTruth) -> BTreeMap<Axis, f64> {
    let draw = |axis: Axis| draw_normal(truth.seed, RandomSource::Backlash, &[axis as u64]).abs();
    let drawn = machine.axes.iter().filter(|(_, spec)| spec.backlash_um > 0.0);
    let mut backlash_um: BTreeMap<Axis, f64> =
        drawn.map(|(axis, spec)| (*axis, spec.backlash_um * draw(*axis))).collect();
    backlash_um.extend(&truth.backlash_um);
    backlash_um
}

#[cfg(test)]
mod tests;
