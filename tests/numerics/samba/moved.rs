//! A ball is pushed during the run: the run is held and names the ball.

use super::bench::{Bench, Failed, World};

/// Enough stages that each ball is measured again after it has moved.
const STAGES: usize = 24;

fn stopped(by: &str) -> String {
    let moves = format!("ball = '4'\nat_s = 330.0\nby_mm = {by}");
    let world = World::as_built_in().and("ball_moves", &moves);
    match Bench::new().begin(1, &world, STAGES) {
        Ok(_) => panic!("{by}: nobody noticed"),
        Err(Failed(why)) => why,
    }
}

#[test]
fn a_ball_that_moved_between_visits_is_named() {
    for by in ["[0.6, 0.0, 0.0]", "[0.0, 0.6, 0.0]", "[0.0, 0.0, 0.6]", "[-3.0, 0.0, 0.0]"] {
        let why = stopped(by);
        println!("{by}: {why}");
        assert!(why.contains("ball 4 at ") || why.contains("/4/"), "{by}: {why}");
    }
}
