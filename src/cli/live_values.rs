//! Live values of a prompt's sensors, as lines for a terminal.

use machine::record::watched_sensors::{LiveCrossSectionValue, LiveSensorValue, LiveValues};

/// Number of characters of the range bar between its brackets.
const RANGE_BAR_WIDTH_CHARS: usize = 17;

pub fn live_value_lines(values: &LiveValues) -> String {
    let sensors = values.sensors.iter().map(sensor_line);
    let sections = values.sections.iter().map(section_line);
    let tilt = values.tilt_urad.map(|[x, y]| format!("  tilt: X {x:+.0} µrad, Y {y:+.0} µrad"));
    sensors.chain(sections).chain(tilt).collect::<Vec<_>>().join("\n")
}

fn sensor_line(live: &LiveSensorValue) -> String {
    let value = match (live.value_mm, &live.failure) {
        (Some(mm), _) => format!("{mm:+.5} mm"),
        (None, failure) => failure.clone().unwrap_or_default(),
    };
    let target = live.target_mm.map_or(String::new(), |mm| format!("target {mm:+.5}"));
    let to_go = live.change_to_target_um().map_or(String::new(), |um| format!("to go {um:+.1} µm"));
    format!("  {:<5} {value:>12}  {target:<15}  {to_go:<16} {}", live.sensor, range_bar(live))
}

/// Bar of the range from its minimum to its maximum: `|` is the target, `o` the value.
fn range_bar(live: &LiveSensorValue) -> String {
    let place = |mm: f64| (live.fraction_of_range(mm) * (RANGE_BAR_WIDTH_CHARS - 1) as f64).round() as usize;
    let [target, value] = [live.target_mm, live.value_mm].map(|mm| mm.map(place));
    let mark = |at: usize| match at {
        at if value == Some(at) => 'o',
        at if target == Some(at) => '|',
        _ => '-',
    };
    format!("[{}]", (0..RANGE_BAR_WIDTH_CHARS).map(mark).collect::<String>())
}

fn section_line(live: &LiveCrossSectionValue) -> String {
    let at = match live.eccentricity_um {
        Some([x, y]) => format!("X {x:+.1} µm, Y {y:+.1} µm from the axis"),
        None => "not known, as too few of its sensors report a value".to_owned(),
    };
    format!("  section {}: {at}", live.number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn live_sensor(value_mm: Option<f64>, target_mm: Option<f64>) -> LiveSensorValue {
        let failure = value_mm.is_none().then(|| "out of range".to_owned());
        LiveSensorValue { sensor: "x1".to_owned(), range_mm: [-0.3, 0.3], target_mm, value_mm, failure }
    }

    #[test]
    fn sensor_line_shows_value_target_and_bar() {
        let lines = [
            (
                live_sensor(Some(0.3), Some(0.0)),
                "  x1     +0.30000 mm  target +0.00000  to go -300.0 µm  [--------|-------o]",
            ),
            (
                live_sensor(None, Some(-0.3)),
                "  x1    out of range  target -0.30000                   [|----------------]",
            ),
            (
                live_sensor(Some(-0.15), None),
                "  x1     -0.15000 mm                                    [----o------------]",
            ),
        ];
        for (live, line) in lines {
            assert_eq!(sensor_line(&live), line);
        }
    }
}
