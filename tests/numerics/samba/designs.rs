//! Every named design in a real run on the built-in machine. The true ball positions of the machine differ from the
//! file, and its true axes from the nominal machine.

use super::samba_runs::{RunFailed, SambaRunner, SambaWorld};

/// Number of stages: all searches of each design, and a few of its visits.
const FIRST_STAGE_COUNT: usize = 10;

fn paper_world() -> SambaWorld {
    SambaWorld::as_built_in().with_key("method.samba.design", "paper")
}

fn assert_first_stages_run(name: &str, world: &SambaWorld, seed: u64) {
    match SambaRunner::new().run_first_stages(seed, world, FIRST_STAGE_COUNT) {
        Ok(readings) => assert!(readings.len() > 100, "{name}, seed {seed}: {}", readings.len()),
        Err(RunFailed(why)) => panic!("{name}, seed {seed}: {why}"),
    }
}

#[test]
fn the_papers_design_is_measured_to_its_end() {
    let world = paper_world().with_key("method.samba.monte_carlo_trials", 100);
    let measured = SambaRunner::new().measure(1, &world);
    assert_eq!(measured.readings.len(), measured.plan.steps.len());
}

#[test]
fn the_papers_design_starts_with_two_seeds() {
    for seed in [3, 4] {
        assert_first_stages_run("paper", &paper_world(), seed);
    }
}

#[test]
fn every_other_named_design_starts() {
    let built_in = SambaWorld::as_built_in;
    assert_first_stages_run("D", &built_in(), 3);
    assert_first_stages_run("A", &built_in().with_key("method.samba.criterion", "A"), 3);
    assert_first_stages_run("paper, found once", &paper_world().with_key("method.samba.find", "once"), 3);
}
