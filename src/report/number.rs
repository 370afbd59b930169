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
    let letters = error_motion_letters(head).unwrap_or_default();
    let base = if letters.is_empty() { head } else { "E" };
    let index: Vec<_> = std::iter::once(letters).chain(tail.split('_')).filter(|part| !part.is_empty()).collect();
    (base.to_owned(), index.join(","))
}

/// Letters and digits after the E of an error motion or location error: `X0C` of `EX0C`.
fn error_motion_letters(symbol_head: &str) -> Option<&str> {
    let letters = symbol_head.strip_prefix('E')?;
    let is_index = !letters.is_empty() && letters.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit());
    is_index.then_some(letters)
}

/// The sentence with each error symbol in the form of [`one_line_symbol`]. Text between backquotes is unchanged: the
/// reader may type it as a command.
pub fn with_one_line_symbols(sentence: &str) -> String {
    let is_part_of_symbol = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    // A word such as `E12` may be a part of a name.
    let is_index = |letters: &str| letters.len() > 1 && letters.starts_with(|c: char| "XYZABC".contains(c));
    let is_symbol = |word: &str| {
        let mut heads = word.split('-').map(|part| part.split('_').next().unwrap_or_default());
        heads.all(|head| error_motion_letters(head).is_some_and(is_index))
    };
    let piece_with_symbol = |piece: &str| {
        let word = piece.trim_end_matches(|c| !is_part_of_symbol(c));
        if is_symbol(word) { one_line_symbol(word) + &piece[word.len()..] } else { piece.to_owned() }
    };
    let is_typed = |index: usize| index % 2 == 1;
    let parts = sentence.split('`').enumerate().map(|(index, part)| match is_typed(index) {
        true => part.to_owned(),
        false => part.split_inclusive(|c| !is_part_of_symbol(c)).map(piece_with_symbol).collect(),
    });
    parts.collect::<Vec<String>>().join("`")
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
    fn symbols_in_a_sentence_are_on_one_line() {
        for (sentence, expected) in [
            ("EX0S together with tool_x", "E_X0S together with tool_x"),
            ("(EXC_total, EY0C_lsc): EB0Z", "(E_XC,total, E_Y0C,lsc): E_B0Z"),
            ("EYY1-EXX1 ± 3 µm/m; Each E of E_radial-", "EYY1−EXX1 ± 3 µm/m; Each E of E_radial-"),
            ("set `EX0C_um`, not EX0C", "set `EX0C_um`, not E_X0C"),
            ("order 8 of C-EX0C, E12", "order 8 of C-EX0C, E12"),
        ] {
            assert_eq!(with_one_line_symbols(sentence), expected);
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
