//! Moves: duration, braking, display resolution, lost motion and contact during a move.

use std::f64::consts::PI;

use super::*;

fn rapid(world: &mut SimulatedWorld, to: &Position) -> MoveResult {
    world.travel(to, Speed::Rapid)
}

#[test]
fn move_duration_is_that_of_the_slowest_axis() {
    let mut world = TestBench::ideal().build_world();
    let up = world.displayed_position().get_or_zero(Axis::Z);
    // 100 mm at 100 mm/s and 1000 mm/s²: 1 s and one ramp of 0.1 s.
    let long = rapid(&mut world, &Position::new().with(Axis::X, 100.0));
    assert!((long.duration_s - 1.1).abs() < 1e-12);
    // A move of 1 mm never reaches full speed.
    let short = rapid(&mut world, &Position::new().with(Axis::X, 101.0));
    assert!((short.duration_s - 2.0 * (1e-3_f64).sqrt()).abs() < 1e-12);
    // 90° at 30°/s and 300°/s² takes longer than the simultaneous 10 mm of Y.
    let both = Position::new().with(Axis::C, PI / 2.0).with(Axis::Y, 10.0);
    assert!((rapid(&mut world, &both).duration_s - 3.1).abs() < 1e-12);
    // 600 mm/min along a path of 50 mm.
    let slope = Position::new().with(Axis::X, 131.0).with(Axis::Y, 50.0);
    let feed = world.travel(&slope, Speed::Feed { mm_min: 600.0 });
    assert!((feed.duration_s - 5.0 - 10.0 / 1250.0).abs() < 1e-12);
    world.dwell(2.5);
    let sum = 1.1 + short.duration_s + 3.1 + feed.duration_s + 2.5;
    assert!((world.time_s() - sum).abs() < 1e-9);
    assert_eq!(world.displayed_position().get_or_zero(Axis::Z), up);
}

#[test]
fn the_machine_brakes_after_contact() {
    let mut world = TestBench::ideal().build_world();
    for to in [position_with_ball_at(60.0, 0.0, 200.0), position_with_ball_at(60.0, 0.0, 50.0)] {
        assert!(!rapid(&mut world, &to).has_probe_closed);
    }
    let before = world.time_s();
    let probed = world.probe(&position_with_ball_at(0.0, 0.0, 50.0), 300.0, 7);
    let contact = probed.contact.unwrap();
    assert!((contact.latched_position.get_or_zero(Axis::X) - BALL_CENTRE_CIRCLE_RADIUS_MM).abs() < 1e-9);
    // 12 mm at 5 mm/s, and half of the 5 ms ramp before; then braking over v²/2a.
    assert!((contact.latch_time_s - before - 2.4 - 0.0025).abs() < 1e-9);
    assert!((world.displayed_position().get_or_zero(Axis::X) - (BALL_CENTRE_CIRCLE_RADIUS_MM - 0.0125)).abs() < 1e-9);
    assert!((probed.duration_s - 2.4075).abs() < 1e-9);
    assert!(world.is_probe_closed() && !probed.has_crashed);
    // Leaving contact does not count as a new contact.
    assert!(!rapid(&mut world, &position_with_ball_at(49.0, 0.0, 50.0)).has_probe_closed);
    assert!(!world.is_probe_closed());
    assert_eq!(world.probe(&position_with_ball_at(48.5, 0.0, 50.0), 30.0, 8).contact, None);
    assert_eq!(world.displayed_position().get_or_zero(Axis::X), 48.5);
}

/// A touch at 300 mm/min that begins `gap` mm before contact. Returns how far beyond contact it is latched (mm),
/// when (s), and how far beyond contact the axis comes to rest (mm).
fn latch_overshoot_time_and_rest_overshoot(latch: LatchDelay, gap: f64, n: u32) -> (f64, f64, f64) {
    let mut bench = TestBench::ideal();
    bench.truth.latch = latch;
    let mut world = bench.build_world();
    for to in [
        position_with_ball_at(BALL_CENTRE_CIRCLE_RADIUS_MM + gap, 0.0, 200.0),
        position_with_ball_at(BALL_CENTRE_CIRCLE_RADIUS_MM + gap, 0.0, 50.0),
    ] {
        rapid(&mut world, &to);
    }
    let before = world.time_s();
    let contact =
        world.probe(&position_with_ball_at(BALL_CENTRE_CIRCLE_RADIUS_MM - 1.0, 0.0, 50.0), 300.0, n).contact.unwrap();
    let rest = world.displayed_position().get_or_zero(Axis::X);
    (
        BALL_CENTRE_CIRCLE_RADIUS_MM - contact.latched_position.get_or_zero(Axis::X),
        contact.latch_time_s - before,
        BALL_CENTRE_CIRCLE_RADIUS_MM - rest,
    )
}

