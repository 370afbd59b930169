//! Compares stored output with current output: text and structure are equal, numbers within 1e-9.

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

use super::normalise::replace_hashes;

const RELATIVE_TOLERANCE: f64 = 1e-9;
const ABSOLUTE_TOLERANCE: f64 = 1e-12;
/// Tolerance of the figures' points and of residuals, µm: differences of positions of some 500 mm, which are rounded to 1e-13 mm.
const FIGURE_TOLERANCE_UM: f64 = 1e-9;
/// Maximum number of differences that a message lists; all are counted.
const MAX_LISTED_DIFFERENCES: usize = 20;
const WRITE_VARIABLE: &str = "TRUED_WRITE_BASELINE";

/// Compares `actual` with the stored file `name`, or writes the file if `TRUED_WRITE_BASELINE=1`.
pub fn check_text_against_baseline(name: &str, actual: &str) {
    let Some(stored) = load_or_write_baseline(name, actual) else { return };
    let mut differences = Differences::default();
    compare_text(&mut differences, &stored, actual);
    differences.fail_if_any(name);
}

/// Like [`check_text_against_baseline`], by the structure of the document: white space, order of keys and hashes are
/// ignored.
pub fn check_json_against_baseline(name: &str, actual: &Value) {
    let actual = replace_hashes(&indented_json_text(actual));
    let Some(stored) = load_or_write_baseline(name, &actual) else { return };
    let [stored, actual] =
        [&stored, &actual].map(|text| serde_json::from_str(text).unwrap_or_else(|error| panic!("{name}: {error}")));
    let mut differences = Differences::default();
    compare_json(&mut differences, "$", &stored, &actual);
    differences.fail_if_any(name);
}

/// The content of the stored file; `None` if `actual` was written instead.
pub fn load_or_write_baseline(name: &str, actual: &str) -> Option<String> {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/baseline").join(name);
    if std::env::var_os(WRITE_VARIABLE).is_some() {
        fs::create_dir_all(file.parent()?).unwrap();
        fs::write(&file, actual).unwrap();
        return None;
    }
    let stored = fs::read_to_string(&file);
    Some(stored.unwrap_or_else(|error| panic!("{}: {error}; {WRITE_VARIABLE}=1 writes it", file.display())))
}

#[derive(Default)]
struct Differences {
    listed: Vec<String>,
    total_count: usize,
}

impl Differences {
    fn add_difference(&mut self, place: &str, stored: &str, actual: &str) {
        self.total_count += 1;
        if self.listed.len() < MAX_LISTED_DIFFERENCES {
            let (stored, actual) = (excerpt(stored), excerpt(actual));
            self.listed.push(format!("  {place}: stored `{stored}`, now `{actual}`"));
        }
    }

    fn fail_if_any(self, name: &str) {
        assert!(
            self.total_count == 0,
            "tests/data/baseline/{name}: {} differences\n{}\n",
            self.total_count,
            self.listed.join("\n")
        );
    }
}

fn excerpt(text: &str) -> String {
    const MAX_EXCERPT_CHARACTERS: usize = 160;
    match text.char_indices().nth(MAX_EXCERPT_CHARACTERS) {
        Some((end, _)) => format!("{} ...", &text[..end]),
        None => text.to_owned(),
    }
}

fn compare_json(differences: &mut Differences, path: &str, stored: &Value, actual: &Value) {
    match (stored, actual) {
        (Value::Object(a), Value::Object(b)) => {
            for (key, stored) in a {
                let path = format!("{path}.{key}");
                match b.get(key) {
                    Some(actual) => compare_json(differences, &path, stored, actual),
                    None => differences.add_difference(&path, &stored.to_string(), "missing"),
                }
            }
            for (key, actual) in b.iter().filter(|(key, _)| !a.contains_key(*key)) {
                differences.add_difference(&format!("{path}.{key}"), "missing", &actual.to_string());
            }
        }
        (Value::Array(a), Value::Array(b)) => {
            if a.len() != b.len() {
                let [a, b] = [a, b].map(|list| format!("{} elements", list.len()));
                differences.add_difference(path, &a, &b);
            }
            for (index, (stored, actual)) in a.iter().zip(b).enumerate() {
                compare_json(differences, &format!("{path}[{index}]"), stored, actual);
            }
        }
        (Value::String(a), Value::String(b)) => {
            if !are_texts_equal_within_tolerance(a, b) {
                differences.add_difference(path, a, b);
            }
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.to_string(), b.to_string());
            let is_position_difference =
                path.starts_with("$.arrows") || path.starts_with("$.functions") || path.ends_with(".residual_um");
            let floor = if is_position_difference { FIGURE_TOLERANCE_UM } else { ABSOLUTE_TOLERANCE };
            if !are_numbers_equal_within_tolerance(&a, &b, floor) {
                differences.add_difference(path, &a, &b);
            }
        }
        (a, b) if a == b => {}
        (a, b) => differences.add_difference(path, &a.to_string(), &b.to_string()),
    }
}

