//! Checks of a layout before motion. A refusal names a better layout.

use estimation::revolutions::AngleRange;
use std::ops::RangeInclusive;

use super::layout_prediction::{
    MIN_ANGLE_BETWEEN_SENSORS_DEG, SeparationMethod, acute_angle_between_sensors_deg, noise_gain_by_order,
    rms_noise_gain, third_sensor_angles_and_gains, unit_noise_fit,
};
use super::model::{MeasuredSurface, MotionOrForm, ProbeLayout, SensorChannel, equal_index_angles_rad};
use super::outputs::ReportedMotions;
use crate::MethodRefusal;

/// Minimum angle between a suggested sensor and the others, for the space of its housing.
const MIN_HOUSING_ANGLE_DEG: f64 = 30.0;

/// Refuses surfaces that the observation equation does not describe.
///
/// # Errors
/// There are not one or two sections; a sensor measures at a section without a height; the layout has a face but not
/// two sections; the sensors of the face have different radii.
pub fn check_surfaces(layout: &ProbeLayout) -> Result<(), MethodRefusal> {
    let sections = layout.section_z_mm.len();
    let is_placed = |c: &SensorChannel| !matches!(c.surface, MeasuredSurface::Section(i) if i >= sections);
    MethodRefusal::require(
        (1..=2).contains(&sections) && layout.channels.iter().all(is_placed),
        "a sensor measures at a section without a declared height",
        "declare one or two sections",
    )?;
    let radius = |c: &SensorChannel| match c.surface {
        MeasuredSurface::Face { radius_mm } => Some(radius_mm),
        MeasuredSurface::Section(_) => None,
    };
    let radii: Vec<f64> = layout.channels.iter().filter_map(radius).collect();
    MethodRefusal::require(
        radii.is_empty() || sections == 2,
        "an axial sensor without two sections: axial motion and tilt are inseparable",
        "add radial sensors at a second section, or remove the axial sensor",
    )?;
    MethodRefusal::require(
        radii.windows(2).all(|pair| pair[0] == pair[1]),
        "axial sensors on different radii do not measure the same form of the face",
        "move all axial sensors to one radius",
    )
}

/// Refuses coinciding and opposed sensors of one section.
///
/// # Errors
/// Names the two sensors, and the best angle for the second one outside the `obstructed_ranges`.
pub fn check_no_coinciding_sensors(
    layout: &ProbeLayout,
    obstructed_ranges: &[AngleRange],
) -> Result<(), MethodRefusal> {
    let channels = layout.channels.iter().enumerate();
    let mut pairs = channels.flat_map(|(i, first)| layout.channels[i + 1..].iter().map(move |second| [first, second]));
    let is_coinciding = |[first, second]: &[&SensorChannel; 2]| {
        let [a, b] = [first, second].map(|channel| channel.angle_rad.to_degrees());
        let is_same_section = matches!(first.surface, MeasuredSurface::Section(_)) && first.surface == second.surface;
        is_same_section && acute_angle_between_sensors_deg(a, b) < MIN_ANGLE_BETWEEN_SENSORS_DEG
    };
    let coinciding = pairs.find(is_coinciding);
    coinciding.map_or(Ok(()), |pair| Err(refuse_coinciding_sensors(layout, pair, obstructed_ranges)))
}

fn refuse_coinciding_sensors(
    layout: &ProbeLayout,
    [first, second]: [&SensorChannel; 2],
    obstructed_ranges: &[AngleRange],
) -> MethodRefusal {
    let [a, b] = [first, second].map(channel_angle_deg);
    let others = layout.channels.iter().filter(|c| c.surface == first.surface && c.name != second.name);
    let others: Vec<f64> = others.map(channel_angle_deg).collect();
    let better = match others.as_slice() {
        [first, second, ..] => best_third_angle_and_gain([*first, *second], obstructed_ranges).map(|(deg, _)| deg),
        _ => Some((a + 90.0).rem_euclid(360.0)),
    };
    let suggestion = better.map_or_else(String::new, |deg| format!(": {deg:.0}° has the lowest noise gain"));
    let why = format!(
        "the sensors {} ({a:.1}°) and {} ({b:.1}°) coincide or are opposed: they do not separate the motion from the \
         artefact",
        first.name, second.name
    );
    MethodRefusal::new(why, format!("move {}{suggestion}", second.name))
}

/// Angle of the sensor, 0 to below 360°.
fn channel_angle_deg(channel: &SensorChannel) -> f64 {
    channel.angle_rad.to_degrees().rem_euclid(360.0)
}

/// Angle of a third sensor with the smallest noise gain, degrees, and this gain (RMS over the harmonics 2 to 20). The
/// angle leaves space for the housings. `None`: no free angle determines all these harmonics.
fn best_third_angle_and_gain(pair_deg: [f64; 2], obstructed_ranges: &[AngleRange]) -> Option<(f64, f64)> {
    let housings = pair_deg.map(|deg| AngleRange::centred_range(deg, MIN_HOUSING_ANGLE_DEG));
    let obstructed_ranges = [obstructed_ranges, &housings].concat();
    third_sensor_angles_and_gains(pair_deg, &obstructed_ranges).into_iter().next()
}

