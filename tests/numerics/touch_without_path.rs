//! Plays a touch without the path to it, which saves the computation of the paths between touches.

use machine::record::plan::Step;
use machine::record::reading::Reading;
use simulator::{SimulatedWorld, Speed};

use crate::support::plan_player::play_touch;

pub fn touch_without_path(world: &mut SimulatedWorld, step: &Step, repeat: u32) -> Reading {
    world.set_probe_removed(true);
    world.travel(&step.from, Speed::Rapid);
    world.set_probe_removed(false);
    play_touch(world, step, repeat)
}
