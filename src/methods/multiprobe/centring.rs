//! Eccentricity and tilt of the artefact from one revolution in few stops, for the person who centres it.

use std::collections::BTreeMap;

use super::label::Label;
use super::model::Surface;
use super::setup::Setup;
use machine::record::reading::Reading;
use machine::record::watch::{SectionSensor, WatchedSensor};

/// Stops in the revolution.
pub const CENTRING_POINTS: usize = 12;
/// Half the angle between two stops, rad.
const HALF_STEP: f64 = std::f64::consts::PI / CENTRING_POINTS as f64;

/// What the last round of centring has shown.
pub struct Centring {
    /// Sections from the table's axis in the directions of X and Y as the table stands after the round, mm.
    offsets_mm: Vec<[f64; 2]>,
    /// Least and greatest distance of each sensor, mm. `None`: it has reported none.
    used_mm: Vec<Option<[f64; 2]>>,
    /// Mean distance of each sensor where the table stands after the round, mm.
    rest_mm: Vec<Option<f64>>,
}

impl Centring {
    /// `None`: no round was measured.
    pub fn of(setup: &Setup<'_>, readings: &[Reading]) -> Option<Self> {
        let is_centring = |label: &str| matches!(label.parse::<Label>(), Ok(Label::Centring(_)));
        let step = setup.plan.steps.iter().rev().find(|step| is_centring(&step.label))?;
        let round: Vec<&Reading> = readings.iter().filter(|r| r.step == step.id).collect();
        let stands = step.to.at(setup.axis);
        let used = |name: &str| {
            let values = round.iter().filter(|r| r.sensor == name).filter_map(|r| r.value_mm);
            let ends =
                values.fold([f64::MAX, f64::MIN], |[low, high], v| [low.min(v), high.max(v)]);
            (ends[0] <= ends[1]).then_some(ends)
        };
        let rest = |name: &str| {
            let is_last = |r: &&&Reading| (r.position.at(setup.axis) - stands).abs() < HALF_STEP;
            let last = round.iter().filter(|r| r.sensor == name).filter(is_last);
            let values: Vec<f64> = last.filter_map(|r| r.value_mm).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let offset = |section: usize| offset_mm(setup, section, &round, stands);
        Some(Self {
            offsets_mm: (0..setup.layout.section_z_mm.len()).map(offset).collect(),
            used_mm: setup.layout.channels.iter().map(|channel| used(&channel.name)).collect(),
            rest_mm: setup.layout.channels.iter().map(|channel| rest(&channel.name)).collect(),
        })
    }

    pub fn is_within(&self, setup: &Setup<'_>) -> bool {
        let limit_mm = setup.settings.eccentricity_limit_um * 1e-3;
        self.offsets_mm.iter().all(|[x, y]| x.hypot(*y) <= limit_mm)
    }

    /// The sensors to watch. Centring makes a radial value greater by the eccentricity's component towards the sensor.
    pub fn watch(&self, setup: &Setup<'_>) -> Vec<WatchedSensor> {
        let channels = setup.layout.channels.iter().zip(&self.rest_mm);
        let watched = channels.map(|(channel, rest_mm)| {
            let unaimed = WatchedSensor::new(&channel.name);
            let Surface::Section(section) = channel.surface else { return unaimed };
            let ([x, y], (sin, cos)) = (self.offsets_mm[section], channel.angle_rad.sin_cos());
            let (z_mm, angle_deg) =
                (setup.layout.section_z_mm[section], channel.angle_rad.to_degrees());
            WatchedSensor {
                target_mm: rest_mm.map(|rest| rest + x * cos + y * sin),
                section: Some(SectionSensor { number: section + 1, z_mm, angle_deg }),
                ..unaimed
            }
        });
        watched.collect()
    }

    /// What to do, for the prompt.
    pub fn text(&self, setup: &Setup<'_>) -> String {
        let section = |(number, [x, y]): (usize, &[f64; 2])| {
            format!("section {number} by X {:+.1} µm, Y {:+.1} µm", -x * 1e3, -y * 1e3)
        };
        let moves: Vec<String> = (1..).zip(&self.offsets_mm).map(section).collect();
        let tilt = match (self.offsets_mm.as_slice(), setup.layout.section_z_mm.as_slice()) {
            ([one, other], [low, high]) => {
                let slope = |k: usize| (other[k] - one[k]) / (high - low) * 1e6;
                format!("; it leans by X {:.0} µrad, Y {:.0} µrad", slope(0), slope(1))
            }
            _ => String::new(),
        };
        let used = setup.plan.sensors.iter().zip(&self.used_mm).map(|(sensor, used)| match used {
            Some([low, high]) => {
                let [least, most] = sensor.range_mm;
                format!("{} {low:.3} to {high:.3} mm of {least} to {most}", sensor.name)
            }
            None => format!("{} no distance", sensor.name),
        });
        format!(
            "Centre the artefact, as the table stands now: move {}{tilt}. Limit {} µm. The sensors reported {}. \
             The table will turn once",
            moves.join(", "),
            setup.settings.eccentricity_limit_um,
            used.collect::<Vec<String>>().join(", ")
        )
    }
}

/// The centre of a section from the axis with the table at the angle `stands`, rad: the first harmonic of its
/// sensors over the table's angle, which has the phase of γ − σq.
fn offset_mm(setup: &Setup<'_>, section: usize, round: &[&Reading], stands: f64) -> [f64; 2] {
    let sign = setup.layout.turn;
    let (mut sum, mut sensors) = ([0.0; 2], 0.0);
    for channel in &setup.layout.channels {
        if channel.surface != Surface::Section(section) {
            continue;
        }
        // One mean a stop; the last stop is the first one again.
        let mut stops: BTreeMap<i64, (f64, f64)> = BTreeMap::new();
        for reading in round.iter().filter(|reading| reading.sensor == channel.name) {
            let Some(value_mm) = reading.value_mm else { continue };
            let turned = (reading.position.at(setup.axis) - stands).to_degrees();
            let stop = (turned / 360.0 * CENTRING_POINTS as f64).round() as i64;
            let (total, count) = stops.entry(stop.rem_euclid(CENTRING_POINTS as i64)).or_default();
            (*total, *count) = (*total - value_mm, *count + 1.0);
        }
        for (stop, (total, count)) in &stops {
            let turned = *stop as f64 / CENTRING_POINTS as f64 * std::f64::consts::TAU;
            let (sin, cos) = (channel.angle_rad - sign * turned).sin_cos();
            let factor = 2.0 / stops.len() as f64 * total / count;
            (sum[0], sum[1]) = (sum[0] + factor * cos, sum[1] + factor * sin);
        }
        sensors += 1.0;
    }
    sum.map(|sum| if sensors > 0.0 { sum / sensors } else { 0.0 })
}
