//! Which lines of a budget rest on sizes that nobody has declared.

use machine::record::estimate::{BudgetLine, Estimate};

/// Budget lines and the last part of the keys that state their sizes.
const KEYS: [(&str, &str); 10] = [
    ("resolution", "resolution_um"),
    ("resolution of the axes", "resolution_um"),
    ("probe lobing", "lobing_um"),
    ("stylus offset", "stylus_offset_um"),
    ("backlash", "backlash_um"),
    ("angular error motions of X, Y and Z", "angular_motion_urad"),
    ("thermal drift", "drift_um_per_h"),
    ("squareness of X, Y and Z", "squareness_urad"),
    ("temperature of the certified length", "u_temperature_k"),
    ("temperature of the certified length", "expansion_um_per_m_k"),
];
const LINEAR_MOTIONS: &str = "error motions of X, Y and Z";
const MOTIONS: &str = "error motions of ";

/// Marks the lines whose size, or a part of it, is one of the `assumed` keys of the machine file.
pub fn mark_assumed(estimate: &mut Estimate, assumed: &[String]) {
    let lines = estimate.parameters.iter_mut().flat_map(|parameter| &mut parameter.budget);
    lines.for_each(|line| line.assumed = assumed.iter().any(|key| is_of(line, key)));
}

/// Whether `key` of the machine file, e.g. `axes.X.backlash_um`, sizes the line.
fn is_of(line: &BudgetLine, key: &str) -> bool {
    let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
    let axis = section.strip_prefix("axes.");
    let is_linear = matches!(axis, Some("X" | "Y" | "Z"));
    match line.source.strip_prefix(MOTIONS) {
        _ if line.source == LINEAR_MOTIONS => name == "error_motion_um" && is_linear,
        Some(of) => {
            name == "error_motion_um" && (axis == Some(of) || of == "rotary axes" && !is_linear)
        }
        None => KEYS.contains(&(line.source.as_str(), name)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::EvaluationType;

    #[test]
    fn a_line_is_assumed_if_one_of_its_own_keys_is() {
        let is_assumed = |source: &str, key: &str| {
            let evaluation = Some(EvaluationType::B);
            is_of(
                &BudgetLine { source: source.to_owned(), evaluation, u: 0.1, assumed: false },
                key,
            )
        };
        for (source, own, other) in [
            (LINEAR_MOTIONS, "axes.Z.error_motion_um", "axes.C.error_motion_um"),
            ("error motions of C", "axes.C.error_motion_um", "axes.B.error_motion_um"),
            ("error motions of rotary axes", "axes.B.error_motion_um", "axes.Z.error_motion_um"),
            ("backlash", "axes.X.backlash_um", "axes.X.error_motion_um"),
            ("probe lobing", "probe.lobing_um", "probe.stylus_offset_um"),
            ("thermal drift", "machine.drift_um_per_h", "machine.squareness_urad"),
        ] {
            assert!(is_assumed(source, own) && !is_assumed(source, other), "{source}");
        }
        assert!(!is_assumed("repeatability of a touch", "probe.lobing_um"));
    }
}
