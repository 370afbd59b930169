//! Gate G5 of METHODS: nullities, and the simulation of paper 5.
//!
//! The measurements are computed from rotation matrices written here, not from the equations under test.

mod four_step;
mod g5;
mod nullities;

use nalgebra::{Rotation3, Vector3};

use super::basis::AngleBasis;
use super::design::rigid_motion_columns;
use super::equations::BallObservation;
use super::layout::{Stop, UnknownsLayout};
use std::f64::consts::TAU;

/// The plate of paper 5: right-handed rotation, balls at steps of 360°/M.
struct Setting {
    positions: usize,
    revolutions: usize,
    radius_mm: f64,
    steps: Vec<usize>,
}

impl Setting {
    fn stops(&self) -> Vec<Stop> {
        let count = self.positions * self.revolutions;
        let angle = |i: usize| TAU * i as f64 / self.positions as f64;
        (0..count).map(|i| Stop { angle: angle(i), approach_direction: 1.0 }).collect()
    }

    fn radial(&self) -> Vec<Vector3<f64>> {
        let azimuth = |step: &usize| TAU * *step as f64 / self.positions as f64;
        self.steps.iter().map(azimuth).map(|a| Vector3::new(a.cos(), a.sin(), 0.0)).collect()
    }

    fn layout(&self, basis: AngleBasis) -> UnknownsLayout {
        UnknownsLayout {
            basis,
            has_reversal: false,
            drift_order: 0,
            interruption_count: 0,
            position_count: self.positions,
            radial_directions: self.radial(),
            rotation_sense: 1.0,
        }
    }

    /// Sightings with the `deviation` of a ball at a stop; `None`: the visit is missing.
    fn observations(
        &self,
        mut deviation: impl FnMut(usize, usize, usize) -> Option<Vector3<f64>>,
    ) -> Vec<BallObservation> {
        let mut observations = Vec::new();
        for (i, stop) in self.stops().iter().enumerate() {
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), stop.angle);
            for (ball, radial) in self.radial().iter().enumerate() {
                let place = (self.steps[ball] + i) % self.positions;
                let Some(deviation) = deviation(i, ball, place) else { continue };
                observations.push(BallObservation {
                    stop: i,
                    ball,
                    position_index: place,
                    relative_time: 0.0,
                    preceding_interruptions: 0,
                    deviation,
                    motion_derivatives: rigid_motion_columns(turned * radial * self.radius_mm),
                    ball_derivative: *turned.matrix(),
                });
            }
        }
        observations
    }
}
