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
mod check;
pub mod controls;
mod datum;
mod datum_truth;
mod drawn;
mod error;
pub mod faulty_wire;
mod flank;
pub mod interpreter;
mod linear_errors;
mod nearest;
mod operator;
mod path;
mod ramp;
mod rotary_errors;
mod rotary_motion;
mod sag;
mod scene;
mod sensing;
mod sensor_truth;
mod sensor_view;
pub mod sensors;
mod stand;
mod surface;
mod thermometer_truth;
mod trail;
mod truth;
mod wiring;

use std::collections::BTreeMap;

pub use beam::Sensed;
pub use datum_truth::{DatumTruth, IndexFault, SectionForm, StageTruth};
pub use error::WorldError;
pub use flank::FormHarmonic;
pub use operator::SimulatedOperator;
pub use ramp::Speed;
pub use rotary_motion::RotaryMotion;
pub use sensing::SampleInMotion;
pub use sensor_truth::{SensorTruth, Wave};
pub use truth::{ErrorMotion, Latch, Truth};

use machine::record::artefact::Artefact;
use machine::record::machine::{AxisSpec, Machine, Probe};
use machine::{Axis, Position};
use path::{Limits, Path, Play};
use ramp::{FINEST_MM, first_crossing};
use scene::Scene;
use sensing::SimulatedSensor;
use thermometer_truth::ThermometerTruth;
use trail::MotionHistory;
use wiring::Wired;

/// Result of an unguarded move.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Travel {
    /// The probe closed during the move, or reads closed at its end.
    pub touched: bool,
    /// The stylus was deflected beyond its overtravel.
    pub crashed: bool,
    pub duration_s: f64,
}

/// Result of a probing move.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Probed {
    /// `None`: the move reached its target without contact.
    pub contact: Option<Contact>,
    /// Braking deflected the stylus beyond its overtravel.
    pub crashed: bool,
    pub duration_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// Displayed axis positions when the control latched them.
    pub position: Position,
    pub t_s: f64,
}

/// The only owner of simulated time, axis positions and the state of the probe.
#[derive(Debug, Clone)]
pub struct World {
    scene: Scene,
    axes: BTreeMap<Axis, AxisSpec>,
    seed: u64,
    repeatability_mm: f64,
    overtravel_mm: f64,
    latch: Latch,
    t_s: f64,
    /// Commanded positions of all axes.
    command: Position,
    play: Play,
    wired: Wired,
    /// Scatter of the current touch (of the last one between touches), mm.
    scatter_mm: f64,
    /// Whether a person deflects the stylus by hand.
    deflected: bool,
    /// Whether the probe is not in the spindle.
    probe_away: bool,
    /// Number of probing moves for each N word.
    probed: BTreeMap<u32, u32>,
    sensor_truths: Vec<SensorTruth>,
    eyes: Vec<SimulatedSensor>,
    /// Past motion, recorded only if there are sensors.
    trail: MotionHistory,
    warmths: Vec<ThermometerTruth>,
}

impl World {
    /// Creates a world with all axes at zero, except Z at its upper limit, at time zero.
    ///
    /// # Errors
    /// A topology or an error symbol cannot be parsed, an error refers to an axis that the machine lacks, a
    /// unit is wrong, the artefact is impossible, or a magnitude is negative.
    pub fn new(
        machine: &Machine,
        probe: &Probe,
        artefact: &Artefact,
        truth: &Truth,
    ) -> Result<Self, WorldError> {
        check::check(machine, probe, truth)?;
        let scene = Scene::new(machine, probe, artefact, truth)?;
        let mut command: Position = scene.axes().map(|axis| (axis, 0.0)).collect();
        command.set(Axis::Z, machine.axes.get(&Axis::Z).map_or(0.0, |spec| spec.max));
        Ok(Self {
            scene,
            axes: machine.axes.clone(),
            seed: truth.seed,
            repeatability_mm: probe.repeatability_um.unwrap_or_default() * 1e-3,
            overtravel_mm: probe.overtravel_mm,
            latch: truth.latch,
            t_s: 0.0,
            play: Play::new(&backlash_um(machine, truth), &command),
            wired: Wired::new(&truth.wiring, &command),
            command,
            scatter_mm: 0.0,
            deflected: false,
            probe_away: false,
            probed: BTreeMap::new(),
            sensor_truths: truth.sensor.clone(),
            eyes: Vec::new(),
            trail: MotionHistory::default(),
            warmths: truth.thermometer.clone(),
        })
    }

