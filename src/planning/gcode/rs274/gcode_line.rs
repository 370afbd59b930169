//! Parses one line of text into words.

use std::collections::BTreeMap;

use super::LineError;

/// A line without blanks and comments.
#[derive(Debug, PartialEq)]
pub(super) enum GcodeLine {
    /// `%` at the start or end of the program.
    Percent,
    /// `o<NAME> if [..]`: the name in upper case; the condition itself is not kept.
    IfLabel(String),
    /// `o<NAME> endif`: the name in upper case.
    EndIfLabel(String),
    /// Any other line; without words if the line is empty or contains comments only.
    Words(GcodeWords),
}

/// Words of a line that the reader has not taken yet. G and M words may occur several times, a word of any other
/// letter only once.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct GcodeWords {
    /// Ten times the G words: G38.2 is 382.
    pub g_words_tenfold: Vec<u32>,
    pub m_words: Vec<u32>,
    /// Values of the words other than G and M, in the units of the text.
    values_by_letter: BTreeMap<char, f64>,
    /// Whether the line contains a comment `(ABORT, ..)`.
    pub has_abort_comment: bool,
}

impl GcodeWords {
    /// Takes the value of a word, which then counts as understood.
    pub fn take_word_value(&mut self, letter: char) -> Option<f64> {
        self.values_by_letter.remove(&letter)
    }

    /// Letters of the words other than G and M.
    pub fn letters_except_g_and_m(&self) -> impl Iterator<Item = char> {
        self.values_by_letter.keys().copied()
    }

    /// Whether this G word (times ten) is present; it then counts as understood.
    pub fn take_g_word(&mut self, tenfold: u32) -> bool {
        let before = self.g_words_tenfold.len();
        self.g_words_tenfold.retain(|g| *g != tenfold);
        self.g_words_tenfold.len() < before
    }

    /// Whether this M word is present; it then counts as understood.
    pub fn take_m_word(&mut self, code: u32) -> bool {
        let before = self.m_words.len();
        self.m_words.retain(|m| *m != code);
        self.m_words.len() < before
    }

    /// A G or M word that was not understood: the first G word, or the first M word if no G word remains.
    pub fn first_unread_g_or_m_word(&self) -> Option<String> {
        let g = self.g_words_tenfold.first().map(|g| format!("G{}", f64::from(*g) / 10.0));
        g.or_else(|| self.m_words.first().map(|m| format!("M{m}")))
    }

    /// A word that was not understood: G words come before M words, and these before all others, by letter.
    pub fn first_unread_word(&self) -> Option<String> {
        let value = || self.values_by_letter.iter().next().map(|(letter, value)| format!("{letter}{value}"));
        self.first_unread_g_or_m_word().or_else(value)
    }

    fn add_word(&mut self, letter: char, value: f64) -> Result<(), LineError> {
        match letter {
            'G' => self.g_words_tenfold.push(parse_word_integer(value * 10.0, letter)?),
            'M' => self.m_words.push(parse_word_integer(value, letter)?),
            _ => {
                if self.values_by_letter.insert(letter, value).is_some() {
                    return Err(format!("the line has two {letter} words").into());
                }
            }
        }
        Ok(())
    }
}

/// Converts the value of a word that must be an integer from 0 to 9,999,999, such as an N or M word.
pub(super) fn parse_word_integer(value: f64, letter: char) -> Result<u32, LineError> {
    let whole = value.round();
    if (value - whole).abs() < 1e-6 && (0.0..10_000_000.0).contains(&whole) {
        return Ok(whole as u32);
    }
    Err(format!("the number of the {letter} word is invalid").into())
}

impl GcodeLine {
    pub fn parse(text: &str) -> Result<Self, LineError> {
        let (plain, has_abort_comment) = strip_comments(text)?;
        if plain == "%" {
            return Ok(Self::Percent);
        }
        if let Some(rest) = plain.strip_prefix('O') {
            return parse_condition(rest);
        }
        let mut words = GcodeWords { has_abort_comment, ..GcodeWords::default() };
        let mut rest = plain.as_str();
        while let Some(letter) = rest.chars().next() {
            if !letter.is_ascii_uppercase() {
                return Err(format!("`{rest}` is not supported").into());
            }
            let after = &rest[1..];
            let is_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+');
            let end = after.find(|c| !is_number(c)).unwrap_or(after.len());
            let (number, next) = after.split_at(end);
            let value = number.parse().ok().filter(|value: &f64| value.is_finite());
            let value = value.ok_or_else(|| LineError::from(format!("`{rest}` is not a word")))?;
            words.add_word(letter, value)?;
            rest = next;
        }
        Ok(Self::Words(words))
    }
}

/// Upper-case text without blanks and comments, and whether a comment aborts the program.
fn strip_comments(text: &str) -> Result<(String, bool), LineError> {
    let (mut plain, mut comment, mut depth, mut has_abort_comment) = (String::new(), String::new(), 0, false);
    for c in text.chars() {
        match c {
            '(' if depth == 0 => depth = 1,
            ')' if depth == 1 => {
                depth = 0;
                has_abort_comment |= comment.trim_start().to_ascii_uppercase().starts_with("ABORT,");
                comment.clear();
            }
            _ if depth == 1 => comment.push(c),
            ';' => break,
            c if c.is_whitespace() => {}
            c => plain.push(c.to_ascii_uppercase()),
        }
    }
    if depth == 1 { Err("a comment is not closed".into()) } else { Ok((plain, has_abort_comment)) }
}

/// Parses the text after the O of a condition: `<NAME>IF[..]` or `<NAME>ENDIF`.
fn parse_condition(rest: &str) -> Result<GcodeLine, LineError> {
    let refused =
        || LineError::from(format!("`O{rest}` is not supported: only conditions that stop the program are supported"));
    let (name, what) = rest.strip_prefix('<').and_then(|r| r.split_once('>')).ok_or_else(refused)?;
    match what {
        "ENDIF" => Ok(GcodeLine::EndIfLabel(name.to_owned())),
        _ if what.starts_with("IF[") && what.ends_with(']') => Ok(GcodeLine::IfLabel(name.to_owned())),
        _ => Err(refused()),
    }
}