fn are_texts_equal_within_tolerance(stored: &str, actual: &str) -> bool {
    let mut differences = Differences::default();
    compare_text(&mut differences, stored, actual);
    differences.total_count == 0
}

fn compare_text(differences: &mut Differences, stored: &str, actual: &str) {
    let (a, b): (Vec<&str>, Vec<&str>) = (stored.lines().collect(), actual.lines().collect());
    for (index, (stored, actual)) in a.iter().zip(&b).enumerate() {
        if stored != actual {
            compare_line(differences, index + 1, stored, actual);
        }
    }
    if a.len() != b.len() {
        let last = a.len().min(b.len()) + 1;
        let [a, b] = [a, b].map(|lines| format!("{} lines", lines.len()));
        differences.add_difference(&format!("line {last}"), &a, &b);
    }
}

fn compare_line(differences: &mut Differences, line: usize, stored: &str, actual: &str) {
    let (mut a, mut b) = (number_and_text_tokens(stored), number_and_text_tokens(actual));
    loop {
        let (stored, actual) = match (a.next(), b.next()) {
            (None, None) => return,
            (stored, actual) => (stored.unwrap_or_default(), actual.unwrap_or_default()),
        };
        let is_equal = stored.text == actual.text
            || stored.is_number
                && actual.is_number
                && are_numbers_equal_within_tolerance(stored.text, actual.text, ABSOLUTE_TOLERANCE);
        if !is_equal {
            let place = format!("line {line}, column {}", stored.start_column.max(actual.start_column));
            differences.add_difference(&place, stored.text, actual.text);
            // The text after a differing token is shifted, unless both tokens are numbers.
            if !(stored.is_number && actual.is_number) {
                return;
            }
        }
    }
}

/// Integers must be identical; if one number has a fraction or an exponent, both must agree within the tolerance.
fn are_numbers_equal_within_tolerance(stored: &str, actual: &str, absolute_tolerance: f64) -> bool {
    let is_integer = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'-');
    if stored == actual {
        return true;
    }
    if is_integer(stored) && is_integer(actual) {
        return false;
    }
    match (stored.parse::<f64>(), actual.parse::<f64>()) {
        (Ok(a), Ok(b)) if a.is_finite() && b.is_finite() => {
            let tolerance = RELATIVE_TOLERANCE * a.abs().max(b.abs());
            (a - b).abs() <= tolerance.max(absolute_tolerance)
        }
        _ => false,
    }
}

#[derive(Clone, Copy, Default)]
pub struct Token<'t> {
    pub text: &'t str,
    pub is_number: bool,
    /// Column of its first byte, from 1.
    pub start_column: usize,
}

/// A line as numbers and the text between them. A minus sign belongs to the number that follows it, unless
/// another number or a letter precedes it (`2026-07-01`, `self-1`).
pub fn number_and_text_tokens(line: &str) -> impl Iterator<Item = Token<'_>> {
    let bytes = line.as_bytes();
    let mut at = 0;
    std::iter::from_fn(move || {
        let start = at;
        if start == bytes.len() {
            return None;
        }
        let end = number_end(bytes, start);
        at = end.unwrap_or_else(|| {
            (start + 1..bytes.len()).find(|&at| number_end(bytes, at).is_some()).unwrap_or(bytes.len())
        });
        Some(Token { text: &line[start..at], is_number: end.is_some(), start_column: start + 1 })
    })
}

