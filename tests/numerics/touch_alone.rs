//! A touch without the path to it: the world computes next to nothing for the paths between touches.

use machine::record::plan::Step;
use machine::record::reading::Reading;
use simulator::{Speed, World};

use crate::support::plan_player::touch;

pub fn touch_alone(world: &mut World, step: &Step, repeat: u32) -> Reading {
    world.without_probe(true);
    world.travel(&step.from, Speed::Rapid);
    world.without_probe(false);
    touch(world, step, repeat)
}