#[test]
fn latch_delay_moves_the_latched_position_and_the_start_of_braking() {
    let delay = LatchDelay { delay_ms: 4.0, scan_ms: 0.0 };
    let (beyond, time, rest) = latch_overshoot_time_and_rest_overshoot(delay, 12.0, 1);
    assert!((beyond - 0.02).abs() < 1e-9, "{beyond}");
    assert!((time - 2.4 - 0.0025 - 0.004).abs() < 1e-9);
    assert!((rest - 0.02 - 0.0125).abs() < 1e-9);
    // Contact 0.5 µm after the start comes after 1 ms, while the axis still accelerates.
    let (beyond, time, _) =
        latch_overshoot_time_and_rest_overshoot(LatchDelay { delay_ms: 2.0, scan_ms: 0.0 }, 0.0005, 1);
    assert!((time - 0.003).abs() < 1e-9 && (beyond - (0.0045 - 0.0005)).abs() < 1e-9);
    // A latch after the end of the move keeps the end position.
    let (beyond, _, rest) =
        latch_overshoot_time_and_rest_overshoot(LatchDelay { delay_ms: 900.0, scan_ms: 0.0 }, 12.0, 1);
    assert!((beyond - 1.0).abs() < 1e-9 && (rest - 1.0).abs() < 1e-9);
}

#[test]
fn plc_scan_adds_a_latch_delay_uniform_over_its_period() {
    let scan = LatchDelay { delay_ms: 1.0, scan_ms: 10.0 };
    let waited: Vec<f64> =
        (0..400).map(|n| latch_overshoot_time_and_rest_overshoot(scan, 12.0, n).0 / 5.0 * 1e3).collect();
    let mean = waited.iter().sum::<f64>() / 400.0;
    let square = waited.iter().map(|ms| (ms - mean).powi(2)).sum::<f64>() / 399.0;
    assert!(waited.iter().all(|ms| (1.0..=11.0).contains(ms)));
    // Rectangular distribution: standard deviation 10/√12 ms. With 400 values its mean is known to 0.14 ms and its
    // variance to 4.5 %.
    assert!((mean - 6.0).abs() < 0.45, "{mean}");
    assert!((square / (100.0 / 12.0) - 1.0).abs() < 0.15, "{square}");
    assert_eq!(
        latch_overshoot_time_and_rest_overshoot(scan, 12.0, 7),
        latch_overshoot_time_and_rest_overshoot(scan, 12.0, 7)
    );
}

#[test]
fn a_touch_at_excessive_feed_crashes() {
    let mut bench = TestBench::ideal();
    bench.stated_axis_mut(Axis::X).acceleration_per_s2 = 50.0;
    bench.probe.overtravel_mm = 1.0;
    let mut world = bench.build_world();
    for to in [position_with_ball_at(80.0, 0.0, 200.0), position_with_ball_at(80.0, 0.0, 50.0)] {
        rapid(&mut world, &to);
    }
    // At 20 mm/s the braking distance is 4 mm.
    assert!(world.probe(&position_with_ball_at(0.0, 0.0, 50.0), 1200.0, 1).has_crashed);
}

