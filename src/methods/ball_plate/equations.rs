//! The observation equations (paper 5, Eq. (1), with all measuring positions unknown) and their solution by
//! least squares over all visits.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::layout::{COMPONENTS, Layout, Stop};
use estimation::linear::{
    self, LinearError, LinearProblem, LinearSolution, RANK_THRESHOLD, Survey,
};

/// One ball at one stop.
#[derive(Debug, Clone)]
pub struct Sighting {
    pub stop: usize,
    pub ball: usize,
    /// Measuring position.
    pub place: usize,
    /// Time over half the duration of the run, from its middle: −1 to 1.
    pub time: f64,
    /// Number of interruptions before it.
    pub segment: usize,
    /// X, Y, Z at which the stylus ball coincides with the ball, less those of the nominal machine for the ball's
    /// expected place, mm.
    pub deviation: Vector3<f64>,
    /// Change of that deviation by each error motion of the rotary axis, mm per mm or rad.
    pub by_motion: [Vector3<f64>; COMPONENTS.len()],
    /// The same by the place of the ball in the table frame.
    pub by_ball: Matrix3<f64>,
}

/// Deviations of all sightings as linear functions of the unknowns; three rows a sighting.
pub fn matrix(layout: &Layout, stops: &[Stop], sightings: &[Sighting]) -> Mat<f64> {
    let mut a = Mat::zeros(3 * sightings.len(), layout.unknowns());
    for (i, sighting) in sightings.iter().enumerate() {
        let mut set = |j: usize, column: Vector3<f64>| {
            (0..3).for_each(|axis| a[(3 * i + axis, j)] = column[axis]);
        };
        let Some(stop) = stops.get(sighting.stop) else { continue };
        let functions = layout.basis.values(stop.angle, sighting.stop);
        for (component, by) in sighting.by_motion.iter().enumerate() {
            for (function, value) in functions.iter().enumerate() {
                set(layout.motion(component, function), by * *value);
            }
            if layout.has_reversal {
                // The reversal value is the whole difference between both directions.
                set(layout.reversal(component), by * (0.5 * stop.direction));
            }
        }
        for axis in 0..3 {
            let along = Vector3::from_fn(|k, _| f64::from(u8::from(k == axis)));
            for order in 1..=layout.drift_order {
                set(layout.drift(order, axis), along * sighting.time.powi(order as i32));
            }
            for interruption in 0..sighting.segment.min(layout.interruptions) {
                set(layout.step(interruption, axis), along);
            }
            // A linear axis that stands too far shows too little.
            set(layout.place(sighting.place, axis), -along);
            set(layout.ball(sighting.ball, axis), sighting.by_ball.column(axis).into_owned());
        }
    }
    a
}

/// # Errors
/// Visits that do not separate the unknowns.
pub fn solve(
    layout: &Layout,
    stops: &[Stop],
    sightings: &[Sighting],
    sigma: &[f64],
) -> Result<(Mat<f64>, LinearSolution), LinearError> {
    let a = matrix(layout, stops, sightings);
    let deviations: Vec<f64> = sightings.iter().flat_map(|s| s.deviation.iter().copied()).collect();
    let solution = linear::solve(&LinearProblem {
        a: a.as_ref(),
        y: &deviations,
        sigma,
        constraints: Some(layout.gauge(stops).as_ref()),
        rank_threshold: RANK_THRESHOLD,
    })?;
    Ok((a, solution))
}

/// What the visits cannot tell, with or without the gauge.
///
/// # Errors
/// As [`linear::survey`].
pub fn survey(
    layout: &Layout,
    stops: &[Stop],
    sightings: &[Sighting],
    with_gauge: bool,
) -> Result<Survey, LinearError> {
    let a = matrix(layout, stops, sightings);
    let gauge = layout.gauge(stops);
    linear::survey(a.as_ref(), with_gauge.then_some(gauge.as_ref()), RANK_THRESHOLD)
}
