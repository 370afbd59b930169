//! True quantities of the simulated world, and samples during a move: for tests alone.

use super::beam::SensorOutput;
use super::{SimulatedWorld, Speed};
use machine::{Axis, Position};

/// A sample that a sensor takes during a move.
#[derive(Debug, Clone)]
pub struct SampleInMotion {
    /// Displayed position, at the time of output.
    pub displayed_position: Position,
    /// Simulated time of the output; the sensor measured earlier by its latency.
    pub world_time_s: f64,
    pub output: SensorOutput,
}

impl SimulatedWorld {
    /// Synchronous error motion, mm or rad, of the rotary axis along or about the axis `component` at the unwrapped
    /// angle, rad; without location errors.
    pub fn true_rotary_error_motion(&self, axis: Axis, component: Axis, angle: f64) -> f64 {
        self.scene.rotary_error_motion(axis, component, angle)
    }

    /// True position of the rotary axis in the two directions across it (C: X, Y; A: Y, Z; B: Z, X), machine frame,
    /// at `height_mm` along it and at time `t_s`; includes location errors, gains and drift, but not the error motions
    /// (of mean zero). NaN for an axis that does not carry the artefact.
    pub fn true_rotary_axis_position_mm(&self, axis: Axis, height_mm: f64, t_s: f64) -> [f64; 2] {
        self.scene.rotary_axis_position_across(axis, height_mm, t_s)
    }

    /// Displacement of the table by drift at `t_s`, machine frame, mm.
    pub fn true_table_drift_mm(&self, t_s: f64) -> [f64; 3] {
        self.scene.table_drift(t_s).into()
    }

    /// True stylus-ball centre relative to the spindle datum, spindle frame.
    pub fn true_stylus_centre_mm(&self) -> [f64; 3] {
        self.scene.true_stylus_centre_in_spindle().into()
    }

    /// Sample of the sensor `name` at `t_s`, which is not later than now, and the axis positions at that time.
    /// `None`: there is no such sensor.
    pub fn sample_at(&mut self, name: &str, t_s: f64) -> Option<SampleInMotion> {
        let number = self.sensor_index(name)?;
        let position = match self.motion_history.path_and_fraction_at(t_s) {
            Some((path, along)) => self.rounded_to_resolution(&path.command_at_fraction(along)),
            None => self.displayed_position(),
        };
        Some(SampleInMotion {
            displayed_position: position,
            world_time_s: t_s,
            output: self.sensor_output(number, t_s)?,
        })
    }

    /// Makes a straight, unguarded move of the axes named in `to`, during which the sensor `name` samples every
    /// `period_s` by its clock. Empty, without a move, if there is no such sensor or nothing moves.
    pub fn move_and_sample(&mut self, name: &str, to: &Position, speed: Speed, period_s: f64) -> Vec<SampleInMotion> {
        let (Some(number), Some(path)) = (self.sensor_index(name), self.move_path_to(to, speed)) else {
            return Vec::new();
        };
        let (start_s, lasts_s) = (self.simulated_time_s, path.velocity_profile.duration_s());
        self.motion_history.record_move(start_s, &path, 1.0);
        let (mut samples, mut t_s) = (Vec::new(), start_s);
        while let Some(elapsed_s) = self.time_to_next_sample_s(number, period_s) {
            t_s += elapsed_s;
            if t_s > start_s + lasts_s || elapsed_s <= 0.0 {
                break;
            }
            let Some(sample) = self.sample_at(name, t_s) else { break };
            samples.push(sample);
        }
        self.stop_at_path_fraction(&path, 1.0, lasts_s);
        samples
    }
}