#[test]
fn contact_on_the_way_of_an_index_move_is_reported() {
    let mut bench = TestBench::ideal();
    bench.truth.centre_offset_mm = [-2.0, 0.0];
    let mut world = bench.build_world();
    for to in [
        position_with_ball_at(BALL_CENTRE_CIRCLE_RADIUS_MM - 1.0, 0.0, 200.0),
        position_with_ball_at(BALL_CENTRE_CIRCLE_RADIUS_MM - 1.0, 0.0, 50.0),
    ] {
        assert!(!rapid(&mut world, &to).has_probe_closed);
    }
    // Half a turn moves the part 3 mm into the ball; a full turn moves it out again.
    let turned = rapid(&mut world, &Position::new().with(Axis::C, PI));
    assert!(turned.has_probe_closed && !turned.has_crashed && world.is_probe_closed());
    assert!(!rapid(&mut world, &Position::new().with(Axis::C, 2.0 * PI)).has_probe_closed);
    let round = rapid(&mut world, &Position::new().with(Axis::C, 0.0));
    assert!(round.has_probe_closed && !world.is_probe_closed());
    // Straight through the part: deflected beyond the overtravel of the stylus.
    let through = rapid(&mut world, &position_with_ball_at(-60.0, 0.0, 50.0));
    assert!(through.has_probe_closed && through.has_crashed && !world.is_probe_closed());
    // Above the part: no contact.
    for to in [position_with_ball_at(-60.0, 0.0, 104.0), position_with_ball_at(60.0, 0.0, 104.0)] {
        assert!(!rapid(&mut world, &to).has_probe_closed);
    }
}

#[test]
fn display_is_rounded_to_resolution_but_contact_is_not() {
    let mut bench = TestBench::ideal();
    bench.truth.errors.insert("EX0C_um".to_owned(), 12.34567);
    let exact = touch_radius_and_latch_time(&mut bench.build_world(), 0.0, 0.0, 1).0;
    assert!((exact - BALL_CENTRE_CIRCLE_RADIUS_MM - 0.01234567).abs() < 1e-9);
    for axis in Axis::LINEAR {
        bench.stated_axis_mut(axis).resolution_um = 1.0;
    }
    let mut world = bench.build_world();
    assert!((touch_radius_and_latch_time(&mut world, 0.0, 0.0, 1).0 - 48.012).abs() < 1e-12);
    world.travel(&position_with_ball_at(60.00049, 0.0, 50.0), Speed::Rapid);
    assert!((world.displayed_position().get_or_zero(Axis::X) - 60.0).abs() < 1e-12);
    // The rounded position would be in contact; the ball itself is not.
    world.travel(&position_with_ball_at(48.01239, 0.0, 50.0), Speed::Rapid);
    assert!(!world.is_probe_closed() && (world.displayed_position().get_or_zero(Axis::X) - 48.012).abs() < 1e-12);
}

#[test]
fn backlash_displaces_the_contact_by_half_the_gap() {
    let mut bench = TestBench::ideal();
    bench.truth.backlash_um.insert(Axis::X, 20.0);
    let mut world = bench.build_world();
    // While X decreases, it is half the gap above its command: the command must go that much
    // farther.
    assert!(
        (touch_radius_and_latch_time(&mut world, 0.0, 0.0, 1).0 - (BALL_CENTRE_CIRCLE_RADIUS_MM - 0.010)).abs() < 1e-9
    );
    // From the other side the same is true along the outward direction.
    assert!(
        (touch_radius_and_latch_time(&mut world, PI, 0.0, 2).0 - (BALL_CENTRE_CIRCLE_RADIUS_MM - 0.010)).abs() < 1e-9
    );
    // Y has no lost motion; X, lagging across, shortens the chord by 0.01²/96 mm.
    assert!((touch_radius_and_latch_time(&mut world, PI / 2.0, 0.0, 3).0 - BALL_CENTRE_CIRCLE_RADIUS_MM).abs() < 2e-6);
}

#[test]
fn a_retract_within_the_backlash_does_not_free_the_stylus() {
    let mut bench = TestBench::ideal();
    bench.truth.backlash_um.insert(Axis::X, 20.0);
    let mut world = bench.build_world();
    for to in [position_with_ball_at(60.0, 0.0, 200.0), position_with_ball_at(60.0, 0.0, 50.0)] {
        rapid(&mut world, &to);
    }
    world.probe(&position_with_ball_at(40.0, 0.0, 50.0), 30.0, 1);
    let rest = world.displayed_position().get_or_zero(Axis::X);
    assert!(rapid(&mut world, &Position::new().with(Axis::X, rest + 0.019)).has_probe_closed);
    assert!(world.is_probe_closed());
    assert!(!rapid(&mut world, &Position::new().with(Axis::X, rest + 0.021)).has_probe_closed);
    assert!(!world.is_probe_closed());
}
