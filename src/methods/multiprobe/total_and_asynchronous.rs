//! Total and asynchronous error motion values, from the single revolutions.

use estimation::linear_least_squares::{self, LinearProblem, RANK_THRESHOLD};
use estimation::revolutions::{ChannelAtMounting, ChannelRevolutions};
use faer::Mat;
use machine::record::estimate::Parameter;

use super::model::{MotionOrForm, ProbeLayout};
use super::outputs::ReportedMotions;
use crate::identification::{ErrorMotionValues, HarmonicFunction, total_and_asynchronous_parameters};

/// Total and asynchronous value of each error motion, as the mean over the indexes, from turns in one direction:
/// turns in both directions would include the reversal error. An index with one revolution, or whose channels do not
/// determine the motion, is omitted. At least two indexes are required.
pub fn total_and_asynchronous_values(
    layout: &ProbeLayout,
    motions: &ReportedMotions<'_>,
    measured: &[ChannelRevolutions],
) -> Vec<Parameter> {
    let samples = measured.first().map_or(0, |row| row.revolutions[0].len());
    let parameters = |(component, motion): (MotionOrForm, HarmonicFunction)| {
        let synchronous = motion.values_at_equal_angles(samples, motions.solution());
        let of_index = |index: usize| {
            let own: Vec<_> = measured.iter().filter(|row| row.key.mounting_index == index).collect();
            let single = motion_in_each_revolution(layout, &own, component).filter(|all| all.len() > 1)?;
            Some(ErrorMotionValues::new(&synchronous, &single))
        };
        let indexes = 0..layout.index_angles_rad.len();
        let values: Vec<ErrorMotionValues> = indexes.filter_map(of_index).collect();
        total_and_asynchronous_parameters(&motion.symbol, motion.unit, &values)
    };
    motions.error_motions().flat_map(parameters).collect()
}

/// The motion in each revolution of one index. It includes the form of the artefact, which is the same in all
/// revolutions. `None`: the channels do not determine the motion.
fn motion_in_each_revolution(
    layout: &ProbeLayout,
    own: &[&ChannelRevolutions],
    component: MotionOrForm,
) -> Option<Vec<Vec<f64>>> {
    let gain = motion_from_channels_factors(layout, own, component)?;
    let motion = |r: usize| {
        let mut sum = vec![0.0; own[0].revolutions[r].len()];
        for (row, gain) in own.iter().zip(&gain) {
            sum.iter_mut().zip(&row.revolutions[r]).for_each(|(sum, m)| *sum += gain * m);
        }
        sum
    };
    Some((0..own[0].revolutions.len()).map(motion).collect())
}

/// Factors, one per row, from the deviations of the channels to the motion at one angle, without a model of the form.
/// `None`: the channels do not determine the motion.
fn motion_from_channels_factors(
    layout: &ProbeLayout,
    own: &[&ChannelRevolutions],
    component: MotionOrForm,
) -> Option<Vec<f64>> {
    let rows: Vec<ChannelAtMounting> = own.iter().map(|row| row.key).collect();
    let components = layout.components();
    let columns: Vec<usize> = (0..components.len()).filter(|j| !components[*j].is_artefact_form()).collect();
    let design = layout.design_matrix(&rows, 0);
    let a = Mat::from_fn(rows.len(), columns.len(), |i, j| design[(i, 2 * columns[j])]);
    let problem = LinearProblem {
        a: a.as_ref(),
        y: &vec![0.0; rows.len()],
        sigma: &vec![1.0; rows.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let solution = linear_least_squares::solve_least_squares(&problem).ok()?;
    let position = columns.iter().position(|j| components[*j] == component)?;
    Some((0..rows.len()).map(|i| solution.gain[(position, i)]).collect())
}
