//! Faults of channels and mounting are named. Correct data give no warning.

use estimation::revolutions::HarmonicData;
use std::f64::consts::TAU;

use super::super::fault_diagnosis::{LayoutCheck, LayoutFault, check_layout, find_clock_errors};
use super::super::model::ProbeLayout;
use super::nullities::two_section_layout;
use super::simulated_motions::{ScanSize, SimulatedMotions};

const NOISE_STD_MM: f64 = 0.05e-3;

fn simulated_harmonic_data(world: &SimulatedMotions, actual: &ProbeLayout, seed: u64) -> HarmonicData {
    let measured = world.simulate_revolutions(
        actual,
        &actual.all_row_keys(),
        ScanSize { samples_per_revolution: 72, revolutions: 3 },
        seed,
    );
    HarmonicData::from_revolutions(&measured, 8).unwrap()
}

#[test]
fn swapped_channels_are_named() {
    let planned = two_section_layout(6, -1.0);
    for (first, second) in [(0, 1), (1, 2), (0, 3), (2, 4), (5, 6)] {
        let world = SimulatedMotions::with_random_terms(first as u64, 8, 2, NOISE_STD_MM);
        let mut actual = planned.clone();
        actual.channels.swap(first, second);
        let found = check_layout(&planned, &simulated_harmonic_data(&world, &actual, 5), 1.0).unwrap();
        let name = |i: usize| planned.channels[i].name.clone();
        let expected = LayoutFault::SwappedChannels(name(first), name(second));
        assert_eq!(found, LayoutCheck::Faulty(expected));
    }
    let mut found = 0;
    for seed in 0..50 {
        let world = SimulatedMotions::with_random_terms(seed, 8, 2, NOISE_STD_MM);
        let sound = check_layout(&planned, &simulated_harmonic_data(&world, &planned, seed), 1.0).unwrap();
        found += usize::from(sound != LayoutCheck::Confirmed);
    }
    assert_eq!(found, 0);
}

#[test]
fn wrong_index_is_found_with_a_lobed_artefact() {
    let planned = two_section_layout(6, -1.0);
    for (wrong, affects_later_mountings, by_deg) in
        [(3, false, 60.0), (5, false, -12.3), (2, true, 60.0), (4, true, 1.0)]
    {
        let world = SimulatedMotions::with_random_terms(wrong as u64, 8, 2, NOISE_STD_MM);
        let mut actual = planned.clone();
        for n in (wrong..6).filter(|n| *n == wrong || affects_later_mountings) {
            actual.index_angles_rad[n] += f64::to_radians(by_deg);
        }
        let check = check_layout(&planned, &simulated_harmonic_data(&world, &actual, 9), 1.0).unwrap();
        let LayoutCheck::Faulty(LayoutFault::WrongIndexAngle {
            first_index: first,
            affects_later_mountings: all,
            offset_deg,
        }) = check
        else {
            panic!("{check:?}")
        };
        println!("index {wrong}: {first} {all} {offset_deg:.2}°");
        assert_eq!((first, all), (wrong, affects_later_mountings));
        assert!((offset_deg - by_deg).abs() < 0.11, "{offset_deg}");
    }
}

#[test]
fn right_indexes_are_confirmed_unless_the_artefact_is_round() {
    let planned = two_section_layout(6, -1.0);
    let mut world = SimulatedMotions::with_random_terms(1, 8, 2, NOISE_STD_MM);
    let check = check_layout(&planned, &simulated_harmonic_data(&world, &planned, 2), 1.0).unwrap();
    assert_eq!(check, LayoutCheck::Confirmed);
    world.section_forms.iter_mut().flatten().chain(&mut world.face_form).for_each(|t| {
        (t.cosine_amplitude, t.sine_amplitude) = (0.0, 0.0);
    });
    let check = check_layout(&planned, &simulated_harmonic_data(&world, &planned, 2), 1.0).unwrap();
    assert_eq!(check, LayoutCheck::NotVerifiable);
}

#[test]
fn channel_clock_one_percent_fast_is_found() {
    let layout = two_section_layout(3, -1.0);
    let world = SimulatedMotions::with_random_terms(4, 8, 2, NOISE_STD_MM);
    let rows = layout.all_row_keys();
    let mut measured =
        world.simulate_revolutions(&layout, &rows, ScanSize { samples_per_revolution: 72, revolutions: 4 }, 3);
    assert!(find_clock_errors(&layout, &measured).is_empty());
    for row in measured.iter_mut().filter(|row| row.key.channel_index == 4) {
        for (i, value) in row.revolutions.iter_mut().flatten().enumerate() {
            let stamped = i as f64 * TAU / 72.0;
            *value += world.surface_deviation_mm(&layout, row.key, stamped / 1.01)
                - world.surface_deviation_mm(&layout, row.key, stamped);
        }
    }
    let found = find_clock_errors(&layout, &measured);
    let [LayoutFault::ClockError { channel, relative_error: relative }] = found.as_slice() else { panic!("{found:?}") };
    println!("{}", found[0]);
    assert_eq!(channel, &layout.channels[4].name);
    assert!((relative - 0.01).abs() < 5e-4, "{relative}");
}
