//! An independent program: plays a plan on a simulated machine from the plan alone.

use machine::record::plan::{Plan, Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};
use methods::{Method, MethodRefusal, NextStage, ObjectPositionSource};
use simulator::{SensorOutput, SimulatedWorld, Speed};

/// Plays one step: over the part, down, touch, back, up.
pub fn play_step(world: &mut SimulatedWorld, step: &Step, repeat_number: u32) -> Reading {
    let rapid = |world: &mut SimulatedWorld, to: &Position| {
        assert!(!world.travel(to, Speed::Rapid).has_probe_closed, "touched on the way to {}", step.label);
    };
    let over = step.from.get_or_zero(Axis::Z) + 60.0;
    rapid(world, &Position::new().with(Axis::Z, over.max(250.0)));
    rapid(world, &step.from.filter_axes(|axis| !axis.is_linear()));
    rapid(world, &step.from.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y)));
    rapid(world, &step.from.filter_axes(|axis| axis == Axis::Z));
    let reading = play_touch(world, step, repeat_number);
    world.travel(&step.from.filter_axes(Axis::is_linear), Speed::Feed { mm_min: 300.0 });
    reading
}

/// One touch from the current position of the world.
pub fn play_touch(world: &mut SimulatedWorld, step: &Step, repeat_number: u32) -> Reading {
    let linear = step.to.filter_axes(Axis::is_linear);
    let contact = world.probe(&linear, step.feed_mm_min, step.id).contact.expect("contact");
    Reading {
        step: step.id,
        repeat: repeat_number,
        position: contact.latched_position,
        value_mm: None,
        sensor: step.first_sensor().to_owned(),
        t_s: contact.latch_time_s,
        flag: ReadingFlag::None,
        temperatures_c: Default::default(),
    }
}

/// Measures along the path of a step, sample by sample.
fn play_scan(world: &mut SimulatedWorld, step: &Step, scan: &Scan, repeat_number: u32) -> Vec<Reading> {
    let reading = |sensor: &str, position: Position, t_s: f64, sensed: SensorOutput| {
        let (value_mm, flag) = match sensed {
            SensorOutput::Distance(mm) => (Some(mm), ReadingFlag::None),
            SensorOutput::NoEcho | SensorOutput::OutOfRange(_) => (None, ReadingFlag::Range),
            SensorOutput::TooMuchLight => (None, ReadingFlag::Saturated),
        };
        let (sensor, temperatures_c) = (sensor.to_owned(), Default::default());
        Reading { step: step.id, repeat: repeat_number, position, value_mm, sensor, t_s, flag, temperatures_c }
    };
    let speed = Speed::Feed { mm_min: step.feed_mm_min };
    let mut readings = Vec::new();
    for (number, point) in scan.path.iter().enumerate() {
        match scan.sampling {
            Sampling::Continuous { rate_hz, .. } if number > 0 => {
                let start = world.clone();
                for name in &step.sensors {
                    // Each sensor measures the same motion.
                    *world = start.clone();
                    let passing = world.move_and_sample(name, point, speed, 1.0 / rate_hz);
                    let of_sensor =
                        passing.into_iter().map(|p| reading(name, p.displayed_position, p.world_time_s, p.output));
                    readings.extend(of_sensor);
                }
                // No noise value of this path repeats.
                world.advance(0.0, []);
            }
            Sampling::Continuous { .. } => {
                world.travel(point, speed);
            }
            Sampling::Dwell { dwell_s, samples } => {
                world.travel(point, speed);
                world.dwell(dwell_s);
                for name in &step.sensors {
                    for _ in 0..samples {
                        let sensed = world.sample_after(name, 1e-3).expect("a sensor");
                        readings.push(reading(name, world.displayed_position(), world.time_s(), sensed));
                    }
                }
            }
        }
    }
    readings
}

/// Measures a whole method on `world`; the plan grows with its stages.
pub fn measure_all_stages(world: &mut SimulatedWorld, method: &dyn Method, plan: Plan) -> (Plan, Vec<Reading>) {
    try_measure_all_stages(world, method, plan, play_step).expect("well-posed")
}

/// Like [`measure_all_stages`], with `play` for the touches; `Err`: why the method refuses a stage.
pub fn try_measure_all_stages(
    world: &mut SimulatedWorld,
    method: &dyn Method,
    mut plan: Plan,
    play: fn(&mut SimulatedWorld, &Step, u32) -> Reading,
) -> Result<(Plan, Vec<Reading>), MethodRefusal> {
    let (mut done, mut readings) = (Vec::<Stage>::new(), Vec::new());
    loop {
        let next = method.next_stage(&plan, &done, ObjectPositionSource::Measured(&readings))?;
        let NextStage::Stage { stage, new_steps } = next else { return Ok((plan, readings)) };
        plan.steps.extend(new_steps);
        for step in plan.steps.iter().filter(|step| stage.steps.contains(&step.id)) {
            if let Some(mount) = step.mount {
                world.remount_datum_cylinder(mount.turn_deg);
            }
            match &step.scan {
                _ if step.kind == StepKind::Prompt => {}
                None => readings.push(play(world, step, stage.repeat)),
                Some(scan) => readings.extend(play_scan(world, step, scan, stage.repeat)),
            }
        }
        done.push(stage);
    }
}
