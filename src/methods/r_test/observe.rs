//! From readings to means of the sensors at each point.

use std::collections::BTreeSet;

use nalgebra::{Rotation3, Vector3};

use super::sensor_nest::SensorNest;
use crate::{IdentifyError, readings_of_last_repeat};
use machine::Position;
use machine::record::plan::{Scan, Step};
use machine::record::reading::{Reading, ReadingFlag};

/// Label of the scan of the calibration. The identification uses this scan and those of the two turns.
pub const CALIBRATION_STEP_LABEL: &str = "calibration";
/// Label of the scan of the forward turn.
pub const FORWARD_STEP_LABEL: &str = "turn/forward";
/// Label of the scan of the backward turn.
pub const BACKWARD_STEP_LABEL: &str = "turn/backward";

/// Displacement of the sphere relative to the sensor nest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SphereDisplacement {
    /// Known from the displayed positions, table frame, mm.
    Known(Vector3<f64>),
    /// At this stop of the revolution, from 0. The fit determines the displacement; at stop 0 it is zero by definition.
    UnknownAtStop(usize),
}

/// Mean of the samples of one sensor at one point of a path.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorMean {
    /// Step, point of its path and sensor, e.g. `turn/forward/3/K1`.
    pub label: String,
    /// Index among the sensors of the nest.
    pub sensor_index: usize,
    pub displacement: SphereDisplacement,
    /// Rotation from the table frame to the machine frame.
    pub machine_from_table: Rotation3<f64>,
    pub reading_mm: f64,
    /// Number of the samples that the mean contains.
    pub sample_count: usize,
    /// Mean time of its samples on the clock of the run, s.
    pub mean_time_in_run_s: f64,
    /// Number of interruptions before the mean, counting only those with means before and after them.
    pub earlier_interruption_count: usize,
}

#[derive(Debug, Default)]
pub struct ObservedMeans {
    pub means: Vec<SensorMean>,
    /// Number of pairs of point and sensor without a valid distance. Points without any reading are not counted.
    pub missing_mean_count: usize,
}

/// Means of the calibration scan and of both turns, each from the last repeat of its step.
///
/// # Errors
/// A reading belongs to no step of the plan, or a scan has no reading.
pub fn observe_means(nest: &SensorNest<'_>, readings: &[Reading]) -> Result<ObservedMeans, IdentifyError> {
    IdentifyError::check_known_steps(nest.plan, readings)?;
    let mut observed = ObservedMeans::default();
    for step in &nest.plan.steps {
        let is_used = [CALIBRATION_STEP_LABEL, FORWARD_STEP_LABEL, BACKWARD_STEP_LABEL].contains(&step.label.as_str());
        if let (true, Some(scan)) = (is_used, &step.scan) {
            let own = readings_of_last_repeat(step, readings)?;
            for point in 0..scan.path.len() {
                let at_point = readings_nearest_to_point(&own, scan, point);
                observed.add_means_at_point(nest, step, point, &scan.path[point], &at_point);
            }
        }
    }
    observed.number_interruptions();
    Ok(observed)
}

/// Readings for which this point of the path is the nearest. If the path visits a point several times, the readings of
/// all visits are assigned to the first one.
fn readings_nearest_to_point<'r>(readings: &[&'r Reading], scan: &Scan, point: usize) -> Vec<&'r Reading> {
    let is_nearest = |reading: &&&Reading| scan.nearest_point_index(&reading.position) == Some(point);
    readings.iter().filter(is_nearest).copied().collect()
}

impl ObservedMeans {
    /// Numbers the interruptions that have means before and after them. Other interruptions have no effect, because an
    /// interrupted scan is measured again as a whole.
    fn number_interruptions(&mut self) {
        let counts: BTreeSet<usize> = self.means.iter().map(|mean| mean.earlier_interruption_count).collect();
        for mean in &mut self.means {
            mean.earlier_interruption_count = counts.range(..mean.earlier_interruption_count).count();
        }
    }

    /// Adds one mean per sensor, from its values without a flag or with the flag `Gap`.
    fn add_means_at_point(
        &mut self,
        nest: &SensorNest<'_>,
        step: &Step,
        point: usize,
        at: &Position,
        readings: &[&Reading],
    ) {
        let angle = at.get_or_zero(nest.measured_axis);
        let displacement = match step.label.as_str() {
            CALIBRATION_STEP_LABEL => SphereDisplacement::Known(nest.sphere_displacement_at(at)),
            _ => SphereDisplacement::UnknownAtStop(nest.stop_index(angle)),
        };
        for (sensor_index, declared) in nest.sensors.iter().enumerate() {
            let own = readings.iter().filter(|reading| reading.sensor == declared.name);
            let good = own.filter(|reading| matches!(reading.flag, ReadingFlag::None | ReadingFlag::Gap));
            let samples: Vec<(f64, f64)> = good.filter_map(|reading| Some((reading.value_mm?, reading.t_s))).collect();
            let count = samples.len() as f64;
            if samples.is_empty() {
                self.missing_mean_count += usize::from(!readings.is_empty());
                continue;
            }
            let t_s = samples.iter().map(|(_, t_s)| t_s).sum::<f64>() / count;
            self.means.push(SensorMean {
                label: format!("{}/{}/{}", step.label, point + 1, declared.name),
                sensor_index,
                displacement,
                machine_from_table: nest.machine_from_table(angle),
                reading_mm: samples.iter().map(|(value, _)| value).sum::<f64>() / count,
                sample_count: samples.len(),
                mean_time_in_run_s: t_s,
                earlier_interruption_count: nest.plan.interruption_times_s.iter().filter(|gap_s| t_s > **gap_s).count(),
            });
        }
    }
}
