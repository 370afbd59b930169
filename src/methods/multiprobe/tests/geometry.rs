//! Sensors that intersect their line in space with the surface. The tests check the sign of the reading, the
//! frames, and the size of the terms that the linear equation omits.

use estimation::revolutions::{ChannelAtIndex, ChannelRevolutions, HarmonicData};
use std::f64::consts::TAU;

use super::super::fit::SeparationFit;
use super::super::model::{ProbeLayout, Surface};
use super::generator::{SimulatedMotions, sum_of_terms};
use super::nullities::layout;

const SECTION_RADIUS_MM: f64 = 40.0;
const STAND_OFF_MM: f64 = 0.5;
const FACE_HEIGHT_MM: f64 = 150.0;

/// Distance from the zero point of the sensor along its direction to the surface.
fn reading(world: &SimulatedMotions, layout: &ProbeLayout, row: ChannelAtIndex, q: f64) -> f64 {
    let channel = &layout.channels[row.channel];
    let [x, y, z, a, b] = [&world.x, &world.y, &world.z, &world.a, &world.b].map(|t| sum_of_terms(t, q));
    let turned = layout.turn_sign * q + layout.index_angles_rad[row.index];
    let (sin, cos) = channel.angle_rad.sin_cos();
    let mut distance = STAND_OFF_MM;
    match channel.surface {
        Surface::Section(section) => {
            let height = layout.section_z_mm[section] - layout.reference_z_mm;
            let centre = [x + b * height, y - a * height];
            for _ in 0..20 {
                let reach = SECTION_RADIUS_MM + STAND_OFF_MM - distance;
                let point = [reach * cos - centre[0], reach * sin - centre[1]];
                let on_artefact = point[1].atan2(point[0]) - turned;
                let radius = SECTION_RADIUS_MM + sum_of_terms(&world.sections[section], on_artefact);
                distance += point[0].hypot(point[1]) - radius;
            }
        }
        Surface::Face { radius_mm } => {
            let point = [radius_mm * cos - x, radius_mm * sin - y];
            let on_artefact = point[1].atan2(point[0]) - turned;
            let surface = z + a * point[1] - b * point[0] + sum_of_terms(&world.face, on_artefact);
            distance = FACE_HEIGHT_MM + STAND_OFF_MM - (FACE_HEIGHT_MM + surface);
        }
    }
    distance
}

#[test]
fn regress_readings_in_space() {
    for turn in [1.0, -1.0] {
        let layout = layout(7, turn);
        let world = SimulatedMotions::random(3, 6, 2, 0.0);
        let samples = 64;
        let row = |row: &ChannelAtIndex| {
            let angle = |i: usize| i as f64 * TAU / samples as f64;
            let own = (0..samples).map(|i| -reading(&world, &layout, *row, angle(i))).collect();
            ChannelRevolutions { key: *row, revolutions: vec![own; 2] }
        };
        let measured: Vec<ChannelRevolutions> = layout.all_row_keys().iter().map(row).collect();
        let data = HarmonicData::from_revolutions(&measured, 6).unwrap();
        let fit = SeparationFit::new(&layout, &data).unwrap();
        let mut worst: f64 = 0.0;
        for (k, harmonic) in fit.blocks.iter().enumerate() {
            let [x, y, a, b, z] = [&world.x, &world.y, &world.a, &world.b, &world.z].map(|terms| terms[k]);
            let form = |term: super::generator::HarmonicTerm| [term.a, -turn * term.b];
            let truth = [
                [x.a, x.b],
                [y.a, y.b],
                [a.a * 100.0, a.b * 100.0],
                [b.a * 100.0, b.b * 100.0],
                form(world.sections[0][k]),
                form(world.sections[1][k]),
                [z.a, z.b],
                form(world.face[k]),
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
