//! The simulated control's own parser of lines: letters and numbers only. Error codes are those of Grbl
//! (grblHAL `errors.h`).

/// Error code of Grbl.
pub type GrblErrorCode = u8;

/// A letter and its number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GcodeWord {
    pub letter: char,
    pub value: f64,
}

/// The words of one line; comments `(..)` and `;..` are dropped.
pub(super) fn parse_words(line: &str) -> Result<Vec<GcodeWord>, GrblErrorCode> {
    let code = strip_comments_and_spaces(line);
    let mut rest = code.as_str();
    let mut words = Vec::new();
    while let Some(letter) = rest.chars().next() {
        if !letter.is_ascii_uppercase() {
            return Err(1);
        }
        let number = &rest[1..];
        let end = number.find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+'))).unwrap_or(number.len());
        let value = number[..end].parse::<f64>().map_err(|_| 2)?;
        words.push(GcodeWord { letter, value });
        rest = &number[end..];
    }
    Ok(words)
}

fn strip_comments_and_spaces(line: &str) -> String {
    let mut in_comment = false;
    let mut bare = String::new();
    for character in line.chars() {
        match character {
            '(' => in_comment = true,
            ')' => in_comment = false,
            ';' if !in_comment => break,
            c if in_comment || c.is_whitespace() => {}
            c => bare.push(c.to_ascii_uppercase()),
        }
    }
    bare
}

/// Whether the line contains nothing to execute: only spaces, comments or `%`.
pub fn is_blank(line: &str) -> bool {
    matches!(strip_comments_and_spaces(line).as_str(), "" | "%")
}
