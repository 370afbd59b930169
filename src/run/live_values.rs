//! Live values of a prompt's sensors while the operator works at the machine, and the artefact's position from
//! them. A sensor failure here does not end the run: the operator may have moved the sensor.

use std::collections::BTreeMap;

use futures_util::future::join_all;
use nalgebra::{Matrix2, Vector2};

use super::Run;
use super::watched_sensors::is_distance;
use machine::record::reading::ReadingFlag;
use machine::record::watched_sensors::{
    CrossSectionPoint, LiveCrossSectionValue, LiveSensorValue, LiveValues, WatchedSensor,
};

/// Minimum determinant of the normal equations of an eccentricity; for two sensors it is the squared sine of
/// the angle between them.
const MIN_ECCENTRICITY_DETERMINANT: f64 = 0.05;

impl Run<'_> {
    /// Reads the next sample of each of these sensors. The values are not stored.
    pub(super) async fn read_live_values(&self, watched_sensors: &[WatchedSensor]) -> LiveValues {
        live_values_with_artefact_position(
            watched_sensors,
            join_all(watched_sensors.iter().map(|watched| self.read_live_sensor(watched))).await,
        )
    }

    async fn read_live_sensor(&self, watched: &WatchedSensor) -> LiveSensorValue {
        let name = watched.sensor.as_str();
        let declared = self.plan.sensors.iter().find(|sensor| sensor.name == name);
        let read = match self.find_open_sensor(name) {
            Ok(sensor) => sensor.sample_for_display().await.map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        let read = read.and_then(|sample| match sample.value_mm.filter(|_| is_distance(&sample)) {
            Some(mm) => Ok(mm),
            None => Err(describe_missing_distance(sample.flag).to_owned()),
        });
        LiveSensorValue {
            sensor: name.to_owned(),
            range_mm: declared.map_or([0.0; 2], |sensor| sensor.range_mm),
            target_mm: watched.target_mm,
            value_mm: read.as_ref().ok().copied(),
            failure: read.err(),
        }
    }
}

fn describe_missing_distance(flag: ReadingFlag) -> &'static str {
    match flag {
        ReadingFlag::Range => "out of range",
        ReadingFlag::Saturated => "saturated",
        _ => "no signal",
    }
}

/// Adds the position of the artefact to the values.
pub(super) fn live_values_with_artefact_position(
    watched_sensors: &[WatchedSensor],
    sensors: Vec<LiveSensorValue>,
) -> LiveValues {
    let sections = section_eccentricities(watched_sensors, &sensors);
    let numbered = |section: &SectionEccentricity| LiveCrossSectionValue {
        number: section.section_number,
        eccentricity_um: section.eccentricity_mm.map(|mm| mm.map(|mm| mm * 1e3)),
    };
    let tilt_urad = tilt_of_two_sections_urad(&sections);
    LiveValues { sensors, sections: sections.iter().map(numbered).collect(), tilt_urad }
}

/// Position of one cross section, machine frame.
struct SectionEccentricity {
    /// From 1.
    section_number: usize,
    /// Height of the cross section.
    z_mm: f64,
    /// From the axis to the centre of the section, X and Y. `None`: the sensors do not determine it.
    eccentricity_mm: Option<[f64; 2]>,
}

/// Eccentricities of the cross-sections to which the watched sensors belong, in the order of the section numbers.
fn section_eccentricities(watched_sensors: &[WatchedSensor], sensors: &[LiveSensorValue]) -> Vec<SectionEccentricity> {
    let mut deviations: BTreeMap<usize, (f64, Vec<RadialDeviation>)> = BTreeMap::new();
    for (watched, live) in watched_sensors.iter().zip(sensors) {
        let Some(CrossSectionPoint { number, z_mm, angle_deg }) = watched.section else { continue };
        let (_, of_section) = deviations.entry(number).or_insert((z_mm, Vec::new()));
        let to_target_mm = live.change_to_target_um().map(|um| um * 1e-3);
        let angle_rad = angle_deg.to_radians();
        of_section.extend(
            to_target_mm.map(|to_target_mm| RadialDeviation {
                sensor_angle_rad: angle_rad,
                target_minus_value_mm: to_target_mm,
            }),
        );
    }
    let section = |(number, (z_mm, of_section)): (usize, (f64, Vec<RadialDeviation>))| {
        let eccentricity_mm = least_squares_eccentricity_mm(&of_section);
        SectionEccentricity { section_number: number, z_mm, eccentricity_mm }
    };
    deviations.into_iter().map(section).collect()
}

/// Deviation at one radial sensor.
struct RadialDeviation {
    /// Direction from the axis to the sensor, counter-clockwise from +X.
    sensor_angle_rad: f64,
    /// Target minus value, mm: the eccentricity's component towards the sensor.
    target_minus_value_mm: f64,
}

/// Eccentricity by least squares, mm. `None`: fewer than two sensors, or two opposite ones.
fn least_squares_eccentricity_mm(deviations: &[RadialDeviation]) -> Option<[f64; 2]> {
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for RadialDeviation { sensor_angle_rad: angle_rad, target_minus_value_mm: to_target_mm } in deviations {
        let towards = Vector2::new(angle_rad.cos(), angle_rad.sin());
        normal += towards * towards.transpose();
        right += towards * *to_target_mm;
    }
    let is_determined = normal.determinant() > MIN_ECCENTRICITY_DETERMINANT;
    let inverse = normal.try_inverse().filter(|_| is_determined)?;
    Some((inverse * right).into())
}

/// Slope of the line through the centres of the two sections against Z, along X and Y, µrad. `None`: not two
/// sections, or one without an eccentricity.
fn tilt_of_two_sections_urad(sections: &[SectionEccentricity]) -> Option<[f64; 2]> {
    let [low, high] = sections else { return None };
    let (from, to) = (low.eccentricity_mm?, high.eccentricity_mm?);
    let slope = |k: usize| (to[k] - from[k]) / (high.z_mm - low.z_mm) * 1e6;
    Some([slope(0), slope(1)])
}
