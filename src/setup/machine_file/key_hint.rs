//! The nearest known key and its unit: most wrong keys are typing errors or have a wrong unit.

/// Key suffixes that state a unit, and the unit as displayed; the first suffix that fits counts.
const UNIT_SUFFIXES: [(&str, &str); 14] = [
    ("_um_per_h", "µm/h"),
    ("_um_per_m", "µm/m"),
    ("_mm_min", "mm/min"),
    ("_per_min", "mm/min, or degrees/min for a rotary axis"),
    ("_per_s2", "mm/s², or degrees/s² for a rotary axis"),
    ("_urad", "µrad"),
    ("_deg", "degrees"),
    ("_rad", "rad"),
    ("_mm", "mm"),
    ("_um", "µm"),
    ("_cm", "cm"),
    ("_hz", "Hz"),
    ("_s", "s"),
    ("_c", "°C"),
];

/// Splits a key into quantity and displayed unit: `radius_mm` → (`radius`, mm); without a known suffix, the whole key
/// and `None`.
fn split_quantity_and_unit(key: &str) -> (&str, Option<&'static str>) {
    UNIT_SUFFIXES
        .iter()
        .find_map(|(ending, unit)| key.strip_suffix(ending).map(|stem| (stem, Some(*unit))))
        .unwrap_or((key, None))
}

/// The key of `known` that was probably meant: the same quantity in another unit, else the key with the
/// smallest edit distance (at most a third of its letters).
fn nearest_key<'k>(key: &str, known: &[&'k str]) -> Option<&'k str> {
    let (stem, _) = split_quantity_and_unit(key);
    known.iter().copied().find(|candidate| split_quantity_and_unit(candidate).0 == stem).or_else(|| {
        let edit_distance = |candidate: &str| strsim::damerau_levenshtein(key, candidate);
        let best = known.iter().copied().min_by_key(|candidate| edit_distance(candidate))?;
        (edit_distance(best) <= best.chars().count() / 3).then_some(best)
    })
}

/// Hint for an unknown key: `did you mean …?`, or the list of known keys.
pub fn unknown_key_hint(key: &str, known: &[impl AsRef<str>]) -> String {
    let known: Vec<&str> = known.iter().map(AsRef::as_ref).collect();
    let Some(near) = nearest_key(key, &known) else {
        return format!("known keys: {}", known.join(", "));
    };
    match (split_quantity_and_unit(near).1, split_quantity_and_unit(key).1) {
        (Some(unit), Some(wrong)) if unit != wrong => {
            format!("did you mean `{near}` (in {unit}, not {wrong})?")
        }
        (Some(unit), _) => format!("did you mean `{near}` (in {unit})?"),
        (None, _) => format!("did you mean `{near}`?"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_or_missing_unit_suggests_the_key_of_the_same_quantity() {
        let known = ["kind", "radius_mm", "ball_radius_mm"];
        assert_eq!(unknown_key_hint("radius_um", &known), "did you mean `radius_mm` (in mm, not µm)?");
        assert_eq!(unknown_key_hint("ball_radius", &known), "did you mean `ball_radius_mm` (in mm)?");
    }

    #[test]
    fn typing_error_has_a_suggestion_and_nonsense_has_none() {
        assert_eq!(nearest_key("topolgy", &["name", "topology"]), Some("topology"));
        assert_eq!(nearest_key("banana", &["name", "topology"]), None);
        assert_eq!(unknown_key_hint("banana", &["name", "tool_mm"]), "known keys: name, tool_mm");
    }
}
