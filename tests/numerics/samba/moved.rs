//! A ball is pushed during the run: the run is held and names the ball.

use super::bench::{RunBench, RunFailed, SambaWorld};

/// Enough stages that each ball is measured again after it has moved.
const STAGES_BEFORE_MOVE: usize = 24;

fn stop_reason(by: &str) -> String {
    let moves = format!("ball = '4'\nat_s = 330.0\nby_mm = {by}");
    let world = SambaWorld::as_built_in().with_entry("ball_moves", &moves);
    match RunBench::new().run_first_stages(1, &world, STAGES_BEFORE_MOVE) {
        Ok(_) => panic!("{by}: nobody noticed"),
        Err(RunFailed(why)) => why,
    }
}

#[test]
fn a_ball_that_moved_between_visits_is_named() {
    for by in ["[0.6, 0.0, 0.0]", "[0.0, 0.6, 0.0]", "[0.0, 0.0, 0.6]", "[-3.0, 0.0, 0.0]"] {
        let why = stop_reason(by);
        println!("{by}: {why}");
        assert!(why.contains("ball 4 at ") || why.contains("/4/"), "{by}: {why}");
    }
}