/// The end of the number that begins at `start`.
fn number_end(bytes: &[u8], start: usize) -> Option<usize> {
    let digits = |from: usize| {
        let count = bytes[from..].iter().take_while(|byte| byte.is_ascii_digit()).count();
        (count > 0).then_some(from + count)
    };
    let is_sign = bytes[start] == b'-'
        && !start.checked_sub(1).is_some_and(|at| bytes[at].is_ascii_digit() || bytes[at].is_ascii_lowercase());
    let mut end = digits(start + usize::from(is_sign))?;
    let fraction = if bytes.get(end) == Some(&b'.') { digits(end + 1) } else { None };
    let has_fraction = fraction.is_some();
    end = fraction.unwrap_or(end);
    // Hexadecimal digits such as `\x1e5` and `00e5` are not powers of ten.
    let follows_lowercase = start > 0 && bytes[start - 1].is_ascii_lowercase();
    let is_hexadecimal = follows_lowercase || bytes[start] == b'0' && !has_fraction;
    if matches!(bytes.get(end), Some(b'e' | b'E')) && !is_hexadecimal {
        let is_signed = matches!(bytes.get(end + 1), Some(b'-' | b'+'));
        let from = end + 1 + usize::from(is_signed);
        end = bytes.get(from).and_then(|_| digits(from)).unwrap_or(end);
    }
    Some(end)
}

/// JSON with the keys of objects on separate lines, down to the elements of the longest lists: short, and a change
/// is visible in `git diff`.
fn indented_json_text(value: &Value) -> String {
    let mut text = String::new();
    write_indented_json(&mut text, value, 0);
    text.push('\n');
    text
}

fn write_indented_json(text: &mut String, value: &Value, depth: usize) {
    const MAX_JSON_LINE_BYTES: usize = 110;
    let compact = value.to_string();
    // An element of a list in the second level (a step of a plan) is one line.
    if depth > 1 && value.is_object() || 2 * depth + compact.len() <= MAX_JSON_LINE_BYTES {
        text.push_str(&compact);
        return;
    }
    let indent = "  ".repeat(depth + 1);
    let entries: Vec<(String, &Value)> = match value {
        Value::Object(map) => {
            map.iter().map(|(key, value)| (format!("{}: ", Value::from(key.as_str())), value)).collect()
        }
        Value::Array(list) => list.iter().map(|value| (String::new(), value)).collect(),
        _ => {
            text.push_str(&compact);
            return;
        }
    };
    let (open, close) = if value.is_object() { ('{', '}') } else { ('[', ']') };
    text.push(open);
    for (index, (key, value)) in entries.iter().enumerate() {
        text.push_str(if index == 0 { "\n" } else { ",\n" });
        text.push_str(&indent);
        text.push_str(key);
        write_indented_json(text, value, depth + 1);
    }
    text.push('\n');
    text.push_str(&"  ".repeat(depth));
    text.push(close);
}

#[test]
fn fractions_are_equal_within_tolerance_and_text_exactly() {
    let equal = [
        ("X-12.5 Y0", "X-12.50000000001 Y0"),
        ("1e-13", "-1e-13"),
        ("u 2.5e-3, k 2", "u 0.0025, k 2"),
        ("-0.0", "0.0"),
    ];
    let different = [
        ("X-12.5", "X12.5"),
        ("12.5", "12.5000001"),
        ("123456789012", "123456789013"),
        ("00e5", "00e7"),
        ("\\x1e5", "\\x1e7"),
        ("1.5 mm", "1.5 um"),
        ("1.5", "1.5 "),
        ("1\n2", "1"),
    ];
    for (stored, actual) in equal {
        assert!(are_texts_equal_within_tolerance(stored, actual), "{stored:?} {actual:?}");
    }
    for (stored, actual) in different {
        assert!(!are_texts_equal_within_tolerance(stored, actual), "{stored:?} {actual:?}");
    }
}

#[test]
fn difference_is_listed_with_line_and_column_or_json_path() {
    let mut differences = Differences::default();
    compare_text(&mut differences, "G1 X1.0\nG1 X2.000 Y3", "G1 X1.0\nG1 X2.001 Y3");
    compare_json(
        &mut differences,
        "$",
        &serde_json::json!({"parameters": [{"u": 1.0}]}),
        &serde_json::json!({"parameters": [{"u": 1.1}]}),
    );
    assert_eq!(
        differences.listed,
        ["  line 2, column 5: stored `2.000`, now `2.001`", "  $.parameters[0].u: stored `1.0`, now `1.1`"]
    );
}
