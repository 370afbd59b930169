//! Faults of channels and mounting are named. Correct data give no warning.

use estimation::revolutions::HarmonicData;
use std::f64::consts::TAU;

use super::super::diagnosis::{Diagnosis, LayoutCheck, check_layout, find_clock_errors};
use super::super::model::ProbeLayout;
use super::generator::{ScanSize, SimulatedMotions};
use super::nullities::layout;

const NOISE_MM: f64 = 0.05e-3;

fn data(world: &SimulatedMotions, actual: &ProbeLayout, seed: u64) -> HarmonicData {
    let measured = world.revolutions(actual, &actual.all_row_keys(), ScanSize { samples: 72, revolutions: 3 }, seed);
    HarmonicData::from_revolutions(&measured, 8).unwrap()
}

#[test]
fn regress_swapped_channels_are_named() {
    let planned = layout(6, -1.0);
    for (first, second) in [(0, 1), (1, 2), (0, 3), (2, 4), (5, 6)] {
        let world = SimulatedMotions::random(first as u64, 8, 2, NOISE_MM);
        let mut actual = planned.clone();
        actual.channels.swap(first, second);
        let found = check_layout(&planned, &data(&world, &actual, 5), 1.0).unwrap();
        let name = |i: usize| planned.channels[i].name.clone();
        let expected = Diagnosis::SwappedChannels(name(first), name(second));
        assert_eq!(found, LayoutCheck::Faulty(expected));
    }
    let mut found = 0;
    for seed in 0..50 {
        let world = SimulatedMotions::random(seed, 8, 2, NOISE_MM);
        let sound = check_layout(&planned, &data(&world, &planned, seed), 1.0).unwrap();
        found += usize::from(sound != LayoutCheck::Confirmed);
    }
    assert_eq!(found, 0);
}

#[test]
fn regress_wrong_index_is_found_with_a_lobed_artefact() {
    let planned = layout(6, -1.0);
    for (wrong, affects_later_mountings, by_deg) in
        [(3, false, 60.0), (5, false, -12.3), (2, true, 60.0), (4, true, 1.0)]
    {
        let world = SimulatedMotions::random(wrong as u64, 8, 2, NOISE_MM);
        let mut actual = planned.clone();
        for n in (wrong..6).filter(|n| *n == wrong || affects_later_mountings) {
            actual.index_angles_rad[n] += f64::to_radians(by_deg);
        }
        let check = check_layout(&planned, &data(&world, &actual, 9), 1.0).unwrap();
        let LayoutCheck::Faulty(Diagnosis::WrongIndex { first_index: first, affects_later_mountings: all, offset_deg }) =
            check
        else {
            panic!("{check:?}")
        };
        println!("index {wrong}: {first} {all} {offset_deg:.2}°");
        assert_eq!((first, all), (wrong, affects_later_mountings));
        assert!((offset_deg - by_deg).abs() < 0.11, "{offset_deg}");
    }
}

#[test]
fn regress_right_indexes_are_confirmed_unless_the_artefact_is_round() {
    let planned = layout(6, -1.0);
    let mut world = SimulatedMotions::random(1, 8, 2, NOISE_MM);
    let check = check_layout(&planned, &data(&world, &planned, 2), 1.0).unwrap();
    assert_eq!(check, LayoutCheck::Confirmed);
    world.sections.iter_mut().flatten().chain(&mut world.face).for_each(|t| {
        (t.a, t.b) = (0.0, 0.0);
    });
    let check = check_layout(&planned, &data(&world, &planned, 2), 1.0).unwrap();
    assert_eq!(check, LayoutCheck::NotVerifiable);
}

#[test]
fn regress_a_clock_that_is_one_percent_fast() {
    let layout = layout(3, -1.0);
    let world = SimulatedMotions::random(4, 8, 2, NOISE_MM);
    let rows = layout.all_row_keys();
    let mut measured = world.revolutions(&layout, &rows, ScanSize { samples: 72, revolutions: 4 }, 3);
    assert!(find_clock_errors(&layout, &measured).is_empty());
    for row in measured.iter_mut().filter(|row| row.key.channel == 4) {
        for (i, value) in row.revolutions.iter_mut().flatten().enumerate() {
            let stamped = i as f64 * TAU / 72.0;
            *value += world.deviation(&layout, row.key, stamped / 1.01) - world.deviation(&layout, row.key, stamped);
        }
    }
    let found = find_clock_errors(&layout, &measured);
    let [Diagnosis::ClockError { channel, relative_error: relative }] = found.as_slice() else { panic!("{found:?}") };
    println!("{}", found[0]);
    assert_eq!(channel, &layout.channels[4].name);
    assert!((relative - 0.01).abs() < 5e-4, "{relative}");
}
