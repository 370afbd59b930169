//! The list of methods in the command's help.

/// One paragraph per method, for `trued run --help`.
pub(super) fn methods_help() -> String {
    let paragraphs = methods::METHODS.iter().map(|method| {
        format!("  {}\n      needs: {}\n      finds: {}\n", method.name, method.needs, method.finds)
    });
    format!("Methods:\n{}", paragraphs.collect::<String>())
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_readme_lists_the_methods() {
        let readme = include_str!("../../README.md");
        for method in methods::METHODS {
            let row = format!("| `{}` | {} | {} |", method.name, method.needs, method.finds);
            assert!(readme.lines().any(|line| line == row), "README.md lacks the row\n{row}");
        }
    }
}
