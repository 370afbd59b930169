//! Numbers in texts of controls and sensors. Rust parses `nan` and `inf` as numbers, but neither is a measured value.

/// Parses a number; `None` if it is invalid or not finite.
pub(crate) fn parse_finite_number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Parses each of `texts`; `None` if one of them is invalid or not finite.
pub(crate) fn parse_finite_numbers<'t>(texts: impl IntoIterator<Item = &'t str>) -> Option<Vec<f64>> {
    texts.into_iter().map(parse_finite_number).collect()
}
