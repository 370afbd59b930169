//! Sensors that intersect their line in space with the surface. The tests check the sign of the reading, the
//! frames, and the size of the terms that the linear equation omits.

use estimation::revolutions::{ChannelAtMounting, ChannelRevolutions, HarmonicData};
use std::f64::consts::TAU;

use super::super::fit::SeparationFit;
use super::super::model::{MeasuredSurface, ProbeLayout};
use super::nullities::two_section_layout;
use super::simulated_motions::{SimulatedMotions, sum_of_terms};

const SECTION_RADIUS_MM: f64 = 40.0;
const STAND_OFF_MM: f64 = 0.5;
const FACE_HEIGHT_MM: f64 = 150.0;

/// Distance from the zero point of the sensor along its direction to the surface.
fn sensor_reading_mm(world: &SimulatedMotions, layout: &ProbeLayout, row: ChannelAtMounting, q: f64) -> f64 {
    let channel = &layout.channels[row.channel_index];
    let [x, y, z, a, b] = [&world.x, &world.y, &world.z, &world.a, &world.b].map(|t| sum_of_terms(t, q));
    let turned = layout.turn_sign * q + layout.index_angles_rad[row.mounting_index];
    let (sin, cos) = channel.angle_rad.sin_cos();
    let mut distance = STAND_OFF_MM;
    match channel.surface {
        MeasuredSurface::Section(section) => {
            let height = layout.section_z_mm[section] - layout.reference_z_mm;
            let centre = [x + b * height, y - a * height];
            for _ in 0..20 {
                let reach = SECTION_RADIUS_MM + STAND_OFF_MM - distance;
                let point = [reach * cos - centre[0], reach * sin - centre[1]];
                let on_artefact = point[1].atan2(point[0]) - turned;
                let radius = SECTION_RADIUS_MM + sum_of_terms(&world.section_forms[section], on_artefact);
                distance += point[0].hypot(point[1]) - radius;
            }
        }
        MeasuredSurface::Face { radius_mm } => {
            let point = [radius_mm * cos - x, radius_mm * sin - y];
            let on_artefact = point[1].atan2(point[0]) - turned;
            let surface = z + a * point[1] - b * point[0] + sum_of_terms(&world.face_form, on_artefact);
            distance = FACE_HEIGHT_MM + STAND_OFF_MM - (FACE_HEIGHT_MM + surface);
        }
    }
    distance
}

#[test]
fn readings_in_space_give_the_true_harmonics() {
    for turn in [1.0, -1.0] {
        let layout = two_section_layout(7, turn);
        let world = SimulatedMotions::with_random_terms(3, 6, 2, 0.0);
        let samples = 64;
        let row = |row: &ChannelAtMounting| {
            let angle = |i: usize| i as f64 * TAU / samples as f64;
            let own = (0..samples).map(|i| -sensor_reading_mm(&world, &layout, *row, angle(i))).collect();
            ChannelRevolutions { key: *row, revolutions: vec![own; 2] }
        };
        let measured: Vec<ChannelRevolutions> = layout.all_row_keys().iter().map(row).collect();
        let data = HarmonicData::from_revolutions(&measured, 6).unwrap();
        let fit = SeparationFit::new(&layout, &data).unwrap();
        let mut worst: f64 = 0.0;
        for (k, harmonic) in fit.blocks.iter().enumerate() {
            let [x, y, a, b, z] = [&world.x, &world.y, &world.a, &world.b, &world.z].map(|terms| terms[k]);
            let form =
                |term: super::simulated_motions::HarmonicTerm| [term.cosine_amplitude, -turn * term.sine_amplitude];
            let truth = [
                [x.cosine_amplitude, x.sine_amplitude],
                [y.cosine_amplitude, y.sine_amplitude],
                [a.cosine_amplitude * 100.0, a.sine_amplitude * 100.0],
                [b.cosine_amplitude * 100.0, b.sine_amplitude * 100.0],
                form(world.section_forms[0][k]),
                form(world.section_forms[1][k]),
                [z.cosine_amplitude, z.sine_amplitude],
                form(world.face_form[k]),
            ];
            for (j, truth) in truth.iter().flatten().enumerate() {
                // Tilts are scaled with a lever of 100 mm.
                let scale = if (4..8).contains(&j) { 100.0 } else { 1.0 };
                worst = worst.max((harmonic.solution.x[j] * scale - truth).abs());
            }
        }
        println!("{turn}: {worst:.2e} mm beyond the linear equation");
        // Bound: tangential displacement (2 µm) divided by the radius, times the slope of the form (2 µm·6).
        assert!(worst < 1e-7, "{worst}");
    }
}
