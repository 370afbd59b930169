//! Format of numbers, units and symbols in metrology.

/// Display of the unit of a function's argument, as written in the estimate.
pub fn argument_unit_symbol(unit: &str) -> &str {
    match unit {
        "deg" => "°",
        "um" => "µm",
        other => other,
    }
}

/// Number of decimals that gives `uncertainty` two significant digits (GUM 7.2.6); three without an
/// uncertainty.
pub fn decimals_for_uncertainty(uncertainty: f64) -> usize {
    let digits = uncertainty.abs().log10().floor();
    if digits.is_finite() { (1.0 - digits).clamp(0.0, 9.0) as usize } else { 3 }
}

/// The number with a true minus sign; a dash for a value that is not finite.
pub fn format_fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{:.decimals$}", value.abs());
    let is_zero = text.bytes().all(|byte| matches!(byte, b'0' | b'.'));
    if value < 0.0 && !is_zero { format!("−{text}") } else { text }
}

/// A symbol as base and index: `EX0C` is E with X0C below, `EXC_total` E with XC,total,
/// `tool_x` tool with x (ISO 230-1 writes the letters of an error motion as an index).
pub fn split_into_base_and_index(symbol: &str) -> (String, String) {
    if symbol.contains('-') {
        return (symbol.replace('-', "−"), String::new());
    }
    let (head, tail) = symbol.split_once('_').unwrap_or((symbol, ""));
    let is_error_motion =
        |rest: &str| !rest.is_empty() && rest.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit());
    let (base, letters) = match head.strip_prefix('E') {
        Some(rest) if is_error_motion(rest) => ("E", rest),
        _ => (head, ""),
    };
    let index: Vec<_> = std::iter::once(letters).chain(tail.split('_')).filter(|part| !part.is_empty()).collect();
    (base.to_owned(), index.join(","))
}

/// A symbol on one line, for the axes of a figure: `E_XC,total`.
pub fn one_line_symbol(symbol: &str) -> String {
    let (base, index) = split_into_base_and_index(symbol);
    if index.is_empty() { base } else { format!("{base}_{index}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_follow_from_two_digits_of_uncertainty() {
        for (value, uncertainty, expected) in [
            (49.87654, 1.94, "49.9"),
            (-30.0049, 0.0314, "−30.005"),
            (-0.04, 1.2, "0.0"),
            (1234.5, 230.0, "1234"),
            (1.5, 0.0, "1.500"),
            (f64::NAN, 1.0, "–"),
        ] {
            assert_eq!(format_fixed(value, decimals_for_uncertainty(uncertainty)), expected);
        }
    }

    #[test]
    fn symbols_are_split_into_base_and_index() {
        for (symbol, base, index) in [
            ("EX0C", "E", "X0C"),
            ("EXC_total", "E", "XC,total"),
            ("E_radial", "E", "radial"),
            ("W", "W", ""),
            ("tool_x", "tool", "x"),
            ("ball_3_z", "ball", "3,z"),
            ("Eccentricity", "Eccentricity", ""),
        ] {
            assert_eq!(split_into_base_and_index(symbol), (base.to_owned(), index.to_owned()));
        }
    }
}