/// Refuses a layout that does not determine one of the `orders` of an error motion. The co-rotating first harmonic
/// is never determined and is not a reason for refusal.
///
/// # Errors
/// Names the undetermined harmonics, and a number of indexes that determines all.
pub fn check_harmonic_orders(
    layout: &ProbeLayout,
    motions: &[MotionOrForm],
    orders: RangeInclusive<usize>,
) -> Result<(), MethodRefusal> {
    let undetermined = undetermined_orders(layout, motions, &orders)?;
    let Some((component, order)) = undetermined.first() else { return Ok(()) };
    let indexes = layout.index_angles_rad.len();
    let is_better = |count: &usize| {
        let changed = ProbeLayout { index_angles_rad: equal_index_angles_rad(*count), ..layout.clone() };
        undetermined_orders(&changed, motions, &orders).is_ok_and(|lost| lost.is_empty())
    };
    let candidates = indexes + 1..=(2 * orders.end() + 1).max(indexes + 1);
    let instead = candidates.into_iter().find(is_better).map_or_else(
        || "add a sensor, or reduce harmonics".to_owned(),
        |count| format!("index the artefact in {count} steps of {:.2}°", 360.0 / count as f64),
    );
    let (sensors, lost, symbol) = (layout.channels.len(), undetermined.len(), component.symbol(layout.measured_axis));
    let why = format!(
        "{sensors} sensors with {indexes} indexes do not determine {lost} harmonics of the error \
         motions; the first is {symbol} harmonic {order}"
    );
    Err(MethodRefusal::new(why, instead))
}

/// Text for the operator before motion: what the layout does not measure, and what it measures least accurately.
///
/// # Errors
/// An angle is not finite.
pub fn describe_weak_points(
    layout: &ProbeLayout,
    harmonics: usize,
    obstructed_ranges: &[AngleRange],
) -> Result<String, MethodRefusal> {
    let axial: Vec<MotionOrForm> = layout.components().into_iter().filter(|c| *c == MotionOrForm::Z).collect();
    let lost = undetermined_orders(layout, &axial, &(1..=harmonics))?;
    let lost: Vec<String> = lost.iter().map(|(_, order)| order.to_string()).collect();
    let [ex, ez] = [MotionOrForm::X, MotionOrForm::Z].map(|component| component.symbol(layout.measured_axis));
    let lost = (!lost.is_empty()).then(|| format!(" Harmonics of {ez} that are not measured: {}.", lost.join(", ")));
    let gains = noise_gain_by_order(&layout.reduced_to_first_section(), SeparationMethod::Combined, 2..=harmonics)?;
    let weakest = gains.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(order, gain)| {
        format!(" Largest uncertainty in {ex}: harmonic {order}, {gain:.1} times the uncertainty of one sensor.")
    });
    let third = describe_third_sensor(&layout.reduced_to_first_section(), obstructed_ranges)?;
    Ok([lost, weakest, third].into_iter().flatten().collect())
}

/// Text with the noise gain of three sensors of one section in one mounting, and the best angle of the third sensor
/// if another angle is better. `None`: the section does not have exactly three sensors.
fn describe_third_sensor(
    section: &ProbeLayout,
    obstructed_ranges: &[AngleRange],
) -> Result<Option<String>, MethodRefusal> {
    let [first, second, third] = section.channels.as_slice() else { return Ok(None) };
    let own = rms_noise_gain(section, SeparationMethod::Multiprobe)?;
    let best = best_third_angle_and_gain([first, second].map(channel_angle_deg), obstructed_ranges)
        .filter(|(_, gain)| *gain < own);
    let better = best.map(|(deg, gain)| format!("; {gain:.2} with {} at {deg:.0}°", third.name));
    Ok(Some(format!(
        " Noise gain of {}, {} and {} over harmonics 2 to 20 in one mounting: {own:.2}{}.",
        first.name,
        second.name,
        third.name,
        better.unwrap_or_default()
    )))
}

/// Pairs of motion and harmonic that the layout does not determine with all sensors at all indexes.
fn undetermined_orders(
    layout: &ProbeLayout,
    motions: &[MotionOrForm],
    orders: &RangeInclusive<usize>,
) -> Result<Vec<(MotionOrForm, usize)>, MethodRefusal> {
    let fit = unit_noise_fit(layout, layout.all_row_keys(), *orders.end())?;
    let reported = ReportedMotions::new(layout, &fit);
    let pairs = motions.iter().flat_map(|c| orders.clone().map(move |order| (*c, order)));
    Ok(pairs.filter(|(component, order)| !reported.is_identifiable(*component, *order)).collect())
}
