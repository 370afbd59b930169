//! Five axes and the spindle orientation over the grbl wire: the simulated control executes a block with the same
//! result as the same moves on the world itself.

use machine::kinematics::KinematicChain;
use machine::record::artefact::Artefact;
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position, frame::Point};
use nalgebra::Vector3;
use simulator::{SimulatedWorld, Speed};
use trued::setup::{self, EarlierSessions, MachineFile, SimulationPace};

use crate::support::proven_block::proven_block_without_collision_check;

/// B, C, S in degrees, and the ball (counted from 0) that is touched on its top.
const TOUCH_POSES: [([f64; 3], usize); 5] = [
    ([0.0, 0.0, 0.0], 0),
    ([-30.0, 90.0, 90.0], 2),
    ([60.0, -180.0, 270.0], 3),
    ([90.0, 0.0, 180.0], 2),
    ([-90.0, 270.0, 90.0], 3),
];
const GUARDED_FEED_MM_MIN: f64 = 3000.0;

fn ball_top_touch_block(file: &MachineFile, step: u32, [b, c, s]: [f64; 3], ball: usize) -> MotionBlock {
    let Artefact::Balls(balls) = &file.artefact else { panic!("no balls") };
    let turned = Position::new().with(Axis::B, b.to_radians()).with(Axis::C, c.to_radians());
    let oriented = turned.clone().with(Axis::S, s.to_radians());
    let chain = KinematicChain::new(&file.machine).unwrap();
    let up = chain.machine_from_table(&turned, &[]).rotation.inverse() * Vector3::z();
    let tip = Point::from_vec(Vector3::from(file.machine.tool_mm));
    let over = |off: f64| {
        let target = Vector3::from(balls.balls[ball].centre_mm) + up * off;
        chain.solve_linear_axes(Point::from_vec(target), tip, &oriented, &[]).unwrap()
    };
    let height = |off: f64| over(off).filter_axes(|axis| axis == Axis::Z);
    let motions = vec![
        Motion::Rapid { to: Position::new().with(Axis::Z, 750.0) },
        Motion::Rapid { to: turned },
        Motion::OrientSpindle { s: s.to_radians() },
        Motion::Rapid { to: over(12.0).filter_axes(|axis| axis != Axis::Z) },
        Motion::Guarded { to: height(12.0), feed_mm_min: GUARDED_FEED_MM_MIN },
        Motion::Probe { to: height(7.0), feed_mm_min: 60.0 },
        Motion::BackOff { to: height(12.0), feed_mm_min: 300.0 },
    ];
    MotionBlock { step, repeat: 0, motions }
}

/// Executes the moves of a block without a control.
fn execute_in_world_for_contact(world: &mut SimulatedWorld, block: &MotionBlock) -> Position {
    let mut found = None;
    for motion in &block.motions {
        match motion {
            Motion::Rapid { to } => assert!(!world.travel(to, Speed::Rapid).has_probe_closed),
            Motion::OrientSpindle { s } => world.orient_spindle(*s),
            Motion::Guarded { to, feed_mm_min } => {
                assert_eq!(world.probe(to, *feed_mm_min, block.step).contact, None);
            }
            Motion::Probe { to, feed_mm_min } => {
                found = world.probe(to, *feed_mm_min, block.step).contact;
            }
            Motion::BackOff { to, feed_mm_min } | Motion::Feed { to, feed_mm_min } => {
                world.travel(to, Speed::Feed { mm_min: *feed_mm_min });
            }
            Motion::Dwell { seconds } => world.dwell(*seconds),
        }
    }
    found.expect("contact").latched_position
}

#[test]
fn simulated_control_gives_the_same_contacts_as_the_world() {
    let file = MachineFile::built_in_for_method("samba").unwrap();
    let mut world = setup::build_world(&file).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let devices = setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
        devices.open_controller.prepare().await.unwrap();
        for (step, (pose, ball)) in TOUCH_POSES.into_iter().enumerate() {
            let block = ball_top_touch_block(&file, step as u32, pose, ball);
            let expected = execute_in_world_for_contact(&mut world, &block);
            let outcome = devices
                .open_controller
                .execute(proven_block_without_collision_check(&file, &devices, &block))
                .await
                .unwrap();
            let found = outcome.trigger_position.unwrap();
            for axis in Axis::ALL.into_iter().filter(|axis| expected.get(*axis).is_some()) {
                // Moves are written to 0.1 µm; contacts are reported with the resolution of Z, 1 µm.
                let off = axis.to_mm_or_deg(found.get_or_zero(axis) - expected.get_or_zero(axis)).abs();
                assert!(off <= 1.001e-3, "{axis} at {pose:?}: {off}");
            }
        }
        devices.open_controller.restore_modes().await.unwrap();
    });
}

/// The test above would not detect a missing orientation of the spindle: a stylus that is 1 mm off its axis is
/// elsewhere after half a turn.
#[test]
fn spindle_orientation_turns_an_offset_stylus() {
    let text = include_str!("../../config/samba.toml")
        .replace("tool_offset_um = [0.0, 0.0, -17.0]", "tool_offset_um = [1000.0, 0.0, 0.0]");
    let file = MachineFile::parse("off.toml", text).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let devices = setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
        devices.open_controller.prepare().await.unwrap();
        let mut heights = Vec::new();
        for (step, s) in [0.0, 180.0].into_iter().enumerate() {
            // At 3 mm from the pole the slope of the ball is 3/9.35 of the stylus offset.
            let mut block = ball_top_touch_block(&file, step as u32, [0.0, 0.0, s], 0);
            for motion in &mut block.motions {
                if let Motion::Rapid { to } = motion
                    && let Some(x) = to.get(Axis::X)
                {
                    to.set(Axis::X, x + 3.0);
                }
            }
            let found =
                devices.open_controller.execute(proven_block_without_collision_check(&file, &devices, &block)).await;
            let found = found.unwrap().trigger_position.unwrap();
            heights.push(found.get_or_zero(Axis::Z));
        }
        let sphere = |off: f64| (9.35_f64.powi(2) - off * off).sqrt();
        // The set of balls is 0.3 mm off, and each ball some tenths more.
        let expected = sphere(2.7 + 1.0) - sphere(2.7 - 1.0);
        let found = heights[0] - heights[1];
        assert!((found - expected).abs() < 0.2, "{found} instead of {expected}");
    });
}
