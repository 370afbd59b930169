//! Parses one line of text into words.

use std::collections::BTreeMap;

/// A line without blanks and comments.
#[derive(Debug, PartialEq)]
pub(super) enum Line {
    /// `%` at the start or end of the program.
    Percent,
    /// `o<..> if [..]`
    If(String),
    /// `o<..> endif`
    EndIf(String),
    Words(Words),
}

/// Words by letter; G and M words may occur several times.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Words {
    /// Ten times the G words: G38.2 is 382.
    pub g: Vec<u32>,
    pub m: Vec<u32>,
    values: BTreeMap<char, f64>,
    /// Whether the line contains a comment `(ABORT, ..)`.
    pub aborts: bool,
}

impl Words {
    /// Takes the value of a word, which then counts as understood.
    pub fn take(&mut self, letter: char) -> Option<f64> {
        self.values.remove(&letter)
    }

    /// Letters of the words other than G and M.
    pub fn letters(&self) -> impl Iterator<Item = char> {
        self.values.keys().copied()
    }

    /// Whether this G word (times ten) is present; it then counts as understood.
    pub fn take_g(&mut self, tenfold: u32) -> bool {
        let before = self.g.len();
        self.g.retain(|g| *g != tenfold);
        self.g.len() < before
    }

    pub fn take_m(&mut self, code: u32) -> bool {
        let before = self.m.len();
        self.m.retain(|m| *m != code);
        self.m.len() < before
    }

    /// The first G or M word that was not understood.
    pub fn left_over_code(&self) -> Option<String> {
        let g = self.g.first().map(|g| format!("G{}", f64::from(*g) / 10.0));
        g.or_else(|| self.m.first().map(|m| format!("M{m}")))
    }

    /// The first word that was not understood.
    pub fn left_over(&self) -> Option<String> {
        let value = || self.values.iter().next().map(|(letter, value)| format!("{letter}{value}"));
        self.left_over_code().or_else(value)
    }

    fn put(&mut self, letter: char, value: f64) -> Result<(), String> {
        match letter {
            'G' => self.g.push(code(value * 10.0, letter)?),
            'M' => self.m.push(code(value, letter)?),
            _ => {
                if self.values.insert(letter, value).is_some() {
                    return Err(format!("two {letter} words"));
                }
            }
        }
        Ok(())
    }
}

/// Number of a word that counts or names: an integer, not negative, below ten million.
pub(super) fn code(value: f64, letter: char) -> Result<u32, String> {
    let whole = value.round();
    if (value - whole).abs() < 1e-6 && (0.0..10_000_000.0).contains(&whole) {
        return Ok(whole as u32);
    }
    Err(format!("a {letter} word that does not exist"))
}

impl Line {
    pub fn parse(text: &str) -> Result<Self, String> {
        let (plain, aborts) = without_comments(text)?;
        if plain == "%" {
            return Ok(Self::Percent);
        }
        if let Some(rest) = plain.strip_prefix('O') {
            return condition(rest);
        }
        let mut words = Words { aborts, ..Words::default() };
        let mut rest = plain.as_str();
        while let Some(letter) = rest.chars().next() {
            if !letter.is_ascii_uppercase() {
                return Err(format!("`{rest}` is not understood"));
            }
            let after = &rest[1..];
            let is_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+');
            let end = after.find(|c| !is_number(c)).unwrap_or(after.len());
            let (number, next) = after.split_at(end);
            let value = number.parse().ok().filter(|value: &f64| value.is_finite());
            let value = value.ok_or_else(|| format!("`{rest}` is not a word"))?;
            words.put(letter, value)?;
            rest = next;
        }
        Ok(Self::Words(words))
    }
}

/// Upper-case text without blanks and comments, and whether a comment aborts the program.
fn without_comments(text: &str) -> Result<(String, bool), String> {
    let (mut plain, mut comment, mut depth, mut aborts) = (String::new(), String::new(), 0, false);
    for c in text.chars() {
        match c {
            '(' if depth == 0 => depth = 1,
            ')' if depth == 1 => {
                depth = 0;
                aborts |= comment.trim_start().to_ascii_uppercase().starts_with("ABORT,");
                comment.clear();
            }
            _ if depth == 1 => comment.push(c),
            ';' => break,
            c if c.is_whitespace() => {}
            c => plain.push(c.to_ascii_uppercase()),
        }
    }
    if depth == 1 { Err("a comment without its end".to_owned()) } else { Ok((plain, aborts)) }
}

/// Parses the text after the O of a condition: `<NAME>IF[..]` or `<NAME>ENDIF`.
fn condition(rest: &str) -> Result<Line, String> {
    let refused = || format!("`O{rest}` is not understood: only conditions that stop are");
    let (name, what) =
        rest.strip_prefix('<').and_then(|r| r.split_once('>')).ok_or_else(refused)?;
    match what {
        "ENDIF" => Ok(Line::EndIf(name.to_owned())),
        _ if what.starts_with("IF[") && what.ends_with(']') => Ok(Line::If(name.to_owned())),
        _ => Err(refused()),
    }
}
