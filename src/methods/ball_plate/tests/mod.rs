//! Gate G5 of METHODS: nullities, and the simulation of paper 5.
//!
//! The measurements are computed from rotation matrices written here, not from the equations under test.

mod four_step;
mod g5;
mod nullities;

use nalgebra::{Rotation3, Vector3};

use super::basis::Basis;
use super::design::rigid_motion;
use super::equations::BallObservation;
use super::layout::{Layout, Stop};
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
        (0..count).map(|i| Stop { angle: angle(i), direction: 1.0 }).collect()
    }

    fn radial(&self) -> Vec<Vector3<f64>> {
        let azimuth = |step: &usize| TAU * *step as f64 / self.positions as f64;
        self.steps.iter().map(azimuth).map(|a| Vector3::new(a.cos(), a.sin(), 0.0)).collect()
    }

    fn layout(&self, basis: Basis) -> Layout {
        Layout {
            basis,
            has_reversal: false,
            drift_order: 0,
            interruptions: 0,
            places: self.positions,
            radial: self.radial(),
            turn: 1.0,
        }
    }

    /// Sightings with the `deviation` of a ball at a stop; `None`: the visit is missing.
    fn sightings(
        &self,
        mut deviation: impl FnMut(usize, usize, usize) -> Option<Vector3<f64>>,
    ) -> Vec<BallObservation> {
        let mut sightings = Vec::new();
        for (i, stop) in self.stops().iter().enumerate() {
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), stop.angle);
            for (ball, radial) in self.radial().iter().enumerate() {
                let place = (self.steps[ball] + i) % self.positions;
                let Some(deviation) = deviation(i, ball, place) else { continue };
                sightings.push(BallObservation {
                    stop: i,
                    ball,
                    place,
                    time: 0.0,
                    segment: 0,
                    deviation,
                    by_motion: rigid_motion(turned * radial * self.radius_mm),
                    by_ball: *turned.matrix(),
                });
            }
        }
        sightings
    }
}
