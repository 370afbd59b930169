//! Label of a step, e.g. `pose/B-90/C60`: the purpose of the scan and the positions of the rotary axes.

use machine::Position;

/// Purpose of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Pass {
    /// Search for the sphere. Nothing is identified from it.
    Find,
    /// Measurement of the latency between the sensor and the axis positions.
    Latency,
    /// Scan at one of the heights that determine the beam's direction.
    Height,
    /// Measurement of the centre at one position of the rotary axes.
    Pose,
}

const NAMES: [(Pass, &str); 4] = [
    (Pass::Find, "find"),
    (Pass::Latency, "latency"),
    (Pass::Height, "height"),
    (Pass::Pose, "pose"),
];

impl Pass {
    pub fn of(label: &str) -> Option<Self> {
        let first = label.split('/').next()?;
        NAMES.iter().find(|(_, name)| *name == first).map(|(pass, _)| *pass)
    }

    /// Label of a step. `detail` distinguishes scans at the same position.
    pub fn label(self, detail: &str, rotary: &Position) -> String {
        let name = NAMES.iter().find(|(pass, _)| *pass == self).map_or("", |(_, name)| name);
        let parts = [name.to_owned(), detail.to_owned(), place(rotary, "", "", "/")];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
    }
}

/// Text such as `B -90°, C 60°`.
pub fn in_words(at: &Position) -> String {
    place(at, " ", "°", ", ")
}

fn place(at: &Position, between: &str, unit: &str, join: &str) -> String {
    let turned = at.iter().filter(|(axis, _)| !axis.is_linear() && axis.letter() != 'S');
    let named: Vec<String> = turned
        .map(|(axis, value)| format!("{axis}{between}{}{unit}", axis.to_edge(value).round() + 0.0))
        .collect();
    named.join(join)
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::Axis;

    #[test]
    fn a_label_says_why_and_where() {
        let at =
            Position::new().with(Axis::B, -90f64.to_radians()).with(Axis::C, 60f64.to_radians());
        assert_eq!(Pass::Pose.label("", &at), "pose/B-90/C60");
        assert_eq!(Pass::Height.label("2", &at), "height/2/B-90/C60");
        assert_eq!(in_words(&at), "B -90°, C 60°");
        assert_eq!(Pass::of("height/2/B-90/C60"), Some(Pass::Height));
        assert_eq!(Pass::of("slow/001/1/+45"), None);
    }
}
