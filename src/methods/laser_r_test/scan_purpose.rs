//! Label of a step, e.g. `pose/B-90/C60`: the purpose of the scan and the positions of the rotary axes.

use machine::Position;

/// Purpose of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScanPurpose {
    /// Search for the sphere. Its samples are used only while there are no scans at poses or heights.
    Search,
    /// Measurement of the latency between the sensor and the axis positions.
    Latency,
    /// Scan at one of the heights that determine the beam's direction.
    BeamDirection,
    /// Measurement of the centre at one position of the rotary axes, also as a reference.
    CentreAtPose,
}

const PURPOSE_LABELS: [(ScanPurpose, &str); 4] = [
    (ScanPurpose::Search, "find"),
    (ScanPurpose::Latency, "latency"),
    (ScanPurpose::BeamDirection, "height"),
    (ScanPurpose::CentreAtPose, "pose"),
];

impl ScanPurpose {
    pub fn from_step_label(label: &str) -> Option<Self> {
        let first = label.split('/').next()?;
        PURPOSE_LABELS.iter().find(|(_, name)| *name == first).map(|(purpose, _)| *purpose)
    }

    /// Label of a step. `detail` distinguishes scans at the same position.
    pub fn step_label(self, detail: &str, rotary: &Position) -> String {
        let name = PURPOSE_LABELS.iter().find(|(purpose, _)| *purpose == self).map_or("", |(_, name)| name);
        let parts = [name.to_owned(), detail.to_owned(), format_rotary_position(rotary, "", "", "/")];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
    }
}

/// Text such as `B -90°, C 60°`, rounded to whole degrees, without the spindle.
pub fn describe_rotary_position(at: &Position) -> String {
    format_rotary_position(at, " ", "°", ", ")
}

fn format_rotary_position(at: &Position, between: &str, unit: &str, join: &str) -> String {
    let turned = at.iter().filter(|(axis, _)| !axis.is_linear() && axis.letter() != 'S');
    let named: Vec<String> = turned
        .map(|(axis, value)| format!("{axis}{between}{}{unit}", axis.to_mm_or_deg(value).round() + 0.0))
        .collect();
    named.join(join)
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::Axis;

    #[test]
    fn label_contains_purpose_and_position() {
        let at = Position::new().with(Axis::B, -90f64.to_radians()).with(Axis::C, 60f64.to_radians());
        assert_eq!(ScanPurpose::CentreAtPose.step_label("", &at), "pose/B-90/C60");
        assert_eq!(ScanPurpose::BeamDirection.step_label("2", &at), "height/2/B-90/C60");
        assert_eq!(describe_rotary_position(&at), "B -90°, C 60°");
        assert_eq!(ScanPurpose::from_step_label("height/2/B-90/C60"), Some(ScanPurpose::BeamDirection));
        assert_eq!(ScanPurpose::from_step_label("slow/001/1/+45"), None);
    }
}
