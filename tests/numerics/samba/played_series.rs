//! Plays the printed plan on the simulated world, without a control, its connection and a search, so that many
//! seeds take little time.

use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};
use methods::Method;
use rayon::prelude::*;
use simulator::{SimulatedWorld, Speed};
use trued::setup::{self, MachineFile};

use super::samba_runs::{self, MeasuredRun};

/// Additional time of each path, so that a touch takes as long as in a run with its search.
const ADDED_DWELL_PER_TOUCH_S: f64 = 2.2;
/// Retract distance away from all bodies before X, Y or a rotary axis moves.
const RETRACT_MM: f64 = 40.0;

/// One plan for many worlds that differ in their truth only.
pub struct PlayedSeries {
    world: samba_runs::SambaWorld,
    method: Box<dyn Method>,
    plan: Plan,
}

impl PlayedSeries {
    pub fn new(world: samba_runs::SambaWorld) -> Self {
        // The balls are at their planned positions, within the reach of a touch without a search.
        let world = world
            .with_key("simulated.centre_offset_mm", vec![0.0, 0.0])
            .with_key("simulated.ball_offset_mm", 0.05)
            .with_key("method.samba.monte_carlo_trials", 100);
        let (method, plan) =
            setup::configure_method_and_plan_without_steps(&world.machine_file(0), "samba", None).unwrap();
        let (plan, _) = methods::plan_nominal_stages(method.as_ref(), plan).unwrap();
        Self { world, method, plan }
    }

    /// Measurements in the order of the seeds.
    pub fn measure(&self, seeds: std::ops::Range<u64>) -> Vec<MeasuredRun> {
        seeds.into_par_iter().map(|seed| self.measure_one(&self.world.machine_file(seed))).collect()
    }

    fn measure_one(&self, file: &MachineFile) -> MeasuredRun {
        let mut world = setup::build_world(file).unwrap();
        let slow = self.plan.steps.iter().filter(|step| !step.label.starts_with("find/"));
        let readings = slow.map(|step| play_touch_with_path(&mut world, step)).collect();
        let measured = MeasuredRun::identify(file, self.method.as_ref(), self.plan.clone(), readings);
        measured.unwrap_or_else(|failed| panic!("{}", failed.0))
    }
}

fn play_touch_with_path(world: &mut SimulatedWorld, step: &Step) -> Reading {
    let linear = |position: &Position| position.filter_axes(Axis::is_linear);
    let high = |z: f64| Position::new().with(Axis::Z, z + RETRACT_MM);
    world.dwell(ADDED_DWELL_PER_TOUCH_S);
    world.travel(&high(world.displayed_position().get_or_zero(Axis::Z)), Speed::Rapid);
    world.travel(&step.from.filter_axes(|axis| axis != Axis::Z), Speed::Rapid);
    world.travel(&high(step.from.get_or_zero(Axis::Z)), Speed::Rapid);
    world.travel(&linear(&step.from), Speed::Rapid);
    let probed = world.probe(&linear(&step.to), step.feed_mm_min, step.id);
    let contact = probed.contact.unwrap_or_else(|| panic!("no contact: {}", step.label));
    world.travel(&linear(&step.from), Speed::Feed { mm_min: 300.0 });
    Reading {
        step: step.id,
        repeat: 0,
        position: contact.latched_position,
        value_mm: None,
        sensor: step.first_sensor().to_owned(),
        t_s: contact.latch_time_s,
        flag: ReadingFlag::None,
        temperatures_c: Default::default(),
    }
}
