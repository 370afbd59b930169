//! Eccentricity of the artefact from one revolution with few stops, for the operator who centres it.

use std::f64::consts::PI;

use super::model::{MeasuredSurface, SensorChannel};
use super::setup::MultiprobeSetup;
use super::step_label::StepLabel;
use faer::c64;
use machine::record::reading::Reading;
use machine::record::watched_sensors::{CrossSectionPoint, WatchedSensor};

/// Number of different stop angles in the revolution. The turn ends with a further stop at the angle of the first.
pub const CENTRING_STOP_COUNT: usize = 12;

/// Result of the last round of centring.
pub struct CentringResult {
    /// Positions of the sections relative to the table's axis along X and Y, with the table at its angle after the
    /// round, mm.
    section_offsets_mm: Vec<[f64; 2]>,
    /// Last distance of each sensor, with the table at its angle after the round, mm. `None`: the sensor has no
    /// distance.
    last_readings_mm: Vec<Option<f64>>,
}

impl CentringResult {
    /// Evaluates the last round. `None`: no round was measured.
    pub fn from_readings(setup: &MultiprobeSetup<'_>, readings: &[Reading]) -> Option<Self> {
        let is_centring = |label: &str| matches!(label.parse::<StepLabel>(), Ok(StepLabel::CentringRound(_)));
        let step = setup.plan.steps.iter().rev().find(|step| is_centring(&step.label))?;
        let round: Vec<&Reading> = readings.iter().filter(|r| r.step == step.id).collect();
        let table_angle = step.to.get_or_zero(setup.measured_axis);
        let last = |channel: &SensorChannel| round.iter().rfind(|reading| reading.sensor == channel.name)?.value_mm;
        let offset = |section: usize| section_offset_mm(setup, section, &round, table_angle);
        Some(Self {
            section_offsets_mm: (0..setup.layout.section_z_mm.len()).map(offset).collect(),
            last_readings_mm: setup.layout.channels.iter().map(last).collect(),
        })
    }

    /// Whether the eccentricity of each section is at most `eccentricity_limit_um`.
    pub fn is_within_limit(&self, setup: &MultiprobeSetup<'_>) -> bool {
        let limit_mm = setup.settings.eccentricity_limit_um * 1e-3;
        self.section_offsets_mm.iter().all(|[x, y]| x.hypot(*y) <= limit_mm)
    }

    /// Sensors to display. A radial sensor has a target: its value when the section is centred. Centring increases
    /// this value by the component of the eccentricity towards the sensor.
    pub fn watched_sensors(&self, setup: &MultiprobeSetup<'_>) -> Vec<WatchedSensor> {
        let channels = setup.layout.channels.iter().zip(&self.last_readings_mm);
        let watched = channels.map(|(channel, last_mm)| {
            let watched = WatchedSensor::new(&channel.name);
            let MeasuredSurface::Section(section) = channel.surface else { return watched };
            let ([x, y], (sin, cos)) = (self.section_offsets_mm[section], channel.angle_rad.sin_cos());
            let (z_mm, angle) = (setup.layout.section_z_mm[section], channel.angle_rad);
            let (number, angle_deg) = (section + 1, angle.to_degrees());
            let section = Some(CrossSectionPoint { number, z_mm, angle_deg });
            let target_mm = last_mm.map(|last| last + x * cos + y * sin);
            WatchedSensor { target_mm, section, ..watched }
        });
        watched.collect()
    }

    /// Text of the prompt: the move in X and Y that centres each section, and the limit.
    pub fn prompt_text(&self, setup: &MultiprobeSetup<'_>) -> String {
        let section = |(number, [x, y]): (usize, &[f64; 2])| {
            format!("section {number} by X {:+.1} µm, Y {:+.1} µm", -x * 1e3, -y * 1e3)
        };
        let moves: Vec<String> = (1..).zip(&self.section_offsets_mm).map(section).collect();
        format!(
            "Centre the artefact with the table at its present angle: move {}. Limit {} µm. The \
             table will turn once",
            moves.join(", "),
            setup.settings.eccentricity_limit_um
        )
    }
}

/// Centre of a section relative to the axis with the table at the angle `table_angle`, rad: the mean over the section's
/// sensors of the first harmonic of the deviation over the table angle. A sensor at γ has the phase γ − σq.
fn section_offset_mm(
    setup: &MultiprobeSetup<'_>,
    section: usize,
    round_readings: &[&Reading],
    table_angle: f64,
) -> [f64; 2] {
    let of_sensor = |channel: &SensorChannel| {
        let own = round_readings.iter().filter(|reading| reading.sensor == channel.name);
        let points =
            own.filter_map(|r| Some((r.position.get_or_zero(setup.measured_axis) - table_angle, -r.value_mm?)));
        // The last stop has the same angle as the first one.
        let is_new = |(turned, _): &(f64, f64)| turned.abs() > PI / CENTRING_STOP_COUNT as f64;
        let points: Vec<(f64, f64)> = points.filter(is_new).collect();
        let count = points.len().max(1) as f64;
        let mean = points.iter().map(|(_, deviation)| deviation).sum::<f64>() / count;
        let harmonic =
            points.iter().map(|(turned, m)| c64::cis(channel.angle_rad - setup.layout.turn_sign * turned) * (m - mean));
        harmonic.sum::<c64>() * (2.0 / count)
    };
    let sensors = setup.layout.channels.iter().filter(|c| c.surface == MeasuredSurface::Section(section));
    let offsets: Vec<c64> = sensors.map(of_sensor).collect();
    let mean = offsets.iter().sum::<c64>() / offsets.len().max(1) as f64;
    [mean.re, mean.im]
}
