//! Refusals, and the alternatives that they name.

use super::super::layout_checks::{
    check_harmonic_orders, check_no_coinciding_sensors, check_surfaces, describe_weak_points,
};
use super::super::layout_prediction::{
    LAYOUT_RANKING_HARMONICS, SeparationMethod, noise_gain_by_order, rms_noise_gain, third_sensor_angles_and_gains,
};
use super::super::model::{MeasuredSurface, MotionOrForm, ProbeLayout};
use super::nullities::two_section_layout;
use estimation::revolutions::{AngleRange, ChannelAtMounting, ChannelRevolutions, HarmonicData};

#[test]
fn coinciding_and_opposed_sensors_are_refused() {
    for (angles, instead) in [
        ([0.0, 90.0, 270.0], "move 270°: 50° has"),
        ([0.0, 90.0, 91.0], "move 91°: 50° has"),
        ([0.0, 180.0, 90.0], "move 180°: "),
    ] {
        let layout = ProbeLayout::with_radial_sensors(&angles, 10);
        let refused = check_no_coinciding_sensors(&layout, &[]).unwrap_err();
        println!("{} | {}", refused.reason, refused.remedy);
        assert!(refused.remedy.starts_with(instead), "{}", refused.remedy);
        assert!(refused.reason.contains("coincide or are opposed"));
    }
    assert!(check_no_coinciding_sensors(&two_section_layout(10, -1.0), &[]).is_ok());
}

#[test]
fn index_step_that_suppresses_a_harmonic_is_refused() {
    let ten = two_section_layout(10, -1.0);
    let radial = [MotionOrForm::X, MotionOrForm::Y, MotionOrForm::A, MotionOrForm::B];
    assert!(check_harmonic_orders(&ten, &radial, 1..=20).is_ok());
    let refused = check_harmonic_orders(&ten, &[MotionOrForm::Z], 1..=20).unwrap_err();
    println!("{} | {}", refused.reason, refused.remedy);
    assert!(refused.reason.contains("do not determine 2 harmonics") && refused.reason.contains("EZC harmonic 10"));
    assert!(refused.remedy.starts_with("index the artefact in 21 steps"));
    let better = two_section_layout(21, -1.0);
    assert!(check_harmonic_orders(&better, &[MotionOrForm::Z], 1..=20).is_ok());
    // Two sensors and ten steps do not determine the orders 10 and 20 of X. Multiprobe alone determines all but the
    // co-rotating first harmonic.
    let pair = ProbeLayout::with_radial_sensors(&[0.0, 90.0], 10);
    let refused = check_harmonic_orders(&pair, &[MotionOrForm::X], 2..=20).unwrap_err();
    assert!(refused.reason.contains("2 sensors with 10 indexes do not determine 2 harmonics"));
    let probes = ProbeLayout::with_radial_sensors(&[0.0, 90.0, 230.0], 1);
    assert!(check_harmonic_orders(&probes, &[MotionOrForm::X, MotionOrForm::Y], 1..=20).is_ok());
}

#[test]
fn third_sensor_angles_are_sorted_by_gain_where_unobstructed() {
    let free = third_sensor_angles_and_gains([0.0, 90.0], &[]);
    println!("{:?}", &free[..6]);
    assert!(free.windows(2).all(|pair| pair[0].1 <= pair[1].1));
    assert!(free.iter().all(|(deg, _)| ![0.0, 90.0, 180.0, 270.0, 240.0].contains(deg)));
    let obstructed_ranges =
        [AngleRange { from_deg: 350.0, to_deg: 200.0 }, AngleRange { from_deg: 265.0, to_deg: 345.0 }];
    let limited = third_sensor_angles_and_gains([0.0, 90.0], &obstructed_ranges);
    let angles: Vec<f64> = limited.iter().map(|(deg, _)| *deg).collect();
    assert_eq!(angles, [220.0, 230.0, 250.0, 260.0]);
    let combined = ProbeLayout::with_radial_sensors(&[0.0, 90.0, 230.0], 10);
    let gain = rms_noise_gain(&combined, SeparationMethod::Combined).unwrap();
    let multistep = noise_gain_by_order(&combined, SeparationMethod::Multistep, LAYOUT_RANKING_HARMONICS).unwrap();
    let lost = multistep.iter().filter(|(_, gain)| gain.is_infinite());
    assert_eq!(lost.map(|(order, _)| *order).collect::<Vec<_>>(), [10, 20]);
    println!("combined {gain}");
    assert!(gain < 0.4);
}

/// The expected values are those of METHODS section 3.
#[test]
fn prompt_contains_noise_gain_and_better_angle() {
    let probes = ProbeLayout::with_radial_sensors(&[0.0, 90.0, 230.0], 10);
    let text = |to_deg: f64| describe_weak_points(&probes, 20, &[AngleRange { from_deg: 350.0, to_deg }]).unwrap();
    let better = text(200.0);
    assert!(better.contains("in one mounting: 1.53; 1.48 with 230° at 220°"), "{better}");
    assert!(text(340.0).ends_with("in one mounting: 1.53."), "{}", text(340.0));
}

#[test]
fn too_few_revolutions_or_samples_are_refused() {
    let row = |channel, revolutions| ChannelRevolutions {
        key: ChannelAtMounting { mounting_index: 0, channel_index: channel },
        revolutions,
    };
    let samples = vec![0.0; 32];
    let one = HarmonicData::from_revolutions(&[row(0, vec![samples.clone()])], 8).unwrap_err();
    assert!(one.remedy().contains("at least two revolutions"), "{one}");
    let two = vec![samples.clone(), samples.clone()];
    let short = HarmonicData::from_revolutions(&[row(0, two.clone())], 16).unwrap_err();
    assert!(short.remedy().contains("more than 32 angles"), "{short}");
    let three = vec![samples.clone(); 3];
    let uneven = HarmonicData::from_revolutions(&[row(0, two), row(1, three)], 8).unwrap_err();
    assert!(uneven.to_string().contains("a different number"), "{uneven}");
    assert!(HarmonicData::from_revolutions(&[], 8).is_err());
}

#[test]
fn surfaces_outside_the_model_are_refused() {
    let whole = two_section_layout(3, -1.0);
    assert!(check_surfaces(&whole).is_ok());
    let why = |layout: &ProbeLayout| check_surfaces(layout).unwrap_err().reason;
    let mut one_section = whole.clone();
    one_section.section_z_mm.pop();
    assert!(why(&one_section).contains("without a declared height"));
    one_section.channels.drain(3..6);
    assert!(check_surfaces(&one_section).unwrap_err().remedy.contains("second section"));
    let mut radii = whole.clone();
    let axial = super::super::model::SensorChannel {
        surface: MeasuredSurface::Face { radius_mm: 30.0 },
        ..radii.channels[6].clone()
    };
    radii.channels.push(axial);
    assert!(why(&radii).contains("different radii"));
}
