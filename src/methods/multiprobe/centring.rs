//! Eccentricity and tilt of the artefact from one revolution in few stops, for the person who centres it.

use std::collections::BTreeMap;

use super::label::Label;
use super::model::Surface;
use super::setup::Setup;
use machine::record::reading::Reading;

/// Stops in the revolution.
pub const CENTRING_POINTS: usize = 12;

/// What the last round of centring has shown.
pub struct Centring {
    /// Sections from the table's axis in the directions of X and Y as the table stands after the round, mm.
    offsets_mm: Vec<[f64; 2]>,
    /// Least and greatest distance of each sensor, mm. `None`: it has reported none.
    used_mm: Vec<Option<[f64; 2]>>,
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
        let offset = |section: usize| offset_mm(setup, section, &round, stands);
        Some(Self {
            offsets_mm: (0..setup.layout.section_z_mm.len()).map(offset).collect(),
            used_mm: setup.layout.channels.iter().map(|channel| used(&channel.name)).collect(),
        })
    }

    pub fn is_within(&self, setup: &Setup<'_>) -> bool {
        let limit_mm = setup.settings.eccentricity_limit_um * 1e-3;
        self.offsets_mm.iter().all(|[x, y]| x.hypot(*y) <= limit_mm)
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
