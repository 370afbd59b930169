//! An independent program: plays a plan on a simulated machine from the plan alone.

use machine::record::plan::{Plan, Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::{Flag, Reading};
use machine::{Axis, Position};
use methods::{Method, Next, Refused, Source};
use simulator::{Sensed, Speed, World};

/// Plays one step: over the part, down, touch, back, up.
pub fn play(world: &mut World, step: &Step, repeat: u32) -> Reading {
    let rapid = |world: &mut World, to: &Position| {
        assert!(!world.travel(to, Speed::Rapid).touched, "touched on the way to {}", step.label);
    };
    let over = step.from.at(Axis::Z) + 60.0;
    rapid(world, &Position::new().with(Axis::Z, over.max(250.0)));
    rapid(world, &step.from.only(|axis| !axis.is_linear()));
    rapid(world, &step.from.only(|axis| matches!(axis, Axis::X | Axis::Y)));
    rapid(world, &step.from.only(|axis| axis == Axis::Z));
    let reading = touch(world, step, repeat);
    world.travel(&step.from.only(Axis::is_linear), Speed::Feed { mm_min: 300.0 });
    reading
}

/// One touch from the current position of the world.
pub fn touch(world: &mut World, step: &Step, repeat: u32) -> Reading {
    let linear = step.to.only(Axis::is_linear);
    let contact = world.probe(&linear, step.feed_mm_min, step.id).contact.expect("contact");
    Reading {
        step: step.id,
        repeat,
        position: contact.position,
        value_mm: None,
        sensor: step.sensor().to_owned(),
        t_s: contact.t_s,
        flag: Flag::None,
        temperatures_c: Default::default(),
    }
}

/// Measures along the path of a step, sample by sample.
fn look(world: &mut World, step: &Step, scan: &Scan, repeat: u32) -> Vec<Reading> {
    let reading = |sensor: &str, position: Position, t_s: f64, sensed: Sensed| {
        let (value_mm, flag) = match sensed {
            Sensed::Distance(mm) => (Some(mm), Flag::None),
            Sensed::NoEcho | Sensed::OutOfRange(_) => (None, Flag::Range),
            Sensed::Saturated => (None, Flag::Saturated),
        };
        let (sensor, temperatures_c) = (sensor.to_owned(), Default::default());
        Reading { step: step.id, repeat, position, value_mm, sensor, t_s, flag, temperatures_c }
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
                    let passing = world.sense_on_the_way(name, point, speed, 1.0 / rate_hz);
                    let of_sensor =
                        passing.into_iter().map(|p| reading(name, p.position, p.t_s, p.sensed));
                    readings.extend(of_sensor);
                }
                // No noise value of this path repeats.
                world.pass(0.0, []);
            }
            Sampling::Continuous { .. } => {
                world.travel(point, speed);
            }
            Sampling::Dwell { dwell_s, samples } => {
                world.travel(point, speed);
                world.dwell(dwell_s);
                for name in &step.sensors {
                    for _ in 0..samples {
                        let sensed = world.sense(name, 1e-3).expect("a sensor");
                        readings.push(reading(name, world.position(), world.time_s(), sensed));
                    }
                }
            }
        }
    }
    readings
}

/// Measures a whole method on `world`; the plan grows with its stages.
pub fn measure(world: &mut World, method: &dyn Method, plan: Plan) -> (Plan, Vec<Reading>) {
    try_measure(world, method, plan, play).expect("well-posed")
}

/// Like [`measure`], with `play` for the touches; `Err`: why the method refuses a stage.
pub fn try_measure(
    world: &mut World,
    method: &dyn Method,
    mut plan: Plan,
    play: fn(&mut World, &Step, u32) -> Reading,
) -> Result<(Plan, Vec<Reading>), Refused> {
    let (mut done, mut readings) = (Vec::<Stage>::new(), Vec::new());
    loop {
        let next = method.next(&plan, &done, Source::Measured(&readings))?;
        let Next::Stage { stage, new_steps } = next else { return Ok((plan, readings)) };
        plan.steps.extend(new_steps);
        for step in plan.steps.iter().filter(|step| stage.steps.contains(&step.id)) {
            if let Some(mount) = step.mount {
                world.mount(mount.turn_deg);
            }
            match &step.scan {
                _ if step.kind == StepKind::Prompt => {}
                None => readings.push(play(world, step, stage.repeat)),
                Some(scan) => readings.extend(look(world, step, scan, stage.repeat)),
            }
        }
        done.push(stage);
    }
}
