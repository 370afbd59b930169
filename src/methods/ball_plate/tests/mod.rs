//! Gate G5 of METHODS: nullities, and the simulation of paper 5.
//!
//! The measurements are computed from rotation matrices written here, not from the equations under test.

mod four_step;
mod gate_g5;
mod nullities;

use nalgebra::{Rotation3, Vector3};

use super::angle_basis::AngleBasis;
use super::design::rigid_motion_derivatives;
use super::equations::BallObservation;
use super::unknowns_layout::{TableStop, UnknownsLayout};
use std::f64::consts::TAU;

/// The plate of paper 5: right-handed rotation, balls at steps of 360°/M.
struct PlateSimulation {
    measuring_position_count: usize,
    revolutions: usize,
    circle_radius_mm: f64,
    ball_steps: Vec<usize>,
}

impl PlateSimulation {
    fn stops(&self) -> Vec<TableStop> {
        let count = self.measuring_position_count * self.revolutions;
        let angle = |i: usize| TAU * i as f64 / self.measuring_position_count as f64;
        (0..count).map(|i| TableStop { angle: angle(i), approach_sign: 1.0 }).collect()
    }

    fn radial_directions(&self) -> Vec<Vector3<f64>> {
        let azimuth = |step: &usize| TAU * *step as f64 / self.measuring_position_count as f64;
        self.ball_steps.iter().map(azimuth).map(|a| Vector3::new(a.cos(), a.sin(), 0.0)).collect()
    }

    fn layout(&self, basis: AngleBasis) -> UnknownsLayout {
        UnknownsLayout {
            angle_basis: basis,
            has_reversal: false,
            drift_order: 0,
            interruption_count: 0,
            measuring_position_count: self.measuring_position_count,
            radial_directions: self.radial_directions(),
            turn_sign: 1.0,
        }
    }

    /// Observations with the `deviation` by index of the stop, the ball and the measuring position. `None`: the ball
    /// is not measured at this stop.
    fn observations(
        &self,
        mut deviation: impl FnMut(usize, usize, usize) -> Option<Vector3<f64>>,
    ) -> Vec<BallObservation> {
        let mut observations = Vec::new();
        for (i, stop) in self.stops().iter().enumerate() {
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), stop.angle);
            for (ball, radial) in self.radial_directions().iter().enumerate() {
                let place = (self.ball_steps[ball] + i) % self.measuring_position_count;
                let Some(deviation) = deviation(i, ball, place) else { continue };
                observations.push(BallObservation {
                    stop_index: i,
                    ball_index: ball,
                    measuring_position_index: place,
                    relative_time: 0.0,
                    preceding_interruption_count: 0,
                    axis_position_deviation_mm: deviation,
                    derivatives_by_error_motion: rigid_motion_derivatives(turned * radial * self.circle_radius_mm),
                    derivative_by_ball_position: *turned.matrix(),
                });
            }
        }
        observations
    }
}
