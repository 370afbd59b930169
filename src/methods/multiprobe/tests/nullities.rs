//! Nullities of the architecture page: two sections with sensors at 0°, 90°, 230°, one axial sensor.

use super::super::model::{MeasuredSurface, ProbeLayout, SensorChannel};
use estimation::linear_least_squares::{RANK_THRESHOLD, analyse_rank};
use estimation::revolutions::ChannelAtMounting;

pub fn two_section_layout(indexes: usize, turn: f64) -> ProbeLayout {
    let channel =
        |name: &str, surface, deg: f64| SensorChannel { name: name.to_owned(), surface, angle_rad: deg.to_radians() };
    let section = |i| [0.0, 90.0, 230.0].map(|deg| channel(&format!("r{i}-{deg}"), MeasuredSurface::Section(i), deg));
    let mut channels: Vec<SensorChannel> = section(0).into_iter().chain(section(1)).collect();
    channels.push(channel("axial", MeasuredSurface::Face { radius_mm: 20.0 }, 45.0));
    let step = 360.0 / indexes as f64;
    ProbeLayout {
        channels,
        section_z_mm: vec![20.0, 120.0],
        reference_z_mm: 0.0,
        index_angles_rad: (0..indexes).map(|n| (n as f64 * step).to_radians()).collect(),
        measured_axis: machine::Axis::C,
        turn_sign: turn,
    }
}

fn nullity(layout: &ProbeLayout, rows: &[ChannelAtMounting], order: usize) -> usize {
    analyse_rank(layout.design_matrix(rows, order).as_ref(), None, RANK_THRESHOLD).unwrap().nullity
}

#[test]
fn gate_g3_nullities_of_each_harmonic_are_as_expected() {
    for turn in [1.0, -1.0] {
        let layout = two_section_layout(10, turn);
        let all = layout.all_row_keys();
        let multiprobe: Vec<ChannelAtMounting> = all.iter().copied().filter(|row| row.mounting_index == 0).collect();
        let is_of_pair = |row: &ChannelAtMounting| ![2, 5].contains(&row.channel_index);
        let multistep: Vec<ChannelAtMounting> = all.iter().copied().filter(is_of_pair).collect();
        for order in 1..=40 {
            let expected = if [1, 35, 37].contains(&order) { 6 } else { 2 };
            assert_eq!(nullity(&layout, &multiprobe, order), expected, "multiprobe {order}");
            let expected = if order % 10 == 0 { 6 } else { 0 };
            assert_eq!(nullity(&layout, &multistep, order), expected, "multistep {order}");
            let expected = if order % 10 == 0 { 2 } else { 0 };
            assert_eq!(nullity(&layout, &all, order), expected, "combined {order}");
        }
    }
}