    /// Advances the world by `seconds`, and counts a probing move for each of these N words, so that the next
    /// touches have new scatter.
    pub fn pass(&mut self, seconds: f64, probed: impl IntoIterator<Item = u32>) {
        self.dwell(seconds);
        for n in probed {
            *self.probed.entry(n).or_default() += 1;
        }
        self.eyes.iter_mut().for_each(|eye| eye.pass(self.t_s));
    }

    /// Simulated time since the world was created.
    pub fn time_s(&self) -> f64 {
        self.t_s
    }

    /// Axis positions as displayed by the control: linear axes in whole steps.
    pub fn position(&self) -> Position {
        self.displayed(&self.command)
    }

    /// Whether the probe input reads closed now.
    pub fn tripped(&self) -> bool {
        self.wired.shows(self.touches())
    }

    /// Whether the probe is truly closed.
    fn touches(&self) -> bool {
        if self.deflected {
            return true;
        }
        !self.probe_away && self.margin_here() + self.scatter_mm <= 0.0
    }

    /// Distance of the stylus from the trigger point at the true axis positions, mm; negative in contact.
    fn margin_here(&self) -> f64 {
        let command = self.wired.truly(self.command.clone());
        self.scene.margin(&self.true_axes(), &command, self.t_s)
    }

    /// True axis positions.
    fn true_axes(&self) -> Position {
        self.wired.truly(self.play.follow(&self.command))
    }

    /// Removes the probe from the spindle, or puts it back. Without it there is no contact and no damage.
    pub fn without_probe(&mut self, away: bool) {
        self.probe_away = away;
    }

    /// Mounts the artefact again on its indexing stage, turned by this angle against its first mounting,
    /// counter-clockwise seen from its tip.
    pub fn mount(&mut self, turn_deg: f64) {
        self.scene.mount(turn_deg);
    }

    /// For tests alone: error motion of the rotary axis along or about the axis `component` at the unwrapped
    /// angle, rad; mm or rad.
    pub fn true_rotary_motion(&self, axis: Axis, component: Axis, angle: f64) -> f64 {
        self.scene.rotary_motion(axis, component, angle)
    }

    /// Deflects the stylus by hand, or releases it.
    pub fn deflect(&mut self, deflected: bool) {
        self.deflected = deflected;
    }

    /// Makes a straight, unguarded move of the axes named in `to`; no contact stops it. Axes that the machine
    /// lacks do not move.
    pub fn travel(&mut self, to: &Position, speed: Speed) -> Travel {
        let Some(path) = self.path(to, speed) else {
            return Travel { touched: self.tripped(), ..Travel::default() };
        };
        let touched = self.closes(&path);
        let pressed = |fraction| self.clearance(&path, fraction) + self.overtravel_mm;
        let crashed = first_crossing(pressed, path.steepest(), 0.0).is_some();
        let duration_s = path.ramp().duration_s();
        self.arrive(&path, 1.0, duration_s);
        Travel { touched, crashed, duration_s }
    }

    /// Sets the delay with which contacts are latched from now on.
    pub fn latch_by(&mut self, latch: Latch) {
        self.latch = latch;
    }

    /// Moves until the probe triggers and the contact is latched, then brakes. `n` is the N word of the line:
    /// together with the number of probing moves under this word it keys the scatter, so that the order of the
    /// touches does not matter. With the probe closed at the start, contact is reported there.
    pub fn probe(&mut self, to: &Position, feed_mm_min: f64, n: u32) -> Probed {
        let occurrence = self.probed.entry(n).or_default();
        self.scatter_mm = self.repeatability_mm * drawn::touch_deviate(self.seed, n, *occurrence);
        let share = drawn::scan_share(self.seed, n, *occurrence);
        *occurrence += 1;
        let Some(path) = self.path(to, Speed::Feed { mm_min: feed_mm_min }) else {
            let here = Contact { position: self.position(), t_s: self.t_s };
            return Probed { contact: self.tripped().then_some(here), ..Probed::default() };
        };
        let contact = first_crossing(|fraction| self.margin(&path, fraction), path.steepest(), 0.0);
        match contact.filter(|_| self.wired.feels()) {
            Some(fraction) => {
                let late_s = (self.latch.delay_ms + share * self.latch.scan_ms) * 1e-3;
                self.stop_on_contact(&path, path.ramp().later(fraction, late_s))
            }
            None => {
                let duration_s = path.ramp().duration_s();
                self.arrive(&path, 1.0, duration_s);
                Probed { duration_s, ..Probed::default() }
            }
        }
    }

    /// Turns the spindle to `s` rad at its rapid speed.
    pub fn orient(&mut self, s: f64) {
        self.travel(&Position::new().with(Axis::S, s), Speed::Rapid);
    }

    pub fn dwell(&mut self, seconds: f64) {
        self.t_s += seconds.max(0.0);
    }

