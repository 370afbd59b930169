//! Every named design in a real run on the built-in machine: its true ball positions differ from the file, and its
//! true axes from the nominal machine.

use super::bench::{Bench, Failed, World};

/// Number of stages: all searches of each design, and a few of its visits.
const BEGINNING: usize = 10;

fn paper() -> World {
    World::as_built_in().with("method.samba.design", "paper")
}

fn begins(name: &str, world: &World, seed: u64) {
    match Bench::new().begin(seed, world, BEGINNING) {
        Ok(readings) => assert!(readings.len() > 100, "{name}, seed {seed}: {}", readings.len()),
        Err(Failed(why)) => panic!("{name}, seed {seed}: {why}"),
    }
}

#[test]
fn regress_the_papers_design_is_measured_to_its_end() {
    let world = paper().with("method.samba.monte_carlo_trials", 100);
    let measured = Bench::new().measure(1, &world);
    assert_eq!(measured.readings.len(), measured.plan.steps.len());
}

#[test]
fn regress_the_papers_design_begins_wherever_the_balls_stand() {
    for seed in [3, 4] {
        begins("paper", &paper(), seed);
    }
}

#[test]
fn every_other_named_design_begins() {
    let built_in = World::as_built_in;
    begins("D", &built_in(), 3);
    begins("A", &built_in().with("method.samba.criterion", "A"), 3);
    begins("paper, found once", &paper().with("method.samba.find", "once"), 3);
}
