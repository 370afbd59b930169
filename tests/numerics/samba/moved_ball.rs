//! A ball is pushed during the run: the run is held and names the ball.

use super::samba_runs::{RunFailed, SambaRunner, SambaWorld};

/// Enough stages that each ball is measured again after it has moved.
const STAGE_COUNT_WITH_REPEATED_VISITS: usize = 24;

fn stop_reason_for_moved_ball(by: &str) -> String {
    let moves = format!("ball = '4'\nat_s = 330.0\nby_mm = {by}");
    let world = SambaWorld::as_built_in().with_simulated_entry("ball_moves", &moves);
    match SambaRunner::new().run_first_stages(1, &world, STAGE_COUNT_WITH_REPEATED_VISITS) {
        Ok(_) => panic!("{by}: nobody noticed"),
        Err(RunFailed(why)) => why,
    }
}

#[test]
fn a_ball_that_moved_between_visits_is_named() {
    for by in ["[0.6, 0.0, 0.0]", "[0.0, 0.6, 0.0]", "[0.0, 0.0, 0.6]", "[-3.0, 0.0, 0.0]"] {
        let why = stop_reason_for_moved_ball(by);
        println!("{by}: {why}");
        assert!(why.contains("ball 4 at ") || why.contains("/4/"), "{by}: {why}");
    }
}