    /// For tests alone: true position of the rotary axis in the two directions across it (C: X, Y; A: Y, Z; B:
    /// Z, X), machine frame, at `height_mm` along it and at time `t_s`; includes location errors, gains and drift,
    /// but not the error motions (of mean zero). NaN for an axis that does not carry the artefact.
    pub fn true_axis_mm(&self, axis: Axis, height_mm: f64, t_s: f64) -> [f64; 2] {
        self.scene.axis_position(axis, height_mm, t_s)
    }

    /// For tests alone: displacement of the table by drift at `t_s`, machine frame, mm.
    pub fn true_drift_mm(&self, t_s: f64) -> [f64; 3] {
        self.scene.drift_at(t_s).into()
    }

    /// For tests alone: stylus-ball centre relative to the spindle datum, mm.
    pub fn true_stylus_mm(&self) -> [f64; 3] {
        self.scene.stylus().into()
    }

    fn stop_on_contact(&mut self, path: &Path, fraction: f64) -> Probed {
        let t_s = self.t_s + path.ramp().time_s(fraction);
        let contact = Contact { position: self.displayed(&path.command(fraction)), t_s };
        let (rest, duration_s) = path.ramp().stop_from(fraction);
        let crashed = self.clearance(path, rest) < -self.overtravel_mm;
        self.arrive(path, rest, duration_s);
        Probed { contact: Some(contact), crashed, duration_s }
    }

    /// Whether the probe closes during the move; a move that starts in contact must lose it first.
    fn closes(&self, path: &Path) -> bool {
        let margin = |fraction| self.margin(path, fraction);
        let steepest = path.steepest();
        let open = if margin(0.0) > 0.0 {
            Some(0.0)
        } else {
            // Slightly beyond the opening, where the input is safely open.
            first_crossing(|fraction| -margin(fraction), steepest, 0.0)
                .map(|fraction| (fraction + FINEST_MM / steepest).min(1.0))
        };
        margin(1.0) <= 0.0 || open.is_none_or(|o| first_crossing(margin, steepest, o).is_some())
    }

    fn path(&self, to: &Position, speed: Speed) -> Option<Path> {
        let longest = self.wired.longest();
        let lever = |axis, at: &Position| self.scene.lever(axis, at);
        let limits = Limits { axes: &self.axes, lever: &lever, longest };
        Path::new(&self.command, to, speed, &self.play, &limits)
    }

    fn margin(&self, path: &Path, fraction: f64) -> f64 {
        if self.probe_away {
            return f64::MAX;
        }
        let (axes, command) = self.true_on(path, fraction);
        let t_s = self.t_s + path.ramp().time_s(fraction);
        self.scene.margin(&axes, &command, t_s) + self.scatter_mm
    }

    fn clearance(&self, path: &Path, fraction: f64) -> f64 {
        if self.probe_away {
            return f64::MAX;
        }
        let (axes, command) = self.true_on(path, fraction);
        self.scene.clearance(&axes, &command, self.t_s + path.ramp().time_s(fraction))
    }

    /// True axis positions, with and without lost motion.
    fn true_on(&self, path: &Path, fraction: f64) -> (Position, Position) {
        (self.wired.truly(path.axes(fraction)), self.wired.truly(path.command(fraction)))
    }

    fn arrive(&mut self, path: &Path, fraction: f64, duration_s: f64) {
        if !self.eyes.is_empty() {
            self.trail.went(self.t_s, path, fraction);
        }
        self.stop_at(path, fraction, duration_s);
    }

    fn stop_at(&mut self, path: &Path, fraction: f64, duration_s: f64) {
        self.command = path.command(fraction);
        self.play.settle(&self.command);
        self.t_s += duration_s;
    }

    fn displayed(&self, command: &Position) -> Position {
        let rounded = |(axis, value): (Axis, f64)| {
            let step = self.axes.get(&axis).map_or(0.0, |spec| spec.resolution_um * 1e-3);
            let whole = axis.is_linear() && step > 0.0;
            (axis, if whole { (value / step).round() * step } else { value })
        };
        command.iter().map(rounded).collect()
    }
}

/// Lost motion of the linear axes: as stated, or drawn from the declared magnitude.
fn backlash_um(machine: &Machine, truth: &Truth) -> BTreeMap<Axis, f64> {
    let drawn =
        machine.axes.iter().filter(|(_, spec)| spec.backlash_um > 0.0).map(|(axis, spec)| {
            (*axis, spec.backlash_um * drawn::backlash(truth.seed, *axis as u64))
        });
    let mut backlash_um: BTreeMap<Axis, f64> = drawn.collect();
    backlash_um.extend(&truth.backlash_um);
    backlash_um
}

#[cfg(test)]
mod tests;
