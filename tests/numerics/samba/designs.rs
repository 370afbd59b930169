//! Every named design in a real run on the built-in machine: its true ball positions differ from the file, and its
//! true axes from the nominal machine.

use super::bench::{RunBench, RunFailed, SambaWorld};

/// Number of stages: all searches of each design, and a few of its visits.
const STAGES_OF_BEGINNING: usize = 10;

fn paper_world() -> SambaWorld {
    SambaWorld::as_built_in().with_key("method.samba.design", "paper")
}

fn check_begins(name: &str, world: &SambaWorld, seed: u64) {
    match RunBench::new().run_first_stages(seed, world, STAGES_OF_BEGINNING) {
        Ok(readings) => assert!(readings.len() > 100, "{name}, seed {seed}: {}", readings.len()),
        Err(RunFailed(why)) => panic!("{name}, seed {seed}: {why}"),
    }
}

#[test]
fn regress_the_papers_design_is_measured_to_its_end() {
    let world = paper_world().with_key("method.samba.monte_carlo_trials", 100);
    let measured = RunBench::new().measure(1, &world);
    assert_eq!(measured.readings.len(), measured.plan.steps.len());
}

#[test]
fn regress_the_papers_design_starts_at_any_ball_position() {
    for seed in [3, 4] {
        check_begins("paper", &paper_world(), seed);
    }
}

#[test]
fn every_other_named_design_starts() {
    let built_in = SambaWorld::as_built_in;
    check_begins("D", &built_in(), 3);
    check_begins("A", &built_in().with_key("method.samba.criterion", "A"), 3);
    check_begins("paper, found once", &paper_world().with_key("method.samba.find", "once"), 3);
}
