//! The list of methods in the command's help.

use clap::builder::PossibleValuesParser;

/// Parser that accepts the names of the methods. For another name, clap lists them and the most similar one.
pub(super) fn method_name_parser() -> PossibleValuesParser {
    PossibleValuesParser::new(methods::method_names())
}

/// One paragraph per method, for `trued run --help`.
pub(super) fn methods_help() -> String {
    let paragraphs = methods::METHOD_DESCRIPTIONS.iter().map(|method| {
        format!("  {}\n      needs: {}\n      finds: {}\n", method.name, method.required_setup, method.results)
    });
    format!("Methods:\n{}", paragraphs.collect::<String>())
}

#[cfg(test)]
mod tests {
    #[test]
    fn readme_lists_the_methods() {
        let readme = include_str!("../../README.md");
        for method in methods::METHOD_DESCRIPTIONS {
            let row = format!("| `{}` | {} | {} |", method.name, method.required_setup, method.results);
            assert!(readme.lines().any(|line| line == row), "README.md lacks the row\n{row}");
        }
    }
}
