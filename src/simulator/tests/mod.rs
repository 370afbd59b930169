//! Test fixture: an ideal C table under X, Y, Z and an oriented spindle; each test adds its errors.

mod balls;
mod beam;
mod contact;
mod datum_cylinder;
mod motion;
mod random_errors;
mod table_sensors;

use super::*;

pub(super) struct TestBench {
    pub machine: Machine,
    pub probe: Probe,
    pub artefact: Artefact,
    pub truth: MachineTruth,
}

/// Radius of the part, of the ball, and of the ball centre's circle, mm.
pub(super) const PART_RADIUS_MM: f64 = 45.0;
pub(super) const STYLUS_BALL_RADIUS_MM: f64 = 3.0;
pub(super) const BALL_CENTRE_CIRCLE_RADIUS_MM: f64 = PART_RADIUS_MM + STYLUS_BALL_RADIUS_MM;

impl TestBench {
    pub fn ideal() -> Self {
        let linear = "{ min = -500, max = 500, rapid_per_min = 6000, acceleration_per_s2 = 1000 }";
        let rotary = "{ min = -360, max = 360, rapid_per_min = 1800, acceleration_per_s2 = 300 }";
        let machine = format!(
            "name = 'bench'\ntopology = 'w-C-B-X-F-Z-Y-S-t'\ntool_mm = [0, 0, -100]\n[axes]\n\
             X = {linear}\nY = {linear}\nZ = {linear}\nB = {rotary}\nC = {rotary}\nS = {rotary}"
        );
        let artefact =
            format!("kind = 'cylinder'\ncentre_mm = [0, 0, 0]\naxis = [0, 0, 1]\nradius_mm = {PART_RADIUS_MM}");
        Self {
            machine: toml::from_str(&machine).unwrap(),
            probe: toml::from_str(&format!("ball_radius_mm = {STYLUS_BALL_RADIUS_MM}")).unwrap(),
            artefact: toml::from_str(&artefact).unwrap(),
            truth: MachineTruth::default(),
        }
    }

    /// The same machine with balls in place of the part.
    pub fn with_balls(balls: &str) -> Self {
        let artefact = toml::from_str(&format!("kind = 'balls'\n{balls}")).unwrap();
        Self { artefact, ..Self::ideal() }
    }

    pub fn stated_axis_mut(&mut self, axis: Axis) -> &mut StatedAxis {
        self.machine.axes.get_mut(&axis).unwrap()
    }

    pub fn build_world(&self) -> SimulatedWorld {
        SimulatedWorld::new(&self.machine, &self.probe, &self.artefact, &self.truth).unwrap()
    }
}

/// Linear axes that bring the ball of the ideal machine to a point, with all rotary axes at zero.
pub(super) fn position_with_ball_at(x: f64, y: f64, z: f64) -> Position {
    Position::new().with(Axis::X, x).with(Axis::Y, y).with(Axis::Z, z + 100.0)
}

/// Touches at half height from outside along the direction `phi` (rad), with the spindle at `spindle_angle` (rad).
/// Returns the displayed radius of the ball (along phi) and the time.
pub(super) fn touch_radius_and_latch_time(
    world: &mut SimulatedWorld,
    phi: f64,
    spindle_angle: f64,
    n_word: u32,
) -> (f64, f64) {
    let at = |radius: f64, z: f64| position_with_ball_at(radius * phi.cos(), radius * phi.sin(), z);
    let clear = Speed::Feed { mm_min: 6000.0 };
    let lifted = world.displayed_position().with(Axis::Z, 300.0);
    assert!(!world.travel(&lifted, Speed::Rapid).has_probe_closed);
    world.orient_spindle(spindle_angle);
    for to in [at(60.0, 200.0), at(60.0, 50.0)] {
        assert!(!world.travel(&to, clear).has_crashed);
    }
    let contact = world.probe(&at(40.0, 50.0), 30.0, n_word).contact.unwrap();
    world.travel(&at(60.0, 50.0), clear);
    let (x, y) = (contact.latched_position.get_or_zero(Axis::X), contact.latched_position.get_or_zero(Axis::Y));
    (x * phi.cos() + y * phi.sin(), contact.latch_time_s)
}
