//! Patterns of the symbols of results, with their names in plain words and their groups.

use serde::Serialize;

/// Group of a result for tables: the errors of the machine come first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ResultGroup {
    /// What the run measures: machine errors, a delay, deviations of an artefact from its certificate.
    Main,
    /// Cosine and sine parts of an error motion or of a form.
    Harmonics,
    /// Unknowns of the set-up that are identified together with the errors: stylus, balls, sensors.
    Setup,
}

/// Name of the symbols of one pattern.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SymbolPattern {
    /// A symbol in which the first `*` is replaced by any text that is not empty, such as the number of a ball.
    /// Without `*`: the symbol itself.
    pub pattern: &'static str,
    /// Name of the symbol. `*` is replaced by the text that `*` stands for in the pattern.
    pub name: &'static str,
    pub group: ResultGroup,
}

/// Name and group of one symbol.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedSymbol {
    pub name: String,
    pub group: ResultGroup,
}

/// A result of the group [`ResultGroup::Main`].
pub const fn main_result(pattern: &'static str, name: &'static str) -> SymbolPattern {
    SymbolPattern { pattern, name, group: ResultGroup::Main }
}

pub const fn harmonic_result(pattern: &'static str, name: &'static str) -> SymbolPattern {
    SymbolPattern { pattern, name, group: ResultGroup::Harmonics }
}

pub const fn setup_result(pattern: &'static str, name: &'static str) -> SymbolPattern {
    SymbolPattern { pattern, name, group: ResultGroup::Setup }
}

/// Name and group of `symbol` by the first of the `patterns` that matches it.
pub fn name_by_pattern(patterns: &[SymbolPattern], symbol: &str) -> Option<NamedSymbol> {
    patterns.iter().find_map(|SymbolPattern { pattern, name, group }| {
        let name = match pattern.split_once('*') {
            None => (symbol == *pattern).then(|| (*name).to_owned())?,
            Some((head, tail)) => {
                let variable = symbol.strip_prefix(head)?.strip_suffix(tail).filter(|text| !text.is_empty())?;
                name.replace('*', variable)
            }
        };
        Some(NamedSymbol { name, group: *group })
    })
}
